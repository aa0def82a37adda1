"""Liveliness tokens of rmw_zenoh: nodes and their endpoints."""

from typing import Final, Literal

import msgspec
import xxhash

from zensim.proto.ros2 import rmw_keys
from zensim.proto.ros2.qos_profiles import Qos, read_qos, write_qos
from zensim.proto.ros2.rmw_attachment import GID_BYTES

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
