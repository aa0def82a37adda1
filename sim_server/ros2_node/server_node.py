"""ROS 2 node of the server: services over rmw_zenoh and zenoh-bridge-ros2dds, topics, action."""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Final, Protocol, TypeVar

import msgspec

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    CancelStepsResponse,
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.messages.standard_messages import Time, ns_from_time, time_from_ns
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
from zensim.proto.ros2.node_services import NodeParameter, NodeServices
from zensim.proto.ros2.rmw_attachment import Attachment, answer_attachment, read_attachment
from zensim.proto.ros2.rmw_keys import ANY_HASH, NO_HASH, make_data_key
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, RosTopic
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
from zensim.proto.rosout import LogCollector, Rosout
from zensim.proto.security.roles import ROS_USER
from zensim.proto.service_catalog import CANCEL_STEPS, SIMULATE_STEPS
from zensim.proto.topic_endpoints import TopicFactory, TopicPublisher

CDR_ENCODING: Final = str(Format.CDR.value)
MSGPACK_ENCODING: Final = str(Format.MSGPACK.value)
MAX_FINISHED_ACTION_GOALS: Final = 256
"""Ended goals whose results can still be fetched."""
MAX_RESULT_QUERIES: Final = 64
"""Most clients that wait for the result of one goal."""
FINAL_STATUSES: Final = {
    "succeeded": action.GoalStatusCode.SUCCEEDED,
    "canceled": action.GoalStatusCode.CANCELED,
    "aborted": action.GoalStatusCode.ABORTED,
}
CANCEL_CODES: Final = {
    int(ResultCode.OK): action.CancelCode.NONE,
    int(ResultCode.NOT_FOUND): action.CancelCode.UNKNOWN_GOAL_ID,
    int(ResultCode.INCORRECT_STATE): action.CancelCode.GOAL_TERMINATED,
}
Message = TypeVar("Message", bound=msgspec.Struct)


class ActionTopic(Protocol):
    """Publisher of a topic of the action."""

    @property
    def is_matched(self) -> bool:
        """Whether the topic has a subscriber."""

    def send(self, payload: bytes) -> None:
        """Publish one message."""

    def reply_to_late_joiners(self, payload: Callable[[], bytes]) -> None:
        """Reply to late subscribers with the last value."""


@dataclass
class ActionGoal:
    """One goal of the action."""

    goal_id: action.GoalId
    stamp: Time
    goal_query: Query | None
    """Query that waits for acceptance."""
    status: action.GoalStatusCode = action.GoalStatusCode.ACCEPTED
    result: Result = field(default_factory=Result)
    result_queries: list[Query] = field(default_factory=list)
    """Queries that wait for the result."""

    @property
    def info(self) -> action.GoalInfo:
        """Goal id and time, as in ROS 2."""
        return action.GoalInfo(self.goal_id, self.stamp)

    @property
    def is_over(self) -> bool:
        """Whether the goal has ended."""
        return self.status in FINAL_STATUSES.values()


@dataclass
class CancelBatch:
    """Results of canceling several goals by one request."""

    awaited: int
    """Goals whose result is not known yet."""
    ended: list[str] = field(default_factory=list)


class ActionCall:
    """A call of the server's own step services by this action; see `ServiceCall`."""

    payload, encoding, request_id, size = b"", MSGPACK_ENCODING, b"", 0
    client, session = "simulate_steps action", ""
    user = ROS_USER

    def __init__(
        self, name: str, request: msgspec.Struct, on_reply: Callable[[bytes, str], None]
    ) -> None:
        self.name = name
        self._request = request
        self._on_reply = on_reply

    def read(self, kind: type[Message]) -> Message:
        """See `ServiceCall`."""
        assert isinstance(self._request, kind)
        return self._request

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """See `ServiceCall`; passes the reply to the action."""
        del key
        self._on_reply(payload, encoding)

    def drop(self) -> None:
        """See `ServiceCall`."""


