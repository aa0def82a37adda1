"""Liveliness tokens and QoS profiles of rmw_zenoh and zenoh-bridge-ros2dds."""

from typing import Final, Literal, TypeVar

import msgspec
import xxhash

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.ros2 import rmw_keys
from zensim.proto.ros2.rmw_attachment import GID_BYTES

BRIDGE_SLASH: Final = "§"
BRIDGE_TOKEN_SPACE: Final = "@ros2_lv"
BridgeKind = Literal["MP", "MS", "SS", "SC", "AS", "AC"]
"""Publisher, subscription; service server, client; action server, client."""
BRIDGE_TOPIC_KINDS: Final = ("MP", "MS")
BRIDGE_RELIABILITY: Final = {"best_effort": 0, "reliable": 1}
BRIDGE_DURABILITY: Final = {"volatile": 0, "transient_local": 1}
BRIDGE_KEEP_LAST: Final = 0
"""Numbers of CycloneDDS, which differ from those of rmw."""


class BridgeRoute(msgspec.Struct, frozen=True, kw_only=True):
    """A topic, service or action, as a bridge announces it."""

    zid: str
    kind: BridgeKind
    key: str
    """Name without the first slash."""
    ros_type: str
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    type_hash: str = ""


def make_bridge_token(zid: str) -> str:
    """Write the token of a bridge; declare it before those of its routes."""
    return f"@/{zid}/{BRIDGE_TOKEN_SPACE}"


def make_route_token(route: BridgeRoute) -> str:
    """Write the token of a route."""
    token = "/".join(
        (
            make_bridge_token(route.zid),
            route.kind,
            _replace_slashes(route.key),
            _replace_slashes(route.ros_type),
        )
    )
    return f"{token}/{_format_bridge_qos(route)}" if route.kind in BRIDGE_TOPIC_KINDS else token


def _replace_slashes(name: str) -> str:
    return name.replace("/", BRIDGE_SLASH)


def _format_bridge_qos(route: BridgeRoute) -> str:
    type_hash = f"typehash={route.type_hash};" if route.type_hash else ""
    return ":".join(
        (
            "",
            str(BRIDGE_RELIABILITY[route.reliability]),
            str(BRIDGE_DURABILITY[route.durability]),
            f"{BRIDGE_KEEP_LAST},{route.depth}",
            type_hash,
        )
    ).removesuffix("" if type_hash else ":")


Reliability = Literal["reliable", "best_effort"]
Durability = Literal["transient_local", "volatile"]
History = Literal["keep_last", "keep_all"]
Liveliness = Literal["automatic", "manual_by_node", "manual_by_topic"]
Word = TypeVar("Word", bound=str)

RMW_RELIABILITY: Final[dict[Reliability, int]] = {"reliable": 1, "best_effort": 2}
RMW_DURABILITY: Final[dict[Durability, int]] = {"transient_local": 1, "volatile": 2}
RMW_HISTORY: Final[dict[History, int]] = {"keep_last": 1, "keep_all": 2}
RMW_LIVELINESS: Final[dict[Liveliness, int]] = {
    "automatic": 1,
    "manual_by_node": 2,
    "manual_by_topic": 3,
}
"""Numbers of rmw."""

INFINITE_NS: Final = (1 << 63) - 1


class Qos(msgspec.Struct, frozen=True, kw_only=True):
    """QoS profile, with the defaults of rmw_zenoh."""

    reliability: Reliability = "reliable"
    durability: Durability = "volatile"
    history: History = "keep_last"
    depth: int = 42
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: Liveliness = "automatic"
    lease_ns: int = INFINITE_NS


DEFAULT_QOS: Final = Qos()
RELIABLE_10: Final = Qos(depth=10)
"""Profile of `create_publisher(topic, 10)` and `create_service` in ROS 2."""
RELIABLE_5: Final = Qos(depth=5)
"""Profile of the sensors of gazebo_ros: `SensorDataQoS().reliable()`."""
LATCHED: Final = Qos(durability="transient_local", depth=1)
"""Late subscribers get the last message."""


def write_qos(qos: Qos) -> str:
    """Write a profile as the last chunk of a token."""
    depth = "" if qos.depth == DEFAULT_QOS.depth else str(qos.depth)
    liveliness = _format_number(RMW_LIVELINESS, qos.liveliness, DEFAULT_QOS.liveliness)
    return ":".join(
        (
            _format_number(RMW_RELIABILITY, qos.reliability, DEFAULT_QOS.reliability),
            _format_number(RMW_DURABILITY, qos.durability, DEFAULT_QOS.durability),
            f"{_format_number(RMW_HISTORY, qos.history, DEFAULT_QOS.history)},{depth}",
            _format_span(qos.deadline_ns),
            _format_span(qos.lifespan_ns),
            f"{liveliness},{_format_span(qos.lease_ns)}",
        )
    )


