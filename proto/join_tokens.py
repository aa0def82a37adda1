"""Join tokens: one line with all that a client needs to join a secured server.

`zs1.ADDRESS.USER.PASSWORD.FINGERPRINT`, each part in base64url: `host:port`, `user` or
`user@world`, 16 random bytes, and the SHA-256 of the certificate authority's certificate (DER).
"""

import base64
import binascii
import os
from pathlib import Path
from typing import Final

import msgspec

from zensim.proto.endpoints import check_endpoint
from zensim.proto.names import check_name

PREFIX: Final = "zs1"
PASSWORD_BYTES, FINGERPRINT_BYTES = 16, 32
TOKEN_VARIABLE: Final = "ZENSIM_TOKEN"
DEFAULT_WORLD: Final = "default"
MAX_FILE_BYTES: Final = 4096


class InvalidToken(ValueError):
    """A text that is not a join token; the message does not quote it."""


class JoinToken(msgspec.Struct, frozen=True):
    """Address, credentials and pinned authority of a secured server."""

    endpoint: str
    """As `tls/192.168.1.5:7447`."""
    user: str
    password: bytes
    fingerprint: bytes
    """SHA-256 of the certificate of the authority, in DER."""
    world: str = DEFAULT_WORLD

    def __repr__(self) -> str:
        """Name endpoint and user, without the secret."""
        return f"JoinToken({self.endpoint!r}, {self.user!r})"

    @property
    def password_text(self) -> str:
        """The password as Zenoh's `usrpwd` has it."""
        return encode_base64(self.password)

    def write(self) -> str:
        """Write the token as one line."""
        user = self.user if self.world == DEFAULT_WORLD else f"{self.user}@{self.world}"
        address = self.endpoint.removeprefix("tls/")
        parts = (address.encode(), user.encode(), self.password, self.fingerprint)
        return ".".join((PREFIX, *map(encode_base64, parts)))


def make_password() -> bytes:
    """Make a random password of 128 bits."""
    return os.urandom(PASSWORD_BYTES)


def is_join_address(address: str) -> bool:
    """Whether an address is a join token, or `@FILE` with one, and not an endpoint."""
    return address.startswith((f"{PREFIX}.", "@"))


def read_join_address(address: str) -> JoinToken:
    """Read a join token, or the file with one that `@FILE` names.

    Raises:
        InvalidToken: It is not a token.
        OSError: The file cannot be read.
    """
    if not address.startswith("@"):
        return parse_join_token(address)
    with Path(address[1:]).expanduser().open("rb") as stream:
        return parse_join_token(stream.read(MAX_FILE_BYTES).decode(errors="replace").strip())


def parse_join_token(text: str) -> JoinToken:
    """Parse a join token.

    Raises:
        InvalidToken: A part is missing or not valid.
    """
    match text.split("."):
        case [start, *parts] if start == PREFIX and len(parts) == len(("a", "u", "p", "f")):
            pass
        case _:
            raise InvalidToken(
                f"a join token begins with '{PREFIX}.' and has five parts; copy the whole line "
                "that 'zensim serve --secure' or 'zensim token create' printed"
            )
    try:
        address, user, password, fingerprint = map(decode_base64, parts)
        name, _, world = user.decode().partition("@")
        token = JoinToken(
            check_endpoint(f"tls/{address.decode()}"),
            check_name(name, "user"),
            password,
            fingerprint,
            check_name(world or DEFAULT_WORLD, "world"),
        )
    except (ValueError, binascii.Error):
        # Without its cause, whose message could quote the secret.
        raise InvalidToken("the join token is damaged; copy the whole line again") from None
    if len(token.password) != PASSWORD_BYTES or len(token.fingerprint) != FINGERPRINT_BYTES:
        raise InvalidToken("the join token is cut short; copy the whole line again")
    return token


def hide_token(address: str) -> str:
    """Return what may be printed of an address: the endpoint of a token, else the address."""
    if not address.startswith(f"{PREFIX}."):
        return address
    try:
        return parse_join_token(address).endpoint
    except InvalidToken:
        return f"{PREFIX}.…"


def encode_base64(data: bytes) -> str:
    """Encode as base64url without padding."""
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def decode_base64(text: str) -> bytes:
    """Decode base64url without padding.

    Raises:
        binascii.Error: It is not base64url.
    """
    return base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