class SimulateStepsAction:
    """Action server over the services simulate_steps and cancel_steps."""

    def __init__(
        self, queues: Mapping[str, QuerySource], publishers: Mapping[str, ActionTopic]
    ) -> None:
        """Start without goals.

        Args:
            queues: One for each of `action_messages.ACTION_SERVICES`.
            publishers: One for each of `action_messages.ACTION_TOPICS`.
        """
        self._queues = queues
        self._publishers = publishers
        self._goals: OrderedDict[str, ActionGoal] = OrderedDict()
        self._new: list[ActionGoal] = []

    def take(self) -> list[ServiceCall]:
        """Take the requests received, as calls of the server's step services."""
        self._publishers[action.STATUS_TOPIC].reply_to_late_joiners(self.statuses)
        while self._new:
            self._accept(self._new.pop())  # a refusal would have come before this turn
        calls: list[ServiceCall] = []
        for query in self._queues[action.SEND_GOAL_SERVICE].take():
            calls += self._on_send_goal(query)
        for query in self._queues[action.CANCEL_GOAL_SERVICE].take():
            calls += self._on_cancel_goal(query)
        for query in self._queues[action.GET_RESULT_SERVICE].take():
            self._on_get_result(query)
        return calls

    def on_progress(self, progress: StepsProgress) -> None:
        """Publish the progress of a goal of this action as feedback."""
        goal = self._goals.get(progress.goal_id)
        if goal is None:
            return
        self._accept(goal)
        if (publisher := self._publishers[action.FEEDBACK_TOPIC]).is_matched:
            steps = action.StepsFeedback(progress.completed_steps, progress.remaining_steps)
            publisher.send(encode(action.FeedbackMessage(goal.goal_id, steps), Format.CDR))

    def _end(self, goal: ActionGoal, payload: bytes, encoding: str) -> None:
        """Handle the reply of simulate_steps; a refused goal was never accepted."""
        response = decode(SimulateStepsResponse, payload, encoding)
        is_refused = response.result.result != ResultCode.OK and not response.goal_id
        if goal.goal_query is not None and is_refused:
            del self._goals[goal_id_to_hex(goal.goal_id)]
            self._reply(goal.goal_query, action.SendGoalResponse())
            goal.goal_query = None
            return
        self._accept(goal)
        goal.status, goal.result = FINAL_STATUSES[response.status], response.result
        for query in goal.result_queries:
            self._reply_result(query, goal)
        goal.result_queries.clear()
        self._forget_oldest()
        self._publish_status()

    def _reply_canceled(self, query: Query, payload: bytes, encoding: str) -> None:
        response = decode(CancelStepsResponse, payload, encoding)
        code = CANCEL_CODES.get(response.result.result, action.CancelCode.REJECTED)
        self._reply(query, action.CancelGoalResponse(code, self._infos(response.goal_ids)))

    def _infos(self, names: Sequence[str]) -> tuple[action.GoalInfo, ...]:
        return tuple(self._goals[name].info for name in names if name in self._goals)

    def _on_send_goal(self, query: Query) -> list[ServiceCall]:
        request = _decode_query(action.SendGoalRequest, query)
        name = "" if request is None else goal_id_to_hex(request.goal_id)
        if request is None or not name or name in self._goals:
            self._reply(query, action.SendGoalResponse())
            return []
        goal = ActionGoal(request.goal_id, time_from_ns(time.time_ns()), query)
        self._goals[name] = goal
        self._new.append(goal)
        steps = SimulateStepsRequest(request.goal.steps, name)
        return [ActionCall(SIMULATE_STEPS.name, steps, partial(self._end, goal))]

    def _on_cancel_goal(self, query: Query) -> list[ServiceCall]:
        """Cancel the goal with an id, goals up to a time, both, or all if neither is given."""
        request = _decode_query(action.CancelGoalRequest, query)
        if request is None:
            rejected = action.CancelGoalResponse(action.CancelCode.REJECTED)
            self._reply(query, rejected)
            return []
        name, until_ns = (
            goal_id_to_hex(request.goal_info.goal_id),
            ns_from_time(request.goal_info.stamp),
        )
        if name and not until_ns:
            on_reply = partial(self._reply_canceled, query)
            return [ActionCall(CANCEL_STEPS.name, CancelStepsRequest(name), on_reply)]
        return self._cancel_many(query, name, until_ns)

    def _cancel_many(self, query: Query, name: str, until_ns: int) -> list[ServiceCall]:
        wanted = [
            one
            for one, goal in self._goals.items()
            if not goal.is_over
            and (one == name or not until_ns or ns_from_time(goal.stamp) <= until_ns)
        ]
        if not wanted:
            self._reply(query, action.CancelGoalResponse(action.CancelCode.NONE))
        on_reply = partial(self._collect_canceled, query, CancelBatch(len(wanted)))
        return [ActionCall(CANCEL_STEPS.name, CancelStepsRequest(one), on_reply) for one in wanted]

    def _collect_canceled(
        self, query: Query, batch: CancelBatch, payload: bytes, encoding: str
    ) -> None:
        batch.ended += decode(CancelStepsResponse, payload, encoding).goal_ids
        batch.awaited -= 1
        if not batch.awaited:
            ended = self._infos(batch.ended)
            self._reply(query, action.CancelGoalResponse(action.CancelCode.NONE, ended))

    def _on_get_result(self, query: Query) -> None:
        request = _decode_query(action.GetResultRequest, query)
        goal = None if request is None else self._goals.get(goal_id_to_hex(request.goal_id))
        if goal is None or len(goal.result_queries) >= MAX_RESULT_QUERIES:
            self._reply(query, action.GetResultResponse(action.GoalStatusCode.UNKNOWN))
        elif goal.is_over:
            self._reply_result(query, goal)
        else:
            goal.result_queries.append(query)

    def _accept(self, goal: ActionGoal) -> None:
        if (query := goal.goal_query) is None:
            return
        goal.goal_query, goal.status = None, action.GoalStatusCode.EXECUTING
        self._reply(query, action.SendGoalResponse(accepted=True, stamp=goal.stamp))
        self._publish_status()

    def _reply_result(self, query: Query, goal: ActionGoal) -> None:
        result = action.StepsResult(goal.result)
        self._reply(query, action.GetResultResponse(goal.status, result))

    def _publish_status(self) -> None:
        if (publisher := self._publishers[action.STATUS_TOPIC]).is_matched:
            publisher.send(self.statuses())

    def statuses(self) -> bytes:
        """Encode the status of all accepted goals."""
        goals = [one for one in self._goals.values() if one.goal_query is None]
        statuses = tuple(action.GoalStatusMessage(goal.info, goal.status) for goal in goals)
        return encode(action.GoalStatusArray(statuses), Format.CDR)

    def _reply(self, query: Query, response: msgspec.Struct) -> None:
        attachment = answer_attachment(query.request_id, time.time_ns())
        query.reply(encode(response, Format.CDR), CDR_ENCODING, attachment=attachment)

    def _forget_oldest(self) -> None:
        over = [name for name, goal in self._goals.items() if goal.is_over]
        for name in over[: max(0, len(over) - MAX_FINISHED_ACTION_GOALS)]:
            del self._goals[name]


