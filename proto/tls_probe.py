"""TLS handshake with a secured server before a session opens: pin its authority, name the fault.

Zenoh reports every failure as the same timeout; a handshake distinguishes them at once.
"""

import hashlib
import re
import socket
import ssl
import tempfile
from contextlib import suppress
from typing import Final

from zensim.proto.endpoints import ENDPOINT_PATTERN, check_endpoint
from zensim.proto.join_tokens import JoinToken, hash_revoked_password

PROBE_TIMEOUT_S: Final = 2.0
ALERT_TIMEOUT_S: Final = 0.5
"""A server that refuses a certificate does so within a round trip."""
ALERTS: Final = (
    (
        "CERTIFICATE_REQUIRED",
        "certificate_required",
        "asks for a client certificate, which this token lacks; get the long form of it from the "
        "server's operator, by 'zensim token show USER'",
    ),
    (
        "CERTIFICATE_EXPIRED",
        "certificate_expired",
        "refuses the client certificate, which has expired; get a new one from the server's "
        "operator, by 'zensim token show USER'",
    ),
    (
        "UNKNOWN_CA|BAD_CERTIFICATE|CERTIFICATE_UNKNOWN|DECRYPT_ERROR|UNSUPPORTED_CERTIFICATE",
        "certificate_refused",
        "refuses the client certificate, which its authority did not sign; get a new token from "
        "the server's operator",
    ),
)
"""TLS alerts by which a server refuses a client: pattern, reason, message."""


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


def find_refusal(
    endpoint: str, authority: str, *, user: str, password: bytes, certificate: str
) -> ProbeFailed:
    """Find why a secured server that has the pinned authority does not admit a user.

    Its certificate lists digests of revoked passwords, so that their owners are told so.

    Args:
        endpoint: Of the server.
        authority: Certificate, PEM.
        user: Name of the user.
        password: Of the user.
        certificate: Of the client, with its private key, PEM; or empty.

    Returns:
        `certificate_required`, `certificate_expired`, `certificate_refused`, `revoked` or `user`.
    """
    context = _make_context()
    context.load_verify_locations(cadata=authority)
    if certificate:
        with tempfile.NamedTemporaryFile("w", suffix=".pem") as file:
            file.write(certificate)
            file.flush()
            context.load_cert_chain(file.name)
    try:
        chain = _shake_hands(endpoint, context, PROBE_TIMEOUT_S, alert_timeout_s=ALERT_TIMEOUT_S)
    except ProbeFailed as error:
        return error
    if hash_revoked_password(password) in b"".join(chain[:1]):
        return ProbeFailed(
            "revoked",
            f"user '{user}' was revoked or has expired at {endpoint}; get a new token from the "
            "server's operator",
        )
    return ProbeFailed(
        "user",
        f"{endpoint} does not admit user '{user}': the password is wrong, or the server is full or "
        "too busy; try again, or get a new token from its operator",
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


def _shake_hands(
    endpoint: str, context: ssl.SSLContext, timeout_s: float, *, alert_timeout_s: float = 0.0
) -> list[bytes]:
    """Return the certificates (DER) that the server sends.

    In TLS 1.3 a server refuses the client after the handshake: wait for that, if asked to.
    """
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
            chain = _list_certificates(secured)
            if alert_timeout_s:
                _wait_for_alert(secured, endpoint, alert_timeout_s)
            return chain
    except ssl.SSLCertVerificationError as error:
        if re.search("expired", error.verify_message):
            raise ProbeFailed(
                "expired", f"the certificate of {endpoint} has expired; its operator must renew it"
            ) from error
        raise ProbeFailed(
            "not_signed", f"the certificate of {endpoint} is not valid: {error.verify_message}"
        ) from error
    except OSError as error:
        raise ProbeFailed(
            "no_tls",
            f"{endpoint} does not speak TLS: no secured server is there; start it with "
            "'zensim serve --secure', or use `connect` tcp/HOST:PORT for an open one",
        ) from error


def _wait_for_alert(secured: ssl.SSLSocket, endpoint: str, timeout_s: float) -> None:
    secured.settimeout(timeout_s)
    try:
        with suppress(TimeoutError):
            secured.recv(1)
    except ssl.SSLError as error:
        for pattern, reason, message in ALERTS:
            if re.search(pattern, error.reason or ""):
                raise ProbeFailed(reason, f"{endpoint} {message}") from error


def _list_certificates(secured: ssl.SSLSocket) -> list[bytes]:
    # `SSLSocket.get_unverified_chain` is public since Python 3.13.
    chain = secured._sslobj.get_unverified_chain() or ()  # type: ignore[attr-defined]  # noqa: SLF001
    return [
        one if isinstance(one, bytes) else ssl.PEM_cert_to_DER_cert(one.public_bytes())
        for one in chain
    ]
