"""ROS 2 node of the server: services over rmw_zenoh and zenoh-bridge-ros2dds, topics, action."""

import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeVar

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.network_protocols import (
    Query,
    QueryQueue,
    QuerySource,
    ServerNetwork,
    ServiceCall,
    ServiceCallSource,
    ServingNetwork,
)
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.liveliness_tokens import LATCHED, RELIABLE_10
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.rmw_keys import ANY_HASH, NO_HASH, make_data_key
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_service_catalog import (
    CDR_ENCODING_NAME,
    ROS_SERVICES,
    RosService,
    find_served_keys,
    index_by_bridge_key,
    index_by_key,
)
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.ros2.type_hash import find_service_type, hash_service
from zensim.proto.topic_endpoints import TopicFactory, TopicPublisher
from zensim.sim_server.ros2_node.simulate_steps_action import SimulateStepsAction

LOG = logging.getLogger(__name__)
Message = TypeVar("Message", bound=msgspec.Struct)
NO_REQUEST_ID: Final = b""


class Ros2Call:
    """A request received on a key of rmw_zenoh or of a bridge; see `ServiceCall`."""

    def __init__(
        self, call: Query, forms: tuple[RosService, ...], attachment: Attachment | None
    ) -> None:
        self._call = call
        self._forms = forms
        self._form = forms[0]
        self._attachment = attachment
        self.name = forms[0].service
        self.payload, self.size, self.encoding = call.payload, call.size, CDR_ENCODING_NAME
        self.request_id = NO_REQUEST_ID if attachment is None else _make_request_id(attachment)

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
        attachment = (
            b"" if self._attachment is None else write_attachment(_stamp_now(self._attachment))
        )
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


def serve_rmw_calls(bus: ServingNetwork, domain: int) -> Ros2CallQueues:
    """Serve the service keys of rmw_zenoh in a domain."""
    return Ros2CallQueues(
        tuple(bus.serve(key) for key in find_served_keys(domain)), index_by_key(domain)
    )


def serve_bridge_calls(bus: ServingNetwork) -> Ros2CallQueues:
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


def _stamp_now(attachment: Attachment) -> Attachment:
    return msgspec.structs.replace(attachment, source_time_ns=time.time_ns())


def _widen_request(request: msgspec.Struct, kind: type[Message]) -> Message:
    """Extend a standard request to our type with defaults."""
    if isinstance(request, kind):
        return request
    return kind(**{name: getattr(request, name) for name in request.__struct_fields__})


NODE_NAME: Final = "zensim"
"""Name of the server's ROS 2 node."""


@dataclass(frozen=True)
class MergedQueries:
    """Requests on several keys as one source."""

    queues: tuple[QuerySource, ...]

    def take(self) -> list[Query]:
        """Take the requests received, queue by queue."""
        return [query for queue in self.queues for query in queue.take()]


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


def start_server_node(bus: ServerNetwork, settings: RosSettings) -> ServerNode:
    """Declare the server's ROS 2 node as the settings say, or none."""
    graph = RosGraph(bus, settings)
    node = graph.add_node("", NODE_NAME)
    topics = TopicFactory(bus, node, settings)
    if node is None:
        return ServerNode((), topics, lambda _: None, graph.close)
    announce_services(node)
    steps = _make_steps_action(bus, node, topics)
    sources: tuple[ServiceCallSource, ...] = (serve_rmw_calls(bus, node.domain), steps)
    if settings.is_bridged:
        sources = (*sources, serve_bridge_calls(bus))
    return ServerNode(sources, topics, steps.on_progress, graph.close)


def _make_steps_action(
    bus: ServerNetwork, node: RosNode, topics: TopicFactory
) -> SimulateStepsAction:
    settings = node.graph.settings
    node.announce_action(action.ACTION_NAME, action.ACTION_TYPE)
    queues = {}
    for name, (request, response) in action.ACTION_SERVICES.items():
        kind = find_service_type(request)
        type_hash = hash_service(request, response) if settings.has_hashes else NO_HASH
        node.add_endpoint("SS", name, kind, type_hash=type_hash)
        keys = [make_data_key(node.domain, name, kind, ANY_HASH)]
        if settings.is_bridged:
            keys.append(name.strip("/"))
        queues[name] = MergedQueries(tuple(bus.serve(key) for key in keys))
    publishers: dict[str, TopicPublisher] = {
        name: topics.publisher(
            Topic(name.strip("/"), kind, LATCHED if name == action.STATUS_TOPIC else RELIABLE_10)
        )
        for name, kind in action.ACTION_TOPICS.items()
    }
    return SimulateStepsAction(queues, publishers)
