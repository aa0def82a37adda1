"""Liveliness tokens and QoS profiles with which rmw_zenoh and zenoh-bridge-ros2dds announce nodes and endpoints."""

import re
from typing import Final, Literal, TypeVar, get_args

import msgspec
import xxhash

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.ros2 import rmw_keys
from zensim.proto.ros2.rmw_attachment import GID_BYTES

BRIDGE_SLASH: Final = "§"
BRIDGE_TOKEN_SPACE: Final = "@ros2_lv"
BridgeKind = Literal["MP", "MS", "SS", "SC", "AS", "AC"]
"""A publisher or subscription of a topic, a server or client of a service or of an action."""
BRIDGE_TOPIC_KINDS: Final = ("MP", "MS")
BRIDGE_RELIABILITY: Final = {"best_effort": 0, "reliable": 1}
BRIDGE_DURABILITY: Final = {"volatile": 0, "transient_local": 1}
BRIDGE_KEEP_LAST: Final = 0
"""The numbers of CycloneDDS, which are not those of rmw."""


class BridgeRoute(msgspec.Struct, frozen=True, kw_only=True):
    """A topic, service or action that a bridge would carry."""

    zid: str
    kind: BridgeKind
    key: str
    """As data goes by: the name without its first slash."""
    ros_type: str
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    type_hash: str = ""


def make_bridge_token(zid: str) -> str:
    """Say that there is a bridge; declare it before those of its routes."""
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
    told = f"typehash={route.type_hash};" if route.type_hash else ""
    return ":".join(
        (
            "",
            str(BRIDGE_RELIABILITY[route.reliability]),
            str(BRIDGE_DURABILITY[route.durability]),
            f"{BRIDGE_KEEP_LAST},{route.depth}",
            told,
        )
    ).removesuffix("" if told else ":")


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
SPAN_PATTERN: Final = "([0-9]{0,10}),([0-9]{0,10})"
QOS_PATTERN: Final = re.compile(
    rf"([12]?):([12]?):([12]?),([0-9]{{0,20}}):{SPAN_PATTERN}:{SPAN_PATTERN}:([123]?),{SPAN_PATTERN}(?::|$)"
)


class Qos(msgspec.Struct, frozen=True, kw_only=True):
    """A profile; its defaults are those of rmw_zenoh."""

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
"""What `create_publisher(topic, 10)` and `create_service` of ROS 2 give."""
LATCHED: Final = Qos(durability="transient_local", depth=1)
"""The last value is for those too who come late."""


def write_qos(qos: Qos) -> str:
    """Write a profile as the last chunk of a token."""
    depth = "" if qos.depth == DEFAULT_QOS.depth else str(qos.depth)
    return ":".join(
        (
            _format_number(RMW_RELIABILITY, qos.reliability, DEFAULT_QOS.reliability),
            _format_number(RMW_DURABILITY, qos.durability, DEFAULT_QOS.durability),
            f"{_format_number(RMW_HISTORY, qos.history, DEFAULT_QOS.history)},{depth}",
            _format_span(qos.deadline_ns),
            _format_span(qos.lifespan_ns),
            f"{_format_number(RMW_LIVELINESS, qos.liveliness, DEFAULT_QOS.liveliness)},{_format_span(qos.lease_ns)}",
        )
    )


def read_qos(text: str) -> Qos | None:
    """Read what `write_qos` writes, and whatever follows; None when it is no profile."""
    found = QOS_PATTERN.match(text)
    if found is None:
        return None
    reliability, durability, history, depth, *spans, liveliness, lease_s, lease_ns = found.groups()
    return Qos(
        reliability=_parse_word(RMW_RELIABILITY, reliability, DEFAULT_QOS.reliability),
        durability=_parse_word(RMW_DURABILITY, durability, DEFAULT_QOS.durability),
        history=_parse_word(RMW_HISTORY, history, DEFAULT_QOS.history),
        depth=int(depth or DEFAULT_QOS.depth),
        deadline_ns=_parse_span(spans[0], spans[1]),
        lifespan_ns=_parse_span(spans[2], spans[3]),
        liveliness=_parse_word(RMW_LIVELINESS, liveliness, DEFAULT_QOS.liveliness),
        lease_ns=_parse_span(lease_s, lease_ns),
    )


