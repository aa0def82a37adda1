"""Settings of a session: endpoints, credentials and security."""

from typing import Final, Literal

import msgspec

MAX_MESSAGE_BYTES: Final = 64 << 20
"""Zenoh drops a larger message without a word, so a request beyond it gets no reply. A link may
hold as much memory; Zenoh's default is 1 GiB."""


class Credentials(msgspec.Struct, frozen=True, kw_only=True):
    """User and password of a session, and the authority that it trusts."""

    user: str
    password: str
    authority: str
    """Certificate, PEM."""
    certificate: str = ""
    """Certificate of the client with its private key, PEM; empty where the server asks for none."""
    certificate_file: str = ""
    """File with both, which is read at each connection, so that it may be renewed."""
    world: str = ""
    """World in which the user is announced; empty for the server itself."""

    def __repr__(self) -> str:
        """Name the user only."""
        return f"Credentials({self.user!r})"


class RouterSecurity(msgspec.Struct, frozen=True, kw_only=True):
    """Certificate and users of a secured router."""

    certificate: str
    """File with the certificate of the router, and that of the authority."""
    private_key: str
    """File with the private key."""
    passwords: str
    """File with a line `user:password` for each user."""
    client_authority: str = ""
    """File with the authority of client certificates; empty = clients need none."""
    access_control: dict[str, object]
    """See `zensim.proto.security.access_rules`."""


class BusConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Session settings; defaults to loopback without scouting; clients do not gossip."""

    mode: Literal["client", "peer", "router"] = "client"
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    lease_ms: int = 0
    """Silence after which others take this session for gone, and its tokens disappear; 0 =
    `CLIENT_LEASE_MS`, or `ROUTER_LEASE_MS` of a router."""
    max_message_bytes: int = MAX_MESSAGE_BYTES
    open_timeout_s: float = 2.0
    joined_publishers: tuple[str, ...] = ()
    """Key expressions; all publishers within one of them are one publisher for the router."""
    credentials: Credentials | None = None
    """Credentials of a client of a secured router; a join token in `connect` replaces them."""
    router_security: RouterSecurity | None = None
    """Security of a router that only admits users; None = it admits everyone."""
