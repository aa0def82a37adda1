"""Grammar of rmw_zenoh's liveliness tokens, written from its design, not from our code.

node      @ros2_lv/DOMAIN/ZID/NODE/NODE/NN/ENCLAVE/NAMESPACE/NAME
endpoint  @ros2_lv/DOMAIN/ZID/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME/TOPIC/TYPE/HASH/QOS

Names use % for /; ROS names consist of letters, digits and _, and do not begin with a digit.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from tests.proto.ros_hashes import hash_of_message, hash_of_service

WORD = "[A-Za-z_][A-Za-z0-9_]*"
NAME = f"(?:%{WORD})+"
QOS = "([12]?):([12]?):([12]?),([0-9]*):[0-9]*,[0-9]*:[0-9]*,[0-9]*:[123]?,[0-9]*,[0-9]*"
TYPE = "([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Z][A-Za-z0-9_]*)_"
NODE = re.compile(f"@ros2_lv/([0-9]+)/([0-9a-f]+)/([0-9]+)/([0-9]+)/NN/%/(%|{NAME})/({WORD})")
ENDPOINT = re.compile(
    "@ros2_lv/([0-9]+)/([0-9a-f]+)/([0-9]+)/([0-9]+)/(MP|MS|SS|SC)/%"
    f"/(%|{NAME})/({WORD})/({NAME})/{TYPE}/(RIHS01_[0-9a-f]{{64}}|TypeHashNotSupported)/({QOS})"
)
HUMBLE_HASH = "TypeHashNotSupported"
LONGEST = 247
"""Maximum number of characters of a topic with its namespace."""
VERSION_1 = {
    "simulation_interfaces/srv/SpawnEntity": "RIHS01_"
    "d4c086345d4194a5fc4c9ae45095736ca4062b5cdac4d06a42dec93d683e03cf",
    "simulation_interfaces/srv/LoadWorld": "RIHS01_"
    "f210682338f195f6f06191b46b20ec4992bddf485d33e2cffab2dd15341b4e3e",
    "simulation_interfaces/srv/SetEntityState": "RIHS01_"
    "ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e",
    "simulation_interfaces/srv/GetSpawnables": "RIHS01_"
    "3bc0266bf8236058ff589c44512e013afe4f295427c39d44cff363d1c956bf36",
}
"""Published hashes of types that differ between simulation_interfaces 1.x and 2.1."""


class InvalidToken(AssertionError):
    """A token that rmw_zenoh would reject."""


@dataclass(frozen=True)
class TokenNode:
    """A node."""

    domain: int
    zid: str
    number: int
    name: str


@dataclass(frozen=True)
class TokenEndpoint:
    """A publisher, subscription, server or client."""

    node: TokenNode
    number: int
    kind: str
    name: str
    ros_type: str
    type_hash: str
    qos: str
    """Reliability, durability, history and depth, as in the token."""

    @property
    def key(self) -> str:
        """Key of its data."""
        package, kind, name = self.ros_type.split("/")
        dds = f"{package}::{kind}::dds_::{name}_"
        return f"{self.node.domain}{self.name}/{dds}/{self.type_hash}"


def parse_endpoints(tokens: Iterable[str]) -> list[TokenEndpoint]:
    """Parse all tokens of a network, and check their consistency.

    Raises:
        NoToken: A token is malformed or inconsistent with others.
    """
    nodes: set[TokenNode] = set()
    endpoints = []
    for token in tokens:
        if found := NODE.fullmatch(token):
            domain, zid, number, again, namespace, name = found.groups()
            if number != again:
                raise InvalidToken(f"node_number {token}")
            nodes.add(TokenNode(int(domain), zid, int(number), _full(namespace, name)))
        else:
            endpoints.append(_endpoint(token))
    numbers = [(one.zid, one.number) for one in nodes]
    numbers += [(one.node.zid, one.number) for one in endpoints]
    if len(set(numbers)) < len(numbers):
        raise InvalidToken("duplicate_number")
    for one in endpoints:
        if one.node not in nodes:
            raise InvalidToken(f"unknown_node {one}")
    return endpoints


def check_hash(endpoint: TokenEndpoint, *, has_hashes: bool) -> None:
    """Compare a type hash with an independent implementation or the published value.

    Raises:
        NoToken: The hashes differ.
    """
    find = hash_of_message if endpoint.kind in ("MP", "MS") else hash_of_service
    known = (
        {find(endpoint.ros_type), VERSION_1.get(endpoint.ros_type)} if has_hashes else {HUMBLE_HASH}
    )
    if endpoint.type_hash not in known:
        raise InvalidToken(f"hash {endpoint}; expected {known}")


def _endpoint(token: str) -> TokenEndpoint:
    found = ENDPOINT.fullmatch(token)
    if found is None:
        raise InvalidToken(token)
    domain, zid, node, number, kind, namespace, name, topic = found.groups()[:8]
    package, folder, type_name, type_hash = found.groups()[8:12]
    if len(topic) > LONGEST:
        raise InvalidToken(f"topic_length {len(topic)}: {token}")
    return TokenEndpoint(
        TokenNode(int(domain), zid, int(node), _full(namespace, name)),
        int(number),
        kind,
        topic.replace("%", "/"),
        f"{package}/{folder}/{type_name}",
        type_hash,
        ":".join(found.group(13).split(":")[:3]),
    )


def _full(namespace: str, name: str) -> str:
    return f"{'' if namespace == '%' else namespace.replace('%', '/')}/{name}"
