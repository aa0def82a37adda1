"""Join tokens: one line with all that a client needs to join a secured server.

`zs1.ADDRESS.USER.PASSWORD.FINGERPRINT`, each part in base64url: `host:port`, `user` or
`user@world`, 16 random bytes, and the SHA-256 of the certificate authority's certificate (DER).
The long form has two parts more, `.CERTIFICATE.KEY` of the client (DER). A file with a token may
have them in PEM below the short form instead, where Zenoh reads them at each connection.
"""

import base64
import binascii
import os
import re
import textwrap
from pathlib import Path
from typing import Final

import msgspec

from zensim.proto.bounded_files import read_file
from zensim.proto.endpoints import check_endpoint
from zensim.proto.names import check_name
from zensim.proto.sha256 import sha256

PREFIX: Final = "zs1"
PASSWORD_BYTES, FINGERPRINT_BYTES = 16, 32
TOKEN_VARIABLE: Final = "ZENSIM_TOKEN"
DEFAULT_WORLD: Final = "default"
MAX_FILE_BYTES: Final = 16_384
CERTIFICATE_LABEL, KEY_LABEL = "CERTIFICATE", "PRIVATE KEY"
SHORT_PARTS, LONG_PARTS = 4, 6
REVOKED_DIGEST_BYTES: Final = 16


class InvalidToken(ValueError):
    """A text that is not a join token; the message does not quote it."""


class JoinToken(msgspec.Struct, frozen=True):
    """Address, credentials and pinned authority of a secured server."""

    endpoint: str
    """Endpoint of Zenoh, such as `tls/192.168.1.5:7447`."""
    user: str
    password: bytes
    fingerprint: bytes
    """SHA-256 of the certificate of the authority, in DER."""
    world: str = DEFAULT_WORLD
    certificate: bytes = b""
    """Certificate of the client, DER; empty where the server asks for none."""
    private_key: bytes = b""
    """Private key of that certificate, PKCS#8 in DER."""
    file: str = ""
    """File that has certificate and key in PEM, if they were read from one."""

    def __repr__(self) -> str:
        """Name endpoint and user, without the secret."""
        return f"JoinToken({self.endpoint!r}, {self.user!r})"

    @property
    def password_text(self) -> str:
        """The password as Zenoh's `usrpwd` has it."""
        return encode_base64(self.password)

    @property
    def certificate_text(self) -> str:
        """Certificate and key of the client in PEM; empty without them."""
        if not self.certificate:
            return ""
        return write_pem(CERTIFICATE_LABEL, self.certificate) + write_pem(
            KEY_LABEL, self.private_key
        )

    def write(self) -> str:
        """Write the token as one line."""
        user = self.user if self.world == DEFAULT_WORLD else f"{self.user}@{self.world}"
        address = self.endpoint.removeprefix("tls/")
        certified = (self.certificate, self.private_key) if self.certificate else ()
        parts = (address.encode(), user.encode(), self.password, self.fingerprint, *certified)
        return ".".join((PREFIX, *map(encode_base64, parts)))

    def write_file(self) -> str:
        """Write the content of a file for `@FILE`: Zenoh reads a certificate from it."""
        short = msgspec.structs.replace(self, certificate=b"", private_key=b"")
        return f"{short.write()}\n{self.certificate_text}"


def make_password() -> bytes:
    """Make a random password of 128 bits."""
    return os.urandom(PASSWORD_BYTES)


def is_join_address(address: str) -> bool:
    """Whether an address is a join token, or `@FILE` with one, and not an endpoint."""
    return address.startswith((PREFIX, "@"))


def read_join_address(address: str) -> JoinToken:
    """Read a join token, or the file with one that `@FILE` names.

    Raises:
        InvalidToken: It is not a token.
        OSError: The file cannot be read.
    """
    if not address.startswith("@"):
        return parse_join_token(address)
    path = Path(address[1:]).expanduser()
    return parse_join_file(read_file(path, MAX_FILE_BYTES).decode(errors="replace"), str(path))


def find_stored_token(endpoint: str) -> Path:
    """Find the file that keeps the token for an endpoint, which may not exist."""
    folder = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    name = re.sub(r"[^A-Za-z0-9.-]", "_", endpoint.removeprefix("tls/"))
    return Path(folder) / "zensim" / "joined" / f"{name}.token"


