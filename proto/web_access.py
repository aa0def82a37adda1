"""Who may open a server for browsers: origin, token, TLS, and addresses of other hosts."""

import errno
import hmac
import os
import re
import secrets
import shlex
import socket
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import SplitResult, parse_qs, parse_qsl, urlencode, urlsplit

from zensim.proto.bounded_files import read_text_file
from zensim.proto.endpoints import Exposed, is_loopback
from zensim.proto.whole_files import writing_whole

if TYPE_CHECKING:
    import ssl

TOKEN_NAME: Final = "zensim_token"
"""Name of the parameter in the address; that of the cookie begins so."""
TOKEN_BYTES: Final = 16
TOKEN_PATTERN: Final = re.compile(r"[A-Za-z0-9_-]{22,}")
ANY_ADDRESS: Final = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Address in the printed URL of a server on all addresses."""


@dataclass(frozen=True)
class PageAccess:
    """Who may open the page, and by which protocol.

    Attributes:
        token: Secret that a browser gives once, as `?zensim_token=`; empty = none is needed.
        certificate: PEM file, with its chain; empty = HTTP.
        private_key: PEM file of the certificate.
    """

    token: str = ""
    certificate: str = ""
    private_key: str = ""

    def make_tls_context(self) -> "ssl.SSLContext | None":
        """Make the context of HTTPS; None for HTTP.

        Raises:
            OSError: A file cannot be read, or is not what it should be.
        """
        if not self.certificate:
            return None
        import ssl  # noqa: PLC0415  1 MB, which few pages need

        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.certificate, self.private_key)
        return context


OPEN_ACCESS: Final = PageAccess()
"""Everybody who reaches the page, by HTTP."""


def is_own_origin(
    hosts: Sequence[str], origins: Sequence[str], *, bound_to: str, admitted: Collection[str] = ()
) -> bool:
    """Whether a request comes from a page of this server, or of an admitted origin.

    A page of another site sends the Origin of that site. With DNS rebinding, both headers have
    the name of the other site, so the name must be one of this host, too, or have no dot, as
    those of services in a network of containers: no site of the internet has such a name.
    Programs other than browsers send no Origin.

    Args:
        hosts: Host headers; exactly one is valid.
        origins: Origin headers.
        bound_to: Address that is served.
        admitted: Origins of other sites, such as `https://app.example`.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    name = split_url(f"//{hosts[0]}").hostname or ""
    own_name = socket.gethostname().lower()
    is_own = name in {"localhost", bound_to.lower(), own_name, f"{own_name}.local"}
    is_of_network = bool(name) and "." not in name
    if not (is_own or is_of_network or _is_address(name)):
        return False
    return all(
        origin in admitted or split_url(origin).netloc.lower() == hosts[0].lower()
        for origin in origins
    )


def name_cookie(port: int) -> str:
    """Name the cookie of the server at a port: browsers send those of all ports of a host."""
    return f"{TOKEN_NAME}_{port}"


def has_token(cookies: Sequence[str], name: str, token: str) -> bool:
    """Whether a Cookie header has the secret in the cookie with a name."""
    for header in cookies:
        try:
            found = SimpleCookie(header).get(name)
        except CookieError:
            continue
        if found is not None and _is_equal(found.value, token):
            return True
    return False


def has_token_in_address(path: str, token: str) -> bool:
    """Whether a requested path has the secret in its query."""
    return _is_equal(parse_qs(split_url(path).query).get(TOKEN_NAME, [""])[0], token)


def remove_token(path: str) -> str:
    """Return the address of the first page with the query of a requested path, without the secret.

    Args:
        path: As requested, with its query.
    """
    kept = [one for one in parse_qsl(split_url(path).query) if one[0] != TOKEN_NAME]
    return f"/?{urlencode(kept)}" if kept else "/"


def check_certificate(certificate: Path | None, key: Path | None) -> bool:
    """Return whether TLS is used.

    Raises:
        ValueError: Only one of the files is given.
    """
    if (certificate is None) != (key is None):
        raise ValueError("`certificate` and `key` belong together; give both or none")
    return certificate is not None


