"""Configuration of Zenoh for clients, routers and secured ones."""

import base64
import json
import uuid
from typing import Final

import zenoh

from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig, Credentials, RouterSecurity
from zensim.proto.bus.session_files import find_max_sessions
from zensim.proto.network_protocols import MAX_COMMAND_BYTES, MAX_FLEET_COMMAND_BYTES
from zensim.proto.process_limits import raise_file_limit

BATCHES_OF_DATA: Final = 16
"""Batches of 64 KiB that a link may hold before messages are dropped; Zenoh's default is 2. The
scans of a hundred robots, published at once, are 150 kB; memory is allocated when it is needed."""
LINK_TIMEOUT_US: Final = 100_000
"""A link whose queue stays full for so long under replies is closed; Zenoh's default is 5 s."""
CLIENT_LEASE_MS: Final = 2000
"""Lease of clients such as agents; it is short so that another agent gets their robots soon."""
ROUTER_LEASE_MS: Final = 10_000
"""Each side of a link waits for the lease that the other one announces. A host of ROS 2 that stalls
for longer closes its link to us, and the calls that wait for a reply get none."""
CLIENT_OPEN_TIMEOUT_MS: Final = 60_000
"""Time of a handshake on which a client that lost its router gives up; Zenoh's default is 10 s. If
it gives up while the router replies, the session is left with a transport that has none of its
declarations: a router that is suspended for 30 s went on just when the second attempt ended."""
MAX_QUERY_BYTES: Final = 4 << 20
"""A router ends a larger query without a reply at once; servers refuse it from 3 MiB on."""
SIZE_LIMITS: Final = (
    {
        "id": "queries",
        "messages": ["query"],
        "flows": ["ingress"],
        "key_exprs": ["**"],
        "size_limit": MAX_QUERY_BYTES,
    },
    {
        "id": "commands",
        "messages": ["put"],
        "flows": ["ingress"],
        "key_exprs": [
            *("**/cmd_vel", "**/cmd_vel/**"),
            *("**/joint_commands", "**/joint_commands/**"),
        ],
        "size_limit": MAX_COMMAND_BYTES,
    },
    {
        "id": "fleet-commands",
        "messages": ["put"],
        "flows": ["ingress"],
        "key_exprs": ["sim/*/drive/*/command", "sim/*/twists"],
        "size_limit": MAX_FLEET_COMMAND_BYTES,
    },
)
"""Messages that a router drops. A put on a wider key expression passes, and subscriptions drop it
by its size."""
WILDCARD_HZ: Final = 200
WILDCARD_LIMITS: Final = (
    {
        "id": "wildcards",
        "messages": ["put"],
        "flows": ["ingress"],
        "rules": [
            {"key_expr": key, "freq": WILDCARD_HZ}
            for key in (
                f"{keys.NO_NAMESPACE}/cmd_vel",
                f"*/{keys.NO_NAMESPACE}/cmd_vel/**",
                f"sim/*/drive/{keys.NO_NAMESPACE}/state",
            )
        ],
    },
)
"""A put on a wildcard becomes as many messages as there are agents: from each session a router
takes one in 5 ms."""
QUERIES_OF_OWN_PRIORITY: Final = {
    "id": "queries",
    "messages": ["query"],
    "flows": ["ingress"],
    "key_exprs": ["**"],
    "overwrite": {"priority": "data_high"},
}
"""Replies have the priority of their query. In a queue of their own they do not hold the lock that
a message to the same link waits for, however long that link blocks."""
ROUTER_USER: Final = "router"
MAX_SECURED_SESSIONS: Final = 500
ACCEPT_TIMEOUT_MS: Final = 2000
"""Time for a handshake; Zenoh's default is 10 s."""
MAX_HANDSHAKES: Final = 500
"""Handshakes at a time; a client that only opens sockets can use up Zenoh's default of 100."""
CONNECT_RETRY = {"period_init_ms": 20, "period_max_ms": 500, "period_increase_factor": 1.5}
"""Pauses before a client tries to connect again: a server that starts is found soon."""


def to_zenoh_json(config: BusConfig) -> str:
    """Write a configuration as JSON for `zenohd`."""
    return str(make_zenoh_config(config))


