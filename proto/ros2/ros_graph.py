"""The ROS 2 graph of one process: nodes and their endpoints, announced by liveliness tokens."""

import uuid
from itertools import count
from typing import TYPE_CHECKING, Final

import msgspec

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.network_protocols import Closable, TokenQueue, TokenSession
from zensim.proto.ros2 import bridge_tokens, rmw_keys
from zensim.proto.ros2.liveliness_tokens import (
    EndpointKind,
    GraphEndpoint,
    GraphNode,
    gid_from_token,
    make_endpoint_token,
    make_node_token,
)
from zensim.proto.ros2.qos_profiles import RELIABLE_10, Qos
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.ros2.type_hash import hash_type

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_NODES_PER_ID: Final = 100
"""Nodes with the same session id in their tokens. The time of a router to declare a token grows
with the tokens beside it, which differ in the chunk after that id only."""

SHARED_NAMESPACE: Final = "/zensim_robots"
"""Beginning of the namespaces of nodes that robots beyond the first hundred share."""

MAX_ROBOTS_ANNOUNCED: Final = 500
"""Robots of a process whose endpoints are announced when they join. A router compares all tokens
with each other when an observer joins, and no message passes meanwhile: 2 s for 9000 tokens."""
MAX_ROBOTS_ANNOUNCED_LATE: Final = 250
"""Further ones that are announced because they have subscribers."""

ACTION_INFIX: Final = "/_action/"
"""Infix of an action's services and topics, which are announced to a bridge as one action."""


class NodeGroup:
    """What declares the tokens of some nodes, the session id in them, and the number of nodes."""

    shared: "RosNode | None" = None
    """Node that robots of the group are part of; None if it has no robots, or each has its own."""

    def __init__(self, session: TokenSession | TokenQueue, zid: str) -> None:
        self.session = session
        self.zid = zid
        self.nodes = 0


class RosGraph:
    """ROS 2 nodes of one process."""

    def __init__(self, session: TokenSession, settings: RosSettings) -> None:
        self.settings = settings
        self.zid = session.zid
        self.numbers = count()
        """Ids of nodes and endpoints."""
        self.nodes: dict[RosNode, None] = {}
        self.kinds: dict[str, type[msgspec.Struct]] = {}
        """Messages of the endpoints by type hash."""
        self.announced_robots = 0
        """Nodes that `add_robot` and `announce_late` have announced, and that are not closed."""
        self.late_announcements = 0
        """Calls of `announce_late` that announced a node."""
        self._session = session
        self._groups = [NodeGroup(session, self.zid)]
        self._queue: TokenQueue | None = None
        self._bridge = (
            session.token(bridge_tokens.make_bridge_token(self.zid)) if self._is_bridged else None
        )

    @property
    def domain(self) -> int | None:
        """ROS domain id; None if there are no ROS 2 endpoints."""
        return self.settings.domain

    def add_node(self, namespace: str, name: str) -> "RosNode | None":
        """Add a node and announce it; None if there are no ROS 2 endpoints."""
        if (node := self._add(namespace, name)) is not None:
            node.announce()
        return node

    def add_robot(self, namespace: str, name: str) -> "RosNode | None":
        """Add the node of one of many robots; it is announced if there are not too many.

        The endpoints of robots beyond the first hundred nodes of the process belong to a node that
        a hundred robots share: `ros2 param list` calls each node in turn.
        """
        node = self._add(namespace, name, may_share=True)
        if node is not None and self.announced_robots < MAX_ROBOTS_ANNOUNCED:
            self._announce(node)
        return node

    def announce_late(self, node: "RosNode") -> None:
        """Announce the node of a robot that has a subscriber, if there are not too many."""
        most = MAX_ROBOTS_ANNOUNCED + MAX_ROBOTS_ANNOUNCED_LATE
        if not node.is_announced and self.announced_robots < most:
            self.late_announcements += 1
            self._announce(node)

    def _announce(self, node: "RosNode") -> None:
        self.announced_robots += 1
        node.is_counted = True
        node.announce()

    def _add(self, namespace: str, name: str, *, may_share: bool = False) -> "RosNode | None":
        if self.domain is None:
            return None
        group = self._find_free_group()
        is_shared = may_share and group is not self._groups[0]
        shared = self._share_node(group, name) if is_shared else None
        return self._make_node(f"/{namespace.strip('/')}", name, group, shared)

    def _share_node(self, group: NodeGroup, name: str) -> "RosNode":
        """Find the node that robots of a group share, or add it."""
        if group.shared is None:
            group.shared = self._make_node(f"{SHARED_NAMESPACE}_{group.zid[:8]}", name, group, None)
        return group.shared

    def _make_node(
        self, namespace: str, name: str, group: NodeGroup, shared: "RosNode | None"
    ) -> "RosNode":
        node = GraphNode(
            domain=self.domain or 0,
            zid=group.zid,
            number=next(self.numbers),
            namespace=namespace,
            name=name,
        )
        ros_node = RosNode(self, node, group, shared)
        # Zenoh undeclares tokens that are garbage collected.
        self.nodes[ros_node] = None
        return ros_node

    def data_key(self, topic: "RosTopic") -> str:
        """Write the ROS 2 data key of a topic, or of the pattern of several."""
        return rmw_keys.make_data_key(
            self.domain or 0, topic.key, topic.ros_type, self.find_type_hash(topic)
        )

    def find_type_hash(self, topic: "RosTopic") -> str:
        """Find the type hash of a topic in the distribution."""
        return hash_type(topic.kind) if self.settings.has_hashes else rmw_keys.NO_HASH

    def close(self) -> None:
        """Close all nodes and the session that was opened for them."""
        for node in tuple(self.nodes):
            node.close()
        del self._groups[1:]
        if self._queue is not None:
            self._queue.close()
            self._queue = None
        if self._bridge is not None:
            self._bridge.close()
            self._bridge = None

    @property
    def _is_bridged(self) -> bool:
        return self.settings.is_bridged and self.domain is not None

    def _find_free_group(self) -> NodeGroup:
        """Find a group with room; the tokens of all but the first are declared later."""
        for group in self._groups:
            if group.nodes < MAX_NODES_PER_ID:
                return group
        if self._queue is None:
            self._queue = self._session.open_token_queue()
        # A Zenoh id has no leading zeros.
        self._groups.append(NodeGroup(self._queue, f"{uuid.uuid4().int | 1 << 127:x}"))
        return self._groups[-1]