def goal_id_to_hex(goal_id: action.GoalId) -> str:
    """Write a goal's id as the step services use it; empty for none."""
    return "" if goal_id.uuid == action.NO_GOAL_ID else bytes(goal_id.uuid).hex()


def _decode_query(kind: type[Message], query: Query) -> Message | None:
    try:
        return decode(kind, query.payload, CDR_ENCODING)
    except MalformedPayload:
        return None


LOG = logging.getLogger(__name__)
NO_REQUEST_ID: Final = b""


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


ROSOUT_PERIOD_S: Final = 0.02


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
    parameters: Sequence[NodeParameter] = (),
    collector: LogCollector | None = None,
) -> ServerNode:
    """Declare the server's ROS 2 node as the settings say, or none.

    Args:
        bus: Session of the server.
        settings: Of ROS 2.
        parameters: Of the node.
        collector: With what this process has logged so far; see `Rosout`.
    """
    graph = RosGraph(bus, settings)
    node = graph.add_node("", NODE_NAME)
    topics = TopicFactory(bus, node, settings)
    if node is None:
        return ServerNode((), topics, lambda _: None, graph.close)
    announce_services(node)
    steps = _make_steps_action(bus, node, topics)
    services = NodeServices(bus, node.domain)
    services.add(node, partial(tuple, parameters))
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
            RosTopic(name.strip("/"), kind, LATCHED if name == action.STATUS_TOPIC else RELIABLE_10)
        )
        for name, kind in action.ACTION_TOPICS.items()
    }
    return SimulateStepsAction(queues, publishers)
