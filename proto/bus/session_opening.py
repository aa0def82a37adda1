"""Opening of a session: its settings completed, and the error when it fails."""

import socket
from typing import Final

import msgspec
import zenoh

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import (
    BusError,
    EndpointTaken,
    EndpointUnreachable,
    JoinRefused,
    NoSession,
)
from zensim.proto.bus.join_attempt import ask_for_refusal, join_with_token
from zensim.proto.bus.session_files import FEW_SESSIONS, require_files
from zensim.proto.bus.zenoh_config import make_zenoh_config
from zensim.proto.bus.zenoh_runtime import RUNTIME_THREADS, require_threads
from zensim.proto.endpoints import DEFAULT_ENDPOINT, check_endpoint, with_free_port
from zensim.proto.join_tokens import complete_address, is_join_address, read_join_address
from zensim.proto.process_limits import limit_unacknowledged_time

MOST_UNACKNOWLEDGED_MS: Final = 1800
"""A connection whose peer takes no data for so long is reset. It is less than the lease of our
clients: Zenoh closes a link at the end of its lease, and until the last bytes are written, which a
stopped process never reads, nothing that is published reaches anybody through that router task."""
PROBE_TIMEOUT_S: Final = 0.5
JOIN_TIMEOUT_S: Final = 2.0
OPEN_TIMEOUTS_S = (0.25, 0.25, 0.25, 0.25, 2.0)
"""Short, to find a new router soon; sometimes long, for a distant one."""


def open_session(config: BusConfig) -> tuple[zenoh.Session, BusConfig]:
    """Open a session of Zenoh; return it with its completed configuration.

    Raises:
        BusError: See `open_bus`.
        ValueError: See there.
    """
    require_threads()
    if config.mode == "router":
        require_files(FEW_SESSIONS, "a server")
    settled = _settle(config)
    RUNTIME_THREADS.are_started = True
    try:
        session = zenoh.open(make_zenoh_config(settled))
    except zenoh.ZError as error:
        raise _make_open_error(settled, str(error)) from error
    for endpoint in settled.listen:
        _, _, port = endpoint.partition("?")[0].partition("#")[0].rpartition(":")
        if port.isdigit():
            limit_unacknowledged_time(int(port), MOST_UNACKNOWLEDGED_MS)
    return session, settled


def _settle(config: BusConfig) -> BusConfig:
    """Complete a configuration: free ports, the default endpoint, what a join token says."""
    listen = tuple(with_free_port(endpoint) for endpoint in config.listen)
    connect = config.connect
    if config.mode == "client" and not connect:
        connect = (DEFAULT_ENDPOINT,)
    credentials, timeout_s = config.credentials, config.open_timeout_s
    if config.mode == "client" and credentials is None:
        connect = tuple(map(complete_address, connect))
    if connect and is_join_address(connect[0]):
        token = read_join_address(connect[0])
        connect = (token.endpoint,)
        credentials = join_with_token(token, max(timeout_s, JOIN_TIMEOUT_S))
    if credentials is not None:
        # A refusal is known by the timeout only: a short one would take haste for a refusal.
        timeout_s = max(timeout_s, JOIN_TIMEOUT_S)
    for endpoint in connect:
        check_endpoint(endpoint)
    return msgspec.structs.replace(
        config, listen=listen, connect=connect, credentials=credentials, open_timeout_s=timeout_s
    )


def _make_open_error(config: BusConfig, text: str) -> BusError:
    if "in use" in text:
        return _make_taken_error(config.listen[0])
    if "listener" in text:
        reason = text.partition(" at /")[0]
        return BusError(f"cannot listen at {', '.join(config.listen)}: {reason}")
    where = ", ".join(config.connect)
    if (given := config.credentials) is not None:
        refusal = ask_for_refusal(config.connect[0], given)
        if refusal.reason == "unreachable":
            return EndpointUnreachable(str(refusal))
        return JoinRefused(refusal.reason, str(refusal))
    if any(_accepts_connections(endpoint) for endpoint in config.connect):
        return NoSession(
            f"{where} accepts connections, but no session: it is secured (use --join TOKEN), full, "
            "suspended or no router"
        )
    return EndpointUnreachable(
        f"no server listens at {where}; start one with 'zensim serve' or use --connect"
    )


def _make_taken_error(endpoint: str) -> EndpointTaken:
    return EndpointTaken(
        f"another process listens at {endpoint}; stop it, use --listen with another "
        "port, or --connect to it"
    )


def _accepts_connections(endpoint: str) -> bool:
    """Whether a TCP connection to an endpoint can be opened."""
    host, _, port = endpoint.partition("?")[0].rpartition("/")[2].rpartition(":")
    if not endpoint.startswith(("tcp/", "tls/")) or not port.isdigit():
        return False
    try:
        with socket.create_connection((host.strip("[]"), int(port)), PROBE_TIMEOUT_S):
            return True
    except OSError:
        return False
