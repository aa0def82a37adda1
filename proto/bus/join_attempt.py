"""Who a secured server is, and why it refuses a session."""

from typing import TYPE_CHECKING

from zensim.proto.bus.bus_config import Credentials
from zensim.proto.bus.bus_errors import EndpointUnreachable, JoinRefused
from zensim.proto.join_tokens import JoinToken, decode_base64

if TYPE_CHECKING:
    from zensim.proto.tls_probe import ProbeFailed


def join_with_token(token: JoinToken, timeout_s: float) -> Credentials:
    """Check who is at the endpoint of a token before its password is sent there."""
    # With TLS, which few sessions need: 1 MB.
    from zensim.proto.tls_probe import ProbeFailed, fetch_authority  # noqa: PLC0415

    try:
        authority = fetch_authority(token, timeout_s)
    except ProbeFailed as error:
        if error.reason == "unreachable":
            raise EndpointUnreachable(str(error)) from error
        raise JoinRefused(error.reason, str(error)) from error
    return Credentials(
        user=token.user,
        password=token.password_text,
        authority=authority,
        certificate=token.certificate_text,
        certificate_file=token.file,
        world=token.world,
    )


def ask_for_refusal(endpoint: str, given: Credentials) -> "ProbeFailed":
    """Ask a secured server why it refuses credentials."""
    from zensim.proto.tls_probe import find_refusal  # noqa: PLC0415

    return find_refusal(
        endpoint,
        given.authority,
        user=given.user,
        password=decode_base64(given.password),
        certificate=given.certificate,
    )