def _format_number(numbers: dict[Word, int], word: Word, default: Word) -> str:
    return "" if word == default else str(numbers[word])


def _format_span(span_ns: int) -> str:
    seconds, rest = divmod(span_ns, NANOSECONDS)
    return "," if span_ns == INFINITE_NS else f"{seconds},{rest}"


TOKEN_SPACE: Final = "@ros2_lv"
NODE_KIND: Final = "NN"
EndpointKind = Literal["MP", "MS", "SS", "SC"]
"""Publisher, subscription, service server, service client."""


class GraphNode(msgspec.Struct, frozen=True, kw_only=True):
    """A ROS 2 node."""

    domain: int
    zid: str
    """Session id, in hexadecimal digits."""
    number: int
    """Unique among nodes and endpoints of the session."""
    namespace: str = "/"
    name: str
    enclave: str = ""


class GraphEndpoint(msgspec.Struct, frozen=True, kw_only=True):
    """A publisher, subscription, service server or client of a node."""

    node: GraphNode
    number: int
    """Unique among nodes and endpoints of the session."""
    kind: EndpointKind
    name: str
    """Name with namespace, as `/box_bot0/odom`."""
    ros_type: str
    type_hash: str
    qos: Qos = Qos()


def make_node_token(node: GraphNode) -> str:
    """Write the token of a node; declare it before those of its endpoints."""
    return _make_token_prefix(node, node.number, NODE_KIND)


def make_endpoint_token(endpoint: GraphEndpoint) -> str:
    """Write the token of an endpoint.

    Raises:
        ValueError: `ros_type` is not valid.
    """
    return "/".join(
        (
            _make_token_prefix(endpoint.node, endpoint.number, endpoint.kind),
            rmw_keys.mangle_name(endpoint.name),
            rmw_keys.to_dds_type(endpoint.ros_type),
            endpoint.type_hash,
            write_qos(endpoint.qos),
        )
    )


class AnnouncedEndpoint(msgspec.Struct, frozen=True):
    """An endpoint, as its token announces it."""

    kind: str
    key: str
    """Name without the first slash."""
    node: str
    """Node with namespace, as `/box_bot0/agent`."""
    ros_type: str
    qos: Qos


def parse_endpoint_token(token: str) -> AnnouncedEndpoint | None:
    """Parse the token of an endpoint; None for that of a node, and for any other key."""
    match token.split("/"):
        case [start, _, _, _, _, kind, _, namespace, node, name, dds, _, qos]:
            if start != TOKEN_SPACE:
                return None
            return AnnouncedEndpoint(
                kind,
                rmw_keys.demangle_name(name).strip("/"),
                f"{rmw_keys.demangle_name(namespace).rstrip('/')}/{rmw_keys.demangle_name(node)}",
                rmw_keys.parse_dds_type(dds),
                read_qos(qos),
            )
    return None


def read_qos(chunk: str) -> Qos:
    """Read reliability, durability, history and depth of a profile; defaults for what is odd."""
    reliability, durability, history, *_ = [*chunk.split(":"), "", "", ""]
    kind, _, depth = history.partition(",")
    return Qos(
        reliability=_find_word(RMW_RELIABILITY, reliability, DEFAULT_QOS.reliability),
        durability=_find_word(RMW_DURABILITY, durability, DEFAULT_QOS.durability),
        history=_find_word(RMW_HISTORY, kind, DEFAULT_QOS.history),
        depth=int(depth) if depth.isdigit() else DEFAULT_QOS.depth,
    )


def _find_word(numbers: dict[Word, int], written: str, default: Word) -> Word:
    return next((word for word, number in numbers.items() if str(number) == written), default)


def gid_from_token(token: str) -> bytes:
    """Compute the gid (16 bytes) of an endpoint: XXH3 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(GID_BYTES, "little")


def _make_token_prefix(node: GraphNode, number: int, kind: str) -> str:
    return "/".join(
        (
            TOKEN_SPACE,
            str(node.domain),
            node.zid,
            str(node.number),
            str(number),
            kind,
            rmw_keys.mangle_name(node.enclave),
            rmw_keys.mangle_name(node.namespace),
            rmw_keys.mangle_name(node.name),
        )
    )