def store_token(token: JoinToken) -> Path:
    """Keep a token for its endpoint, in a file of mode 0600."""
    path = find_stored_token(token.endpoint)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.unlink(missing_ok=True)
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w") as stream:
        stream.write(token.write_file())
    return new.replace(path)


def forget_token(endpoint: str) -> Path:
    """Remove the token that is kept for an endpoint.

    Raises:
        InvalidToken: There is none.
    """
    path = find_stored_token(endpoint)
    if not path.is_file():
        raise InvalidToken(f"no token is kept for {endpoint}; 'zensim join TOKEN' keeps one")
    path.unlink()
    return path


def complete_address(address: str) -> str:
    """Return `@FILE` for a TLS endpoint whose token is kept, else the address."""
    if not address.startswith("tls/"):
        return address
    path = find_stored_token(address)
    return f"@{path}" if path.is_file() else address


def parse_join_file(text: str, file: str) -> JoinToken:
    """Parse the content of a file with a token.

    Args:
        text: A token, and certificate and key of the client in PEM, if it has them.
        file: Its path.

    Raises:
        InvalidToken: A part is missing or not valid.
    """
    line, _, rest = text.strip().partition("\n")
    token = parse_join_token(line.strip())
    if not rest:
        return token
    certificate, private_key = read_pem(CERTIFICATE_LABEL, rest), read_pem(KEY_LABEL, rest)
    if not (certificate and private_key):
        raise InvalidToken(
            "below the token, its file must have a certificate and a private key in PEM; copy the "
            "whole output of 'zensim token show USER --as file'"
        )
    return msgspec.structs.replace(
        token, certificate=certificate, private_key=private_key, file=file
    )


def parse_join_token(text: str) -> JoinToken:
    """Parse a join token.

    Raises:
        InvalidToken: A part is missing or not valid.
    """
    match text.split("."):
        case [start, *parts] if start == PREFIX and len(parts) in (SHORT_PARTS, LONG_PARTS):
            pass
        case _:
            raise InvalidToken(
                f"a join token begins with '{PREFIX}.' and has 5 or 7 parts; copy the whole line "
                "that 'zensim serve --secure' or 'zensim token create' printed"
            )
    try:
        address, user, password, fingerprint, *certified = map(decode_base64, parts)
        certificate, private_key = certified or (b"", b"")
        name, _, world = user.decode().partition("@")
        token = JoinToken(
            check_endpoint(f"tls/{address.decode()}"),
            check_name(name, "user"),
            password,
            fingerprint,
            check_name(world or DEFAULT_WORLD, "world"),
            certificate,
            private_key,
        )
    except (ValueError, binascii.Error):
        # Without its cause, whose message could quote the secret.
        raise InvalidToken("the join token is damaged; copy the whole line again") from None
    if len(token.password) != PASSWORD_BYTES or len(token.fingerprint) != FINGERPRINT_BYTES:
        raise InvalidToken("the join token is cut short; copy the whole line again")
    return token


def hide_token(address: str) -> str:
    """Return what may be printed of an address: the endpoint of a token, else the address."""
    if not address.startswith(PREFIX):
        return address
    try:
        return parse_join_token(address).endpoint
    except InvalidToken:
        return f"{PREFIX}.…"


def hash_revoked_password(password: bytes) -> bytes:
    """Make the digest by which the owner of a password, and nobody else, finds it revoked."""
    return sha256(b"zensim revoked " + password).digest()[:REVOKED_DIGEST_BYTES]


def write_pem(label: str, der: bytes) -> str:
    """Write one block of PEM."""
    lines = textwrap.wrap(base64.b64encode(der).decode(), 64)
    return "\n".join((f"-----BEGIN {label}-----", *lines, f"-----END {label}-----", ""))


def read_pem(label: str, text: str) -> bytes:
    """Read the first block of PEM with this label; empty if there is none."""
    match = re.search(f"-----BEGIN {label}-----([A-Za-z0-9+/=\\s]*)-----END {label}-----", text)
    try:
        return base64.b64decode(match[1]) if match else b""
    except binascii.Error:
        return b""


def encode_base64(data: bytes) -> str:
    """Encode as base64url without padding."""
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def decode_base64(text: str) -> bytes:
    """Decode base64url without padding.

    Raises:
        binascii.Error: It is not base64url.
    """
    return base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