class RosTopic(msgspec.Struct, frozen=True):
    """ROS 2 endpoint description of a topic: plain key, type and QoS."""

    key: str
    kind: type[msgspec.Struct]
    qos: Qos = RELIABLE_10
    name: str = ""
    """Name in the topic catalog, for topics of robots; see `RosSettings.has_topic`."""

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
        """ROS type as `pkg/msg/Name`."""
        return str(getattr(self.kind, "ros_type", ""))


class RosNode:
    """A ROS 2 node and its endpoints."""

    __slots__ = (
        *("_group", "_name", "_tokens", "_unannounced", "domain", "graph", "graph_node"),
        *("is_announced", "is_closed", "is_counted", "members", "on_close", "shared"),
    )

    def __init__(
        self, graph: RosGraph, node: GraphNode, group: NodeGroup, shared: "RosNode | None" = None
    ) -> None:
        self.graph = graph
        self.domain = node.domain
        self.graph_node: GraphNode = node if shared is None else shared.graph_node
        """Node that has the endpoints."""
        self._name = (node.namespace, node.name)
        self._group = group
        self.shared = shared
        """Node that the robot shares with others; None if it has its own."""
        self.members = 0
        """Robots that share the node."""
        if shared is not None:
            shared.members += 1
        group.nodes += 1
        self._tokens: list[Closable] = []
        self._unannounced: list[GraphEndpoint | str] = []
        """Endpoints and other tokens; the text of an endpoint's is made when it is declared."""
        self.is_counted = False
        """Whether it is among `RosGraph.announced_robots`."""
        self.is_announced = False
        """Whether its tokens, and those that are added, are declared."""
        self.is_closed = False
        """Whether the node has left the graph."""
        self.on_close: Callable[[], None] | None = None
        """Called when the node leaves the graph."""

    @property
    def full_name(self) -> str:
        """Name with namespace, as `/box_bot0/agent`."""
        return rmw_keys.qualify_name(*self._name)

    def announce(self) -> None:
        """Declare the tokens of the node and of its endpoints, also of later ones."""
        if self.is_announced:
            return
        self.is_announced = True
        tokens, self._unannounced = self._unannounced, []
        if self.shared is None:
            self._declare(make_node_token(self.graph_node))
        else:
            self.shared.announce()
        for token in tokens:
            self._declare(token)

    def _declare(self, token: GraphEndpoint | str) -> None:
        if not self.is_announced:
            self._unannounced.append(token)
            return
        text = token if isinstance(token, str) else make_endpoint_token(token)
        self._tokens.append(self._group.session.token(text))

    def data_key(self, topic: RosTopic) -> str:
        """Write the ROS 2 data key of a topic."""
        return self.graph.data_key(topic)

    def announce_cache(self, key: str) -> None:
        """Announce a queryable of last messages, which subscribers query when it appears."""
        self._declare(key)

    def add_topic_endpoint(self, kind: EndpointKind, topic: RosTopic) -> GraphEndpoint:
        """Announce a publisher or subscription of the node."""
        type_hash = self.graph.find_type_hash(topic)
        self.graph.kinds[type_hash] = topic.kind
        is_hidden = kind == "MS" and self.graph.settings.hides_from_bridge(topic.ros_type)
        return self.add_endpoint(
            kind,
            topic.key,
            topic.ros_type,
            type_hash=type_hash,
            qos=topic.qos,
            bridge_key=None if is_hidden else "",
        )

    def add_endpoint(
        self,
        kind: EndpointKind,
        key: str,
        ros_type: str,
        *,
        type_hash: str,
        qos: Qos = RELIABLE_10,
        bridge_key: str | None = "",
    ) -> GraphEndpoint:
        """Announce an endpoint by its plain key.

        `bridge_key` overrides it for a bridge; None = a bridge does not see the endpoint.
        """
        endpoint = GraphEndpoint(
            node=self.graph_node,
            number=next(self.graph.numbers),
            kind=kind,
            name=rmw_keys.qualify_name("", key),
            ros_type=ros_type,
            type_hash=type_hash,
            qos=qos,
        )
        self._declare(endpoint)
        is_bridged = self.graph.settings.is_bridged and ACTION_INFIX not in endpoint.name
        if is_bridged and bridge_key is not None:
            self._declare(_make_route_token(endpoint, bridge_key, self.graph.zid))
        return endpoint

    def announce_action(self, key: str, ros_type: str) -> None:
        """Announce an action to a bridge, which sees no single services and topics of it."""
        if self.graph.settings.is_bridged:
            route = bridge_tokens.BridgeRoute(
                zid=self.graph.zid, kind="AS", key=key, ros_type=ros_type
            )
            self._declare(bridge_tokens.make_route_token(route))

    def close(self) -> None:
        """Undeclare all tokens, that of the node last; further calls do nothing."""
        if self.on_close is not None:
            self.on_close()
            self.on_close = None
        if self in self.graph.nodes:
            del self.graph.nodes[self]
            self._group.nodes -= 1
            self.graph.announced_robots -= self.is_counted
        was_closed, self.is_closed = self.is_closed, True
        while self._tokens:
            self._tokens.pop().close()
        if self.shared is not None and not was_closed:
            self.shared.remove_member()

    def remove_member(self) -> None:
        """Remove a robot that shares the node; the node is closed with its last one."""
        self.members -= 1
        if self.members == 0:
            if self._group.shared is self:
                self._group.shared = None
            self.close()


def gid_from_endpoint(endpoint: GraphEndpoint) -> bytes:
    """Compute the gid (16 bytes) of an endpoint."""
    return gid_from_token(make_endpoint_token(endpoint))


def _make_route_token(endpoint: GraphEndpoint, key: str, zid: str) -> str:
    qos = endpoint.qos
    return bridge_tokens.make_route_token(
        bridge_tokens.BridgeRoute(
            zid=zid,
            kind=endpoint.kind,
            key=key or endpoint.name.strip("/"),
            ros_type=endpoint.ros_type,
            reliability=qos.reliability,
            durability=qos.durability,
            depth=qos.depth,
            type_hash=endpoint.type_hash,
        )
    )
