"""Parser of liveliness tokens and QoS profiles, as peers read them."""

import re
from typing import Final, get_args

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.ros2.liveliness_tokens import (
    NODE_KIND,
    TOKEN_SPACE,
    EndpointKind,
    GraphEndpoint,
    GraphNode,
)
from zensim.proto.ros2.qos_profiles import (
    DEFAULT_QOS,
    INFINITE_NS,
    RMW_DURABILITY,
    RMW_HISTORY,
    RMW_LIVELINESS,
    RMW_RELIABILITY,
    Qos,
    Word,
)
from zensim.proto.ros2.rmw_keys import parse_dds_type

NUMBER_PATTERN: Final = re.compile("[0-9]{1,19}")
NODE_PARTS: Final = 9
ENDPOINT_PARTS: Final = 13
SPAN_PATTERN: Final = "([0-9]{0,10}),([0-9]{0,10})"
QOS_PATTERN: Final = re.compile(
    rf"([12]?):([12]?):([12]?),([0-9]{{0,20}}):{SPAN_PATTERN}:{SPAN_PATTERN}:([123]?),{SPAN_PATTERN}(?::|$)"
)


def demangle_name(chunk: str) -> str:
    """Convert a chunk of a key to a name; `%` is the root, `/`."""
    return chunk.replace("%", "/")


def parse_token(key: str) -> GraphNode | GraphEndpoint | None:
    """Parse a token; None if it is not one. Chunks after the QoS are ignored."""
    parts = key.split("/")
    if len(parts) < NODE_PARTS or parts[0] != TOKEN_SPACE:
        return None
    if not all(NUMBER_PATTERN.fullmatch(parts[place]) for place in (1, 3, 4)):
        return None
    node = GraphNode(
        domain=int(parts[1]),
        zid=parts[2],
        number=int(parts[3]),
        enclave=demangle_name(parts[6]).removeprefix("/"),
        namespace=demangle_name(parts[7]),
        name=demangle_name(parts[8]),
    )
    if parts[5] == NODE_KIND:
        return node
    return _parse_endpoint(node, parts) if len(parts) >= ENDPOINT_PARTS else None


def _parse_endpoint(node: GraphNode, parts: list[str]) -> GraphEndpoint | None:
    qos, ros_type = read_qos(parts[12]), parse_dds_type(parts[10])
    for kind in get_args(EndpointKind):
        if kind == parts[5] and qos is not None and ros_type:
            return GraphEndpoint(
                node=node,
                number=int(parts[4]),
                kind=kind,
                name=demangle_name(parts[9]),
                ros_type=ros_type,
                type_hash=parts[11],
                qos=qos,
            )
    return None


def read_qos(text: str) -> Qos | None:
    """Parse a QoS profile; None if it is not one."""
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


def _parse_word(numbers: dict[Word, int], number: str, default: Word) -> Word:
    return next((word for word, known in numbers.items() if str(known) == number), default)


def _parse_span(seconds: str, rest: str) -> int:
    if not (seconds or rest):
        return INFINITE_NS
    return int(seconds or 0) * NANOSECONDS + int(rest or 0)
