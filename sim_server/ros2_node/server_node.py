"""ROS 2 node of the server: services over rmw_zenoh and zenoh-bridge-ros2dds."""

import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.network_protocols import (
    Query,
    QueryQueue,
    ServerNetwork,
    ServiceCall,
    ServiceCallSource,
    TopicNetwork,
)
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.action_server import serve_action
from zensim.proto.ros2.node_services import NodeParameters, NodeServices
from zensim.proto.ros2.rmw_attachment import Attachment, answer_attachment, read_attachment
from zensim.proto.ros2.rmw_keys import NO_HASH
from zensim.proto.ros2.ros_graph import RosGraph, RosNode
from zensim.proto.ros2.ros_service_catalog import (
    CDR_ENCODING_NAME,
    ROS_SERVICES,
    RosService,
    find_served_keys,
    index_by_bridge_key,
    index_by_key,
)
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.rosout import LogCollector, Rosout
from zensim.proto.security.roles import ROS_USER
from zensim.proto.topic_endpoints import TopicFactory, advertise_action
from zensim.sim_server.ros2_node.steps_action import SimulateStepsAction

Message = TypeVar("Message", bound=msgspec.Struct)
LOG = logging.getLogger(__name__)
NO_REQUEST_ID: Final = b""
NODE_NAME: Final = "zensim"
"""Name of the server's ROS 2 node."""
ROSOUT_PERIOD_S: Final = 0.02


class Ros2Call:
    """A request received on a key of rmw_zenoh or of a bridge; see `ServiceCall`."""

    user = ROS_USER

    def __init__(
        self, call: Query, forms: tuple[RosService, ...], attachment: Attachment | None
    ) -> None:
        self._call = call
        self._forms = forms
        self._form = forms[0]
        self.name = forms[0].service
        self.payload, self.size, self.encoding = call.payload, call.size, CDR_ENCODING_NAME
        self.start = self.payload[:1]
        self.request_id = NO_REQUEST_ID if attachment is None else _make_request_id(attachment)
        self.client = call.client if attachment is None else attachment.gid.hex()
        self.session = call.session

    def read(self, kind: type[Message]) -> Message:
        """See `ServiceCall`; the first form that fits is used."""
        for form in self._forms[:-1]:
            with suppress(MalformedPayload):
                return self._read(form, kind)
        return self._read(self._forms[-1], kind)

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """See `ServiceCall`; the attachment identifies the request for the ROS client."""
        del key
        response = self._form.encode_response(payload, encoding)
        attachment = answer_attachment(self._call.request_id, time.time_ns())
        self._call.reply(response, CDR_ENCODING_NAME, attachment=attachment)

    def drop(self) -> None:
        """See `ServiceCall`."""
        self._call.drop()

    def _read(self, form: RosService, kind: type[Message]) -> Message:
        request = form.decode_request(self.payload)
        self._form = form
        return _widen_request(request, kind)


class Ros2CallQueues:
    """Service calls of ROS 2 clients."""

    def __init__(
        self, queues: tuple[QueryQueue, ...], forms: Mapping[str, tuple[RosService, ...]]
    ) -> None:
        self._queues = queues
        self._forms = forms

    def take(self) -> list[ServiceCall]:
        """Take the calls received; calls on unknown keys are dropped."""
        found: list[ServiceCall] = []
        for queue in self._queues:
            for call in queue.take():
                forms = self._forms.get(call.key)
                if forms is None:
                    LOG.info("no such service of ros key=%s", call.key)
                    call.drop()
                else:
                    found.append(Ros2Call(call, forms, read_attachment(call.request_id)))
        return found


def serve_rmw_calls(bus: TopicNetwork, domain: int) -> Ros2CallQueues:
    """Serve the service keys of rmw_zenoh in a domain."""
    return Ros2CallQueues(
        tuple(bus.serve(key) for key in find_served_keys(domain)), index_by_key(domain)
    )


def serve_bridge_calls(bus: TopicNetwork) -> Ros2CallQueues:
    """Serve the service keys of zenoh-bridge-ros2dds."""
    forms = index_by_bridge_key()
    return Ros2CallQueues(tuple(bus.serve(key) for key in forms), forms)


def announce_services(node: RosNode) -> None:
    """Announce every service of a node, in the forms that its ROS distribution has."""
    has_hashes = node.graph.settings.has_hashes
    for form in ROS_SERVICES:
        if has_hashes or form.is_humble_form:
            type_hash = form.type_hash if has_hashes else NO_HASH
            node.add_endpoint(
                "SS", form.name, form.ros_type, type_hash=type_hash, bridge_key=form.bridge_key
            )


def _make_request_id(attachment: Attachment) -> bytes:
    return attachment.gid + attachment.sequence_number.to_bytes(8, "little", signed=True)


def _widen_request(request: msgspec.Struct, kind: type[Message]) -> Message:
    """Extend a standard request to our type with defaults."""
    if isinstance(request, kind):
        return request
    return kind(**{name: getattr(request, name) for name in request.__struct_fields__})


@dataclass(frozen=True)
class ServerNode:
    """Connections of the node to the loop.

    Attributes:
        on_progress: Called with the progress of steps.
        close: Undeclares the node.
    """

    sources: tuple[ServiceCallSource, ...]
    topics: TopicFactory
    on_progress: Callable[[StepsProgress], None]
    close: Callable[[], None]


@dataclass
class PolledNodeServices:
    """The node's own services and log, which the loop polls as a source of calls."""

    services: NodeServices
    rosout: Rosout
    _rosout_due_s: float = 0.0

    def take(self) -> list[ServiceCall]:
        """Reply to requests, and publish log lines; none of them is a call of the simulator."""
        self.services.poll()
        # The loop turns at each step, which can take less than 0.1 ms.
        if (now_s := time.monotonic()) >= self._rosout_due_s:
            self._rosout_due_s = now_s + ROSOUT_PERIOD_S
            self.rosout.poll()
        return []


def start_server_node(
    bus: ServerNetwork,
    settings: RosSettings,
    read_time_ns: Callable[[], int],
    parameters: NodeParameters | None = None,
    collector: LogCollector | None = None,
) -> ServerNode:
    """Declare the server's ROS 2 node as the settings say, or none.

    Args:
        bus: Session of the server.
        settings: Of ROS 2.
        read_time_ns: Reads the simulation time.
        parameters: Of the node.
        collector: With what this process has logged so far; see `Rosout`.
    """
    graph = RosGraph(bus, settings)
    node = graph.add_node("", NODE_NAME)
    topics = TopicFactory(bus, node, settings)
    if node is None:
        return ServerNode((), topics, lambda _: None, graph.close)
    announce_services(node)
    queues = serve_action(bus.serve, node, action.ACTION_NAME, action.SIMULATE_STEPS_ACTION)
    publishers = advertise_action(topics, action.ACTION_NAME, action.SIMULATE_STEPS_ACTION)
    steps = SimulateStepsAction(queues, publishers, read_time_ns)
    services = NodeServices(bus, node.domain, is_bridged=settings.is_bridged)
    services.add(node, parameters)
    rosout = Rosout(bus, graph, collector)
    sources: tuple[ServiceCallSource, ...] = (
        serve_rmw_calls(bus, node.domain),
        steps,
        PolledNodeServices(services, rosout),
    )
    if settings.is_bridged:
        sources = (*sources, serve_bridge_calls(bus))
    return ServerNode(sources, topics, steps.on_progress, partial(_close_node, rosout, graph))


def _close_node(rosout: Rosout, graph: RosGraph) -> None:
    rosout.close()
    graph.close()
