"""Endpoints of Zenoh sessions, as in `tcp/127.0.0.1:7447`: the default, checks, free ports."""

import errno
import ipaddress
import os
import re
import socket
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
ANY_HOSTS: Final = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}
"""Hosts that stand for all addresses when listening, and loopback, on which such a program is."""
ENDPOINT_PATTERN = re.compile(
    r"(tcp|tls|quic|ws|udp)/(?P<host>\[[^\]]+\]|[^\s:/#?]+):(?P<port>\d{1,5})\S*"
)
MAX_PORT: Final = 65535
STREAM_PROTOCOLS: Final = frozenset({"tcp", "tls", "ws"})
"""Protocols whose listener accepts a plain TCP connection."""
CONNECT_TIMEOUT_S: Final = 1.0
"""Timeout of a connection to the own host."""


def check_endpoint(endpoint: str) -> str:
    """Return the endpoint if it is valid.

    Raises:
        ValueError: Not `protocol/host:port`.
    """
    match = ENDPOINT_PATTERN.fullmatch(endpoint)
    if match and int(match["port"]) <= MAX_PORT:
        return endpoint
    raise ValueError(
        f"endpoint {endpoint[:80]!r} is not valid; use protocol/host:port, as {DEFAULT_ENDPOINT}"
    )


class Exposed(ValueError):
    """A program would accept connections of other hosts without a decision about security."""


def is_loopback(host: str) -> bool:
    """Whether a host is this one only; names other than localhost are not."""
    bare = host.strip("[]")
    try:
        return ipaddress.ip_address(bare).is_loopback
    except ValueError:
        return bare == "localhost"


def check_exposure(
    command: str, endpoints: Iterable[str], *, is_secure: bool, is_insecure: bool
) -> None:
    """Refuse to accept connections of other hosts unless the user says how.

    Args:
        command: To type, with its verb.
        endpoints: To listen on.
        is_secure: Whether only users with a token are admitted.
        is_insecure: Whether the user accepts that everybody may do everything.

    Raises:
        Exposed: An endpoint is not on loopback, and neither is chosen.
        ValueError: Both are chosen.
    """
    if is_secure and is_insecure:
        raise ValueError("`secure` and `insecure` exclude each other; give one of them")
    for endpoint in endpoints:
        match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
        if match is None or is_loopback(match["host"]) or is_secure or is_insecure:
            continue
        secured = f"{command} --secure --listen tls/{match['host']}:{match['port']}"
        raise Exposed(
            f"{endpoint} admits other hosts, and whoever reaches it may do everything; type "
            f"'{secured}', or add `insecure` in a network that you trust"
        )


def to_client_endpoint(endpoint: str) -> str:
    """Make the endpoint to connect to on this host from one to listen on."""
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    host = match["host"] if match else ""
    return endpoint.replace(host, ANY_HOSTS.get(host, host), 1)


def is_port_taken(host: str, port: int) -> bool:
    """Whether a program listens on a TCP port of this host, so that another cannot."""
    host = host.strip("[]")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        if os.name == "posix":  # elsewhere the option would take the port from its program
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False


def is_endpoint_taken(endpoint: str) -> bool:
    """Whether a program listens at a TCP endpoint of this host; False for other protocols."""
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    if match is None or match[1] not in STREAM_PROTOCOLS:
        return False
    return is_port_taken(match["host"], int(match["port"]))


def with_free_port(endpoint: str) -> str:
    """Replace port 0 by a free port of that host, which no other program gets for a minute."""
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    if match is None or int(match["port"]) != 0:
        return endpoint
    port = reserve_port(match["host"].strip("[]"))
    return endpoint[: match.start("port")] + str(port) + endpoint[match.end("port") :]


def reserve_port(host: str) -> int:
    """Find a free port; the system gives it to no program that asks for any for a minute.

    A connection that this side has closed first keeps the port (TIME_WAIT), but not from a listener
    with SO_REUSEADDR, as those of Zenoh are.
    """
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as listener:
        if os.name == "posix":  # elsewhere the option would share the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, 0))
        port = int(listener.getsockname()[1])
        listener.listen(1)
        # A host on which nothing connects, as behind a firewall, has a free port all the same.
        with suppress(OSError), socket.create_connection((host, port), CONNECT_TIMEOUT_S):
            listener.accept()[0].close()
    return port