def check_page_exposure(
    command: str, host: str, *, has_tls: bool, is_secure: bool, is_insecure: bool
) -> None:
    """Refuse to serve other hosts unless the user says how.

    Args:
        command: To type, with its verb.
        host: Address to serve.
        has_tls: Whether there is a certificate.
        is_secure: Whether only browsers with the token are served.
        is_insecure: Whether the user accepts that everybody is.

    Raises:
        Exposed: The address is not on loopback, and nothing is chosen, or no certificate is there.
        ValueError: Both are chosen.
    """
    if is_secure and is_insecure:
        raise ValueError("`secure` and `insecure` exclude each other; give one of them")
    if is_loopback(host) or is_insecure:
        return
    if not is_secure:
        raise Exposed(
            f"what is served on {host} could be opened from other hosts by everybody; type "
            f"'{command} --host {host} --secure --certificate FILE --key FILE', or add `insecure` "
            "in a network that you trust"
        )
    if not has_tls:
        raise Exposed(
            f"the token could be read on its way to {host}; add `certificate` and `key`, or "
            "serve on 127.0.0.1"
        )


def read_page_token(path: Path | None) -> str:
    """Read the token from its file; make both if the file is missing.

    Raises:
        OSError: The file cannot be read or written.
        ValueError: It has no token.
    """
    if path is None:
        return secrets.token_urlsafe(TOKEN_BYTES)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if not TOKEN_PATTERN.fullmatch(token := read_text_file(path, encoding="ascii").strip()):
            raise ValueError(
                f"{path} has no token of 22 or more letters, digits, '-' and '_'; remove the file"
            ) from None
        return token
    with os.fdopen(descriptor, "w") as file:
        file.write(token := secrets.token_urlsafe(TOKEN_BYTES))
    return token


def make_page_url(
    host: str, port: int, token: str, *, has_tls: bool, protocol: str = "http"
) -> str:
    """Make the address as a browser on this host opens it.

    Args:
        host: Address that is served.
        port: TCP port.
        token: Empty = none is needed.
        has_tls: Whether the protocol is `https` or `wss`.
        protocol: `http` or `ws`.
    """
    name = ANY_ADDRESS.get(host, host)
    place = f"{f'[{name}]' if ':' in name else name}:{port}"
    return add_token(f"{protocol}{'s' if has_tls else ''}://{place}", token)


def add_token(url: str, token: str) -> str:
    """Add a token to an address without one; empty = none is needed."""
    return f"{url.rstrip('/')}/?{TOKEN_NAME}={token}" if token else url


def add_token_of_file(url: str, file: Path | str) -> str:
    """Add the token of a file to an address without one, as a shell reads it."""
    return f"{url.rstrip('/')}/?{TOKEN_NAME}=$(cat {shlex.quote(str(file))})"


def split_token(url: str) -> tuple[str, str]:
    """Split an address of `make_page_url` into that without the token, and the token."""
    bare, _, token = url.partition(f"?{TOKEN_NAME}=")
    return bare, token


def keep_token(token: str, what: str) -> Path:
    """Write a token into a file of mode 0600, whose name others can be told.

    Args:
        token: Of a page.
        what: Name of the file, without its suffix.

    Raises:
        OSError: It cannot be written.
    """
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    file = Path(state) / "zensim" / "pages" / f"{what}.secret"
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with writing_whole(file, mode=0o600) as stream:
        stream.write(token.encode())
    return file


def split_url(url: str) -> SplitResult:
    """Split a URL; an invalid one becomes empty."""
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return urlsplit("")
    return parts


def _is_equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class PortTaken(OSError):
    """Another program listens on the port."""


class CannotListen(OSError):
    """The address does not belong to this host, or its use is not permitted."""


def open_listener(host: str, port: int) -> socket.socket:
    """Listen on exactly this port; 0 = any free port.

    Raises:
        PortTaken: Another program listens on the port.
        CannotListen: The operating system refuses.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise PortTaken(
                f"port {port} on {host} is used by another program; stop it or use `port`"
            ) from error
        is_numbered = error.errno is not None and error.errno > 0  # others are of the resolver
        reason = os.strerror(error.errno or 0) if is_numbered else error.strerror
        raise CannotListen(
            f"cannot listen on {host} port {port}: {reason}; use an address of this host"
        ) from error
