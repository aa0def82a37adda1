"""The ROS 2 graph of one process: nodes and their endpoints, announced by liveliness tokens."""

from itertools import count
from typing import Final

import msgspec

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.network_protocols import TokenSession
from zensim.proto.ros2 import liveliness_tokens, rmw_keys
from zensim.proto.ros2.liveliness_tokens import (
    RELIABLE_10,
    EndpointKind,
    GraphEndpoint,
    GraphNode,
    Qos,
    gid_from_token,
    make_endpoint_token,
    make_node_token,
)
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.ros2.type_hash import hash_type

MAX_NODES_PER_SESSION: Final = 100
"""Declaring tokens takes time by the square of how many a session has."""

ACTION_INFIX: Final = "/_action/"
"""In the names of an action's services and topics, of which a bridge is not told one by one."""


class GraphSession:
    """A session, and how many nodes have their tokens there."""

    def __init__(self, session: TokenSession) -> None:
        self.session = session
        self.nodes = 0


class RosGraph:
    """The nodes of one process."""

    def __init__(self, session: TokenSession, settings: RosSettings) -> None:
        self.settings = settings
        self.zid = session.zid
        self.numbers = count()
        """Nodes and endpoints are numbered together."""
        self.nodes: list[RosNode] = []
        self._sessions = [GraphSession(session)]
        self._bridge = (
            session.token(liveliness_tokens.make_bridge_token(self.zid))
            if self._is_bridged
            else None
        )

    @property
    def domain(self) -> int | None:
        """The ROS domain; None when there is nothing of ROS 2 here."""
        return self.settings.domain

    def add_node(self, namespace: str, name: str) -> "RosNode | None":
        """Add a node; None when there is nothing of ROS 2 here."""
        if self.domain is None:
            return None
        node = GraphNode(
            domain=self.domain,
            zid=self.zid,
            number=next(self.numbers),
            namespace=f"/{namespace.strip('/')}",
            name=name,
        )
        found = RosNode(self, node, self._find_free_session())
        # A token goes when nobody holds it.
        self.nodes.append(found)
        return found

    def data_key(self, topic: "Topic") -> str:
        """Find the key of a topic's data, or the pattern of several, in ROS 2's form."""
        return rmw_keys.make_data_key(
            self.domain or 0, topic.key, topic.ros_type, self.find_type_hash(topic)
        )

    def find_type_hash(self, topic: "Topic") -> str:
        """Find the hash of a topic's type, as the distribution has it."""
        return hash_type(topic.kind) if self.settings.has_hashes else rmw_keys.NO_HASH

    def close(self) -> None:
        """Withdraw all nodes, and end the sessions that were opened beside."""
        for node in tuple(self.nodes):
            node.close()
        for seat in self._sessions[1:]:
            seat.session.close()
        del self._sessions[1:]
        if self._bridge is not None:
            self._bridge.close()
            self._bridge = None

    @property
    def _is_bridged(self) -> bool:
        return self.settings.is_bridged and self.domain is not None

    def _find_free_session(self) -> GraphSession:
        for seat in self._sessions:
            if seat.nodes < MAX_NODES_PER_SESSION:
                return seat
        self._sessions.append(GraphSession(self._sessions[0].session.open_session()))
        return self._sessions[-1]


class Topic(msgspec.Struct, frozen=True):
    """A topic of one type, by its plain key."""

    key: str
    kind: type[msgspec.Struct]
    qos: Qos = RELIABLE_10

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers get the last message."""
        return self.qos.durability == "transient_local"

    @property
    def encoding(self) -> str:
        """Zenoh Encoding of the messages, which are CDR."""
        return make_encoding(self.kind, Format.CDR)

    @property
    def ros_type(self) -> str:
        """As `pkg/msg/Name`."""
        return str(getattr(self.kind, "ros_type", ""))


class RosNode:
    """One node; closing it withdraws its endpoints, then itself."""

    def __init__(self, graph: RosGraph, node: GraphNode, address: GraphSession) -> None:
        self.graph = graph
        self.domain = node.domain
        self._node = node
        self._session = address
        address.nodes += 1
        self._tokens = [address.session.token(make_node_token(node))]

    def data_key(self, topic: Topic) -> str:
        """Find the key of a topic's data in ROS 2's form."""
        return self.graph.data_key(topic)

    def add_topic_endpoint(self, kind: EndpointKind, topic: Topic) -> GraphEndpoint:
        """Say that the node publishes a topic, or hears it."""
        return self.add_endpoint(
            kind,
            topic.key,
            topic.ros_type,
            type_hash=self.graph.find_type_hash(topic),
            qos=topic.qos,
        )

    def add_endpoint(
        self,
        kind: EndpointKind,
        key: str,
        ros_type: str,
        *,
        type_hash: str,
        qos: Qos = RELIABLE_10,
        bridge_key: str = "",
    ) -> GraphEndpoint:
        """Say that the node has an endpoint, by its plain key; a bridge may see another key."""
        endpoint = GraphEndpoint(
            node=self._node,
            number=next(self.graph.numbers),
            kind=kind,
            name=rmw_keys.qualify_name("", key),
            ros_type=ros_type,
            type_hash=type_hash,
            qos=qos,
        )
        self._tokens.append(self._session.session.token(make_endpoint_token(endpoint)))
        if self.graph.settings.is_bridged and ACTION_INFIX not in endpoint.name:
            self._tokens.append(
                self._session.session.token(_make_route_token(endpoint, bridge_key))
            )
        return endpoint

    def announce_action(self, key: str, ros_type: str) -> None:
        """Tell a bridge of an action, whose services and topics are one to it."""
        if self.graph.settings.is_bridged:
            route = liveliness_tokens.BridgeRoute(
                zid=self._node.zid, kind="AS", key=key, ros_type=ros_type
            )
            self._tokens.append(
                self._session.session.token(liveliness_tokens.make_route_token(route))
            )

    def close(self) -> None:
        """Withdraw all tokens, the node's last; once is enough."""
        if self in self.graph.nodes:
            self.graph.nodes.remove(self)
            self._session.nodes -= 1
        while self._tokens:
            self._tokens.pop().close()


def gid_from_endpoint(endpoint: GraphEndpoint) -> bytes:
    """Find the 16 bytes that ROS 2 knows an endpoint by."""
    return gid_from_token(make_endpoint_token(endpoint))


def _make_route_token(endpoint: GraphEndpoint, key: str) -> str:
    qos = endpoint.qos
    return liveliness_tokens.make_route_token(
        liveliness_tokens.BridgeRoute(
            zid=endpoint.node.zid,
            kind=endpoint.kind,
            key=key or endpoint.name.strip("/"),
            ros_type=endpoint.ros_type,
            reliability=qos.reliability,
            durability=qos.durability,
            depth=qos.depth,
            type_hash=endpoint.type_hash,
        )
    )