def list_client_settings(config: BusConfig) -> dict[str, object]:
    """List the settings that another Zenoh client needs to join, by path; with the password."""
    return {
        "mode": "client",
        "connect/endpoints": list(config.connect),
        "scouting/multicast/enabled": False,
        **_make_client_entries(config.credentials),
    }


def make_zenoh_config(config: BusConfig) -> zenoh.Config:
    """Make the configuration of a session."""
    entries: dict[str, object] = {
        "mode": config.mode,
        "listen/endpoints": list(config.listen),
        "connect/endpoints": list(config.connect),
        "connect/timeout_ms": round(config.open_timeout_s * 1000),
        "connect/exit_on_failure": True,
        "connect/retry": CONNECT_RETRY,
        "scouting/multicast/enabled": False,
        # Peers of rmw_zenoh learn of each other by the gossip of their router only.
        "scouting/gossip/enabled": config.mode != "client",
        "scouting/delay": 0,
        # Else the router stamps all: in one order, in which it does not forward them, and zenoh-ext
        # drops what is older than the last message with the same stamp id.
        "timestamping/enabled": True,
        # Shared memory pools use 20 MB per process.
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": config.lease_ms or find_lease_ms(config.mode),
        "transport/link/rx/max_message_size": config.max_message_bytes,
        "transport/link/tx/queue/size/data": BATCHES_OF_DATA,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": LINK_TIMEOUT_US,
    }
    if config.mode == "client":
        entries["transport/unicast/open_timeout"] = CLIENT_OPEN_TIMEOUT_MS
    if config.mode == "router":
        entries["transport/unicast/max_sessions"] = find_max_sessions(raise_file_limit())
        entries["transport/unicast/accept_timeout"] = ACCEPT_TIMEOUT_MS
        entries["transport/unicast/accept_pending"] = MAX_HANDSHAKES
        entries["low_pass_filter"] = SIZE_LIMITS
        entries["qos/network"] = [QUERIES_OF_OWN_PRIORITY]
        entries["downsampling"] = WILDCARD_LIMITS
    if config.joined_publishers:
        entries["aggregation/publishers"] = list(config.joined_publishers)
    entries |= _make_client_entries(config.credentials)
    entries |= _make_router_entries(config.router_security)
    made: zenoh.Config = zenoh.Config()
    for path, value in entries.items():
        made.insert_json5(path, json.dumps(value))
    return made


def find_lease_ms(mode: str) -> int:
    """Find the lease that sessions of a mode announce."""
    return ROUTER_LEASE_MS if mode == "router" else CLIENT_LEASE_MS


def _make_client_entries(credentials: Credentials | None) -> dict[str, object]:
    if credentials is None:
        return {}
    return {
        "transport/link/tls/root_ca_certificate_base64": _to_base64(credentials.authority),
        # The authority certifies one server only, whatever its address is.
        "transport/link/tls/verify_name_on_connect": False,
        "transport/auth/usrpwd/user": credentials.user,
        "transport/auth/usrpwd/password": credentials.password,
        **_make_certificate_entries(credentials),
    }


def _make_certificate_entries(credentials: Credentials) -> dict[str, object]:
    if not credentials.certificate:
        return {}
    kind, value = "_base64", _to_base64(credentials.certificate)
    if credentials.certificate_file:
        kind, value = "", credentials.certificate_file
    return {
        f"transport/link/tls/connect_certificate{kind}": value,
        f"transport/link/tls/connect_private_key{kind}": value,
        "transport/link/tls/enable_mtls": True,
    }


def _to_base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


def _make_router_entries(security: RouterSecurity | None) -> dict[str, object]:
    if security is None:
        return {}
    return {
        "transport/link/tls/listen_private_key": security.private_key,
        "transport/link/tls/listen_certificate": security.certificate,
        "transport/auth/usrpwd/user": ROUTER_USER,
        "transport/auth/usrpwd/password": uuid.uuid4().hex,
        "transport/auth/usrpwd/dictionary_file": security.passwords,
        "transport/unicast/max_sessions": MAX_SECURED_SESSIONS,
        "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
        "access_control": security.access_control,
        **_make_client_authority_entries(security.client_authority),
    }


def _make_client_authority_entries(authority: str) -> dict[str, object]:
    if not authority:
        return {}
    return {
        "transport/link/tls/root_ca_certificate": authority,
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/close_link_on_expiration": True,
    }
