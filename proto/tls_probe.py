"""TLS handshake with a secured server before a session opens: pin its authority, name the fault.

Zenoh reports every failure as the same timeout; a handshake distinguishes them at once.
"""

import hashlib
import re
import socket
import ssl
from typing import Final

from zensim.proto.endpoints import ENDPOINT_PATTERN, check_endpoint
from zensim.proto.join_tokens import JoinToken

PROBE_TIMEOUT_S: Final = 2.0


class ProbeFailed(Exception):
    """The server cannot be trusted or reached; `reason` says which, as one word."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def fetch_authority(token: JoinToken, timeout_s: float = PROBE_TIMEOUT_S) -> str:
    """Fetch the certificate (PEM) of the authority that a token pins; nothing secret is sent.

    Raises:
        ProbeFailed: `unreachable`, `no_tls`, `other_authority`, `expired` or `not_signed`.
    """
    context = _make_context()
    context.verify_mode = ssl.CERT_NONE
    chain = _shake_hands(token.endpoint, context, timeout_s)
    for der in chain:
        if hashlib.sha256(der).digest() == token.fingerprint:
            authority = ssl.DER_cert_to_PEM_cert(der)
            _verify(token.endpoint, authority, timeout_s)
            return authority
    raise ProbeFailed(
        "other_authority",
        f"{token.endpoint} is not the server of this token: its certificate authority is another; "
        "get a new token from its operator, and check who is at that address",
    )


def _verify(endpoint: str, authority: str, timeout_s: float) -> None:
    """Verify the certificate of the server against its authority: signature and dates."""
    context = _make_context()
    context.load_verify_locations(cadata=authority)
    _shake_hands(endpoint, context, timeout_s)


def _make_context() -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    # The pinned authority certifies this one server, whatever its address is.
    context.check_hostname = False
    return context


def _shake_hands(endpoint: str, context: ssl.SSLContext, timeout_s: float) -> list[bytes]:
    """Return the certificates (DER) that the server sends."""
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    host, port = (match["host"].strip("[]"), int(match["port"])) if match else ("", 0)
    try:
        stream = socket.create_connection((host, port), timeout_s)
    except OSError as error:
        raise ProbeFailed(
            "unreachable", f"no server listens at {endpoint}: {error.strerror or error}"
        ) from error
    try:
        with stream, context.wrap_socket(stream) as secured:
            return _list_certificates(secured)
    except ssl.SSLCertVerificationError as error:
        if re.search("expired", error.verify_message):
            raise ProbeFailed(
                "expired", f"the certificate of {endpoint} has expired; its operator must renew it"
            ) from error
        raise ProbeFailed(
            "not_signed",
            f"the certificate of {endpoint} is not valid: {error.verify_message}",
        ) from error
    except OSError as error:
        raise ProbeFailed(
            "no_tls",
            f"{endpoint} does not speak TLS: no secured server is there; start it with "
            "'zensim serve --secure', or use --connect tcp/HOST:PORT for an open one",
        ) from error


def _list_certificates(secured: ssl.SSLSocket) -> list[bytes]:
    # `SSLSocket.get_unverified_chain` is public since Python 3.13.
    chain = secured._sslobj.get_unverified_chain() or ()  # type: ignore[attr-defined]  # noqa: SLF001
    return [
        one if isinstance(one, bytes) else ssl.PEM_cert_to_DER_cert(one.public_bytes())
        for one in chain
    ]
