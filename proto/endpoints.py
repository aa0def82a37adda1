"""Endpoints of Zenoh sessions, as in `tcp/127.0.0.1:7447`: the default, checks, free ports."""

import re
import socket
from typing import Final

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
ENDPOINT_PATTERN = re.compile(
    r"(tcp|tls|quic|ws|udp)/(?P<host>\[[^\]]+\]|[^\s:/#?]+):(?P<port>\d{1,5})\S*"
)
MAX_PORT: Final = 65535


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


def with_free_port(endpoint: str) -> str:
    """Replace port 0 by a free port of that host."""
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    if match is None or int(match["port"]) != 0:
        return endpoint
    host = match["host"].strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.bind((host, 0))
        port = probe.getsockname()[1]
    return endpoint[: match.start("port")] + str(port) + endpoint[match.end("port") :]