def _format_number(numbers: dict[Word, int], word: Word, default: Word) -> str:
    return "" if word == default else str(numbers[word])


def _parse_word(numbers: dict[Word, int], number: str, default: Word) -> Word:
    return next((word for word, known in numbers.items() if str(known) == number), default)


def _format_span(span_ns: int) -> str:
    seconds, rest = divmod(span_ns, NANOSECONDS)
    return "," if span_ns == INFINITE_NS else f"{seconds},{rest}"


def _parse_span(seconds: str, rest: str) -> int:
    if not (seconds or rest):
        return INFINITE_NS
    return int(seconds or 0) * NANOSECONDS + int(rest or 0)


TOKEN_SPACE: Final = "@ros2_lv"
NODE_KIND: Final = "NN"
EndpointKind = Literal["MP", "MS", "SS", "SC"]
"""A publisher, a subscription, a service's server, a service's client."""
NODE_PARTS: Final = 9
ENDPOINT_PARTS: Final = 13
NUMBER_PATTERN: Final = re.compile("[0-9]{1,19}")


class GraphNode(msgspec.Struct, frozen=True, kw_only=True):
    """A node of ROS 2: who publishes and serves."""

    domain: int
    zid: str
    """Of its session, in hexadecimal digits."""
    number: int
    """Unique in the session, endpoints counted too."""
    namespace: str = "/"
    name: str
    enclave: str = ""


class GraphEndpoint(msgspec.Struct, frozen=True, kw_only=True):
    """A topic that a node publishes or hears, or a service that it offers or asks."""

    node: GraphNode
    number: int
    """Unique in the session, nodes counted too."""
    kind: EndpointKind
    name: str
    """With its namespace, as `/box_bot0/odom`."""
    ros_type: str
    type_hash: str
    qos: Qos = Qos()


def make_node_token(node: GraphNode) -> str:
    """Write the token of a node; declare it before those of its endpoints."""
    return _make_token_prefix(node, node.number, NODE_KIND)


def make_endpoint_token(endpoint: GraphEndpoint) -> str:
    """Write the token of an endpoint.

    Raises:
        ValueError: Its type is no ROS type.
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


def gid_from_token(token: str) -> bytes:
    """Find the 16 bytes that ROS knows an endpoint by: XXH3 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(GID_BYTES, "little")


def make_domain_pattern(domain: int) -> str:
    """All tokens of one domain."""
    return f"{TOKEN_SPACE}/{domain}/**"


def make_kind_pattern(domain: int, kind: str) -> str:
    """All tokens of nodes, or of one kind of endpoint, of one domain."""
    return f"{TOKEN_SPACE}/{domain}/*/*/*/{kind}/**"


def parse_token(key: str) -> GraphNode | GraphEndpoint | None:
    """Read a token; None when it is not one. What follows the qos is left unread."""
    parts = key.split("/")
    if len(parts) < NODE_PARTS or parts[0] != TOKEN_SPACE:
        return None
    if not all(NUMBER_PATTERN.fullmatch(parts[place]) for place in (1, 3, 4)):
        return None
    node = GraphNode(
        domain=int(parts[1]),
        zid=parts[2],
        number=int(parts[3]),
        enclave=rmw_keys.demangle_name(parts[6]).removeprefix("/"),
        namespace=rmw_keys.demangle_name(parts[7]),
        name=rmw_keys.demangle_name(parts[8]),
    )
    if parts[5] == NODE_KIND:
        return node
    return _parse_endpoint(node, parts) if len(parts) >= ENDPOINT_PARTS else None


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


def _parse_endpoint(node: GraphNode, parts: list[str]) -> GraphEndpoint | None:
    qos, ros_type = read_qos(parts[12]), rmw_keys.parse_dds_type(parts[10])
    for kind in get_args(EndpointKind):
        if kind == parts[5] and qos is not None and ros_type:
            return GraphEndpoint(
                node=node,
                number=int(parts[4]),
                kind=kind,
                name=rmw_keys.demangle_name(parts[9]),
                ros_type=ros_type,
                type_hash=parts[11],
                qos=qos,
            )
    return None
