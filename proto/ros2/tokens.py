"""Liveliness tokens by which rmw_zenoh tells of nodes, topics and services.

`@ros2_lv/<domain>/<zid>/<node>/<entity>/<kind>/<enclave>/<namespace>/<node name>`, and for an
endpoint `/<name>/<type>/<hash>/<qos>` more; `@` keeps them from every `**`.
"""

import re
from typing import Final, Literal, get_args

import msgspec
import xxhash

from zensim.proto.ros2 import names
from zensim.proto.ros2.attachment import GID_BYTES
from zensim.proto.ros2.qos import Qos, read_qos, write_qos

SPACE: Final = "@ros2_lv"
NODE_KIND: Final = "NN"
EndpointKind = Literal["MP", "MS", "SS", "SC"]
"""A publisher, a subscription, a service's server, a service's client."""
NODE_PARTS: Final = 9
ENDPOINT_PARTS: Final = 13
NUMBER: Final = re.compile("[0-9]{1,19}")


class Node(msgspec.Struct, frozen=True, kw_only=True):
    """A node of ROS 2: who publishes and serves."""

    domain: int
    zid: str
    """Of its session, in hexadecimal digits."""
    number: int
    """Unique in the session, endpoints counted too."""
    namespace: str = "/"
    name: str
    enclave: str = ""


class Endpoint(msgspec.Struct, frozen=True, kw_only=True):
    """A topic that a node publishes or hears, or a service that it offers or asks."""

    node: Node
    number: int
    """Unique in the session, nodes counted too."""
    kind: EndpointKind
    name: str
    """With its namespace, as `/box_bot0/odom`."""
    ros_type: str
    type_hash: str
    qos: Qos = Qos()


def node_token(node: Node) -> str:
    """Write the token of a node; declare it before those of its endpoints."""
    return _beginning(node, node.number, NODE_KIND)


def endpoint_token(endpoint: Endpoint) -> str:
    """Write the token of an endpoint.

    Raises:
        ValueError: Its type is no ROS type.
    """
    return "/".join(
        (
            _beginning(endpoint.node, endpoint.number, endpoint.kind),
            names.mangled(endpoint.name),
            names.dds_type(endpoint.ros_type),
            endpoint.type_hash,
            write_qos(endpoint.qos),
        )
    )


def gid_of(token: str) -> bytes:
    """Find the 16 bytes that ROS knows an endpoint by: XXH3 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(GID_BYTES, "little")


def tokens_of_domain(domain: int) -> str:
    """All tokens of one domain."""
    return f"{SPACE}/{domain}/**"


def tokens_of_kind(domain: int, kind: str) -> str:
    """All tokens of nodes, or of one kind of endpoint, of one domain."""
    return f"{SPACE}/{domain}/*/*/*/{kind}/**"


def parse_token(key: str) -> Node | Endpoint | None:
    """Read a token; None when it is not one. What follows the qos is left unread."""
    parts = key.split("/")
    if len(parts) < NODE_PARTS or parts[0] != SPACE:
        return None
    if not all(NUMBER.fullmatch(parts[place]) for place in (1, 3, 4)):
        return None
    node = Node(
        domain=int(parts[1]),
        zid=parts[2],
        number=int(parts[3]),
        enclave=names.demangled(parts[6]).removeprefix("/"),
        namespace=names.demangled(parts[7]),
        name=names.demangled(parts[8]),
    )
    if parts[5] == NODE_KIND:
        return node
    return _endpoint(node, parts) if len(parts) >= ENDPOINT_PARTS else None


def _beginning(node: Node, number: int, kind: str) -> str:
    return "/".join(
        (
            SPACE,
            str(node.domain),
            node.zid,
            str(node.number),
            str(number),
            kind,
            names.mangled(node.enclave),
            names.mangled(node.namespace),
            names.mangled(node.name),
        )
    )


def _endpoint(node: Node, parts: list[str]) -> Endpoint | None:
    qos, ros_type = read_qos(parts[12]), names.ros_type(parts[10])
    for kind in get_args(EndpointKind):
        if kind == parts[5] and qos is not None and ros_type:
            return Endpoint(
                node=node,
                number=int(parts[4]),
                kind=kind,
                name=names.demangled(parts[9]),
                ros_type=ros_type,
                type_hash=parts[11],
                qos=qos,
            )
    return None
