"""Actions of ROS 2 nodes: their endpoints, and the goals of one with status and results."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeVar

import msgspec

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.messages.standard_messages import Time, ns_from_time, time_from_ns
from zensim.proto.network_protocols import Query, QueryQueue, QuerySource
from zensim.proto.ros2.action_messages import (
    NO_GOAL_ID,
    ActionKind,
    CancelCode,
    CancelGoalRequest,
    CancelGoalResponse,
    GoalId,
    GoalInfo,
    GoalStatusArray,
    GoalStatusCode,
    GoalStatusMessage,
)
from zensim.proto.ros2.rmw_attachment import answer_attachment
from zensim.proto.ros2.rmw_keys import ANY_HASH, NO_HASH, make_data_key
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.type_hash import find_service_type, hash_service

CDR_ENCODING: Final = str(Format.CDR.value)
MAX_FINISHED_ACTION_GOALS: Final = 256
"""Ended goals whose results can still be fetched."""
MAX_RESULT_QUERIES: Final = 64
"""Most clients that wait for the result of one goal."""
FINAL_STATUSES: Final = (GoalStatusCode.SUCCEEDED, GoalStatusCode.CANCELED, GoalStatusCode.ABORTED)
Message = TypeVar("Message", bound=msgspec.Struct)


class ActionTopic(Protocol):
    """Publisher of a topic of an action."""

    @property
    def is_matched(self) -> bool:
        """Whether the topic has a subscriber."""

    def send(self, payload: bytes) -> None:
        """Publish one message."""

    def reply_to_late_joiners(self, payload: Callable[[], bytes]) -> None:
        """Reply to late subscribers with the last value."""


@dataclass(frozen=True)
class MergedQueries:
    """Requests on several keys as one source."""

    queues: tuple[QueryQueue, ...]

    def take(self) -> list[Query]:
        """Take the requests received, queue by queue."""
        return [query for queue in self.queues for query in queue.take()]

    def close(self) -> None:
        """Undeclare the queues."""
        for queue in self.queues:
            queue.close()


def serve_action(
    serve: Callable[[str], QueryQueue], node: RosNode, name: str, kind: ActionKind
) -> dict[str, MergedQueries]:
    """Declare the services of an action, and announce the action to bridges.

    Args:
        serve: Declares a queryable on a key.
        node: Announces the services.
        name: Of the action, without a leading slash.
        kind: Its messages.

    Returns:
        The requests by name of the service: goals, cancellations, results.
    """
    settings = node.graph.settings
    node.announce_action(name, kind.ros_type)
    queues = {}
    for service, (request, response) in kind.list_services(name).items():
        ros_type = find_service_type(request)
        type_hash = hash_service(request, response) if settings.has_hashes else NO_HASH
        node.add_endpoint("SS", service, ros_type, type_hash=type_hash)
        keys = [make_data_key(node.domain, service, ros_type, ANY_HASH)]
        if settings.is_bridged:
            keys.append(service.strip("/"))
        queues[service] = MergedQueries(tuple(serve(key) for key in keys))
    return queues


@dataclass
class ActionGoal:
    """One goal of an action."""

    goal_id: GoalId
    stamp: Time
    result: msgspec.Struct
    goal_query: Query | None
    """Query that waits for acceptance."""
    status: GoalStatusCode = GoalStatusCode.ACCEPTED
    result_queries: list[Query] = field(default_factory=list)
    """Queries that wait for the result."""

    @property
    def name(self) -> str:
        """Id of the goal in hexadecimal digits."""
        return goal_id_to_hex(self.goal_id)

    @property
    def info(self) -> GoalInfo:
        """Goal id and time, as in ROS 2."""
        return GoalInfo(self.goal_id, self.stamp)

    @property
    def is_over(self) -> bool:
        """Whether the goal has ended."""
        return self.status in FINAL_STATUSES


class ActionGoals:
    """The goals of one action; each reply and status is sent here."""

    def __init__(
        self, kind: ActionKind, queues: Iterable[QuerySource], topics: Iterable[ActionTopic]
    ) -> None:
        """Start without goals.

        Args:
            kind: Messages of the action.
            queues: Requests in the order of `ActionKind.list_services`.
            topics: Publishers in the order of `ActionKind.list_topics`.
        """
        self._kind = kind
        self._send_queue, self._cancel_queue, self._result_queue = queues
        self._feedback, self._status = topics
        self._goals: OrderedDict[str, ActionGoal] = OrderedDict()

    def poll(self) -> None:
        """Reply to requests of results, and to late subscribers of the status."""
        self._status.reply_to_late_joiners(self.statuses)
        for query in self._result_queue.take():
            self._on_get_result(query)

    def take_new(self, time_ns: int) -> list[tuple[ActionGoal, msgspec.Struct]]:
        """Take the new goals with their requests; accept or refuse each.

        Args:
            time_ns: Simulation time, their stamp: the clock of the node, as in rcl.
        """
        found = []
        for query in self._send_queue.take():
            request = decode_query(self._kind.send_goal[0], query)
            goal_id = getattr(request, "goal_id", GoalId())
            name = goal_id_to_hex(goal_id)
            if request is None or not name or name in self._goals:
                reply_to(query, self._kind.send_goal[1]())
                continue
            stamp, result = time_from_ns(time_ns), self._kind.get_result[1]()
            goal = ActionGoal(goal_id, stamp, result, query)
            self._goals[name] = goal
            found.append((goal, request))
        return found

    def take_cancellations(self) -> list[tuple[Query, CancelGoalRequest]]:
        """Take requests to cancel; those that are malformed are refused."""
        found = []
        for query in self._cancel_queue.take():
            if (request := decode_query(CancelGoalRequest, query)) is None:
                reply_to(query, CancelGoalResponse(CancelCode.REJECTED))
            else:
                found.append((query, request))
        return found

    def find(self, name: str) -> ActionGoal | None:
        """Find a goal by its id in hexadecimal digits."""
        return self._goals.get(name)

    def select_canceled(self, request: CancelGoalRequest) -> list[ActionGoal]:
        """Select the goal with an id, goals up to a time, both, or all if neither is given.

        Source: action_msgs/srv/CancelGoal.
        """
        name, until_ns = (
            goal_id_to_hex(request.goal_info.goal_id),
            ns_from_time(request.goal_info.stamp),
        )
        is_any = not name and not until_ns
        return [
            goal
            for one, goal in self._goals.items()
            if not goal.is_over
            and (one == name or is_any or 0 < until_ns >= ns_from_time(goal.stamp))
        ]

    def list_infos(self, names: Sequence[str]) -> tuple[GoalInfo, ...]:
        """List ids and times of goals."""
        return tuple(self._goals[name].info for name in names if name in self._goals)

    def refuse(self, goal: ActionGoal) -> None:
        """Refuse a new goal."""
        del self._goals[goal.name]
        if goal.goal_query is not None:
            reply_to(goal.goal_query, self._kind.send_goal[1]())
        goal.goal_query = None

    def accept(self, goal: ActionGoal) -> None:
        """Accept a goal; further calls do nothing."""
        if (query := goal.goal_query) is None:
            return
        goal.goal_query, goal.status = None, GoalStatusCode.EXECUTING
        reply_to(query, self._kind.send_goal[1](accepted=True, stamp=goal.stamp))
        self.publish_status()

    def end(self, goal: ActionGoal, status: GoalStatusCode, result: msgspec.Struct) -> None:
        """End a goal, and send its result.

        Args:
            goal: It is accepted if it was not yet.
            status: One of `FINAL_STATUSES`.
            result: The field `result` of the response.
        """
        self.accept(goal)
        goal.status = status
        goal.result = self._kind.get_result[1](status=status, result=result)
        for query in goal.result_queries:
            reply_to(query, goal.result)
        goal.result_queries.clear()
        self._forget_oldest()
        self.publish_status()

    def publish_feedback(self, make_message: Callable[[], msgspec.Struct]) -> None:
        """Publish feedback if there is a subscriber."""
        if self._feedback.is_matched:
            self._feedback.send(encode(make_message(), Format.CDR))

    def publish_status(self) -> None:
        """Publish the status of all goals if there is a subscriber."""
        if self._status.is_matched:
            self._status.send(self.statuses())

    def statuses(self) -> bytes:
        """Encode the status of all accepted goals."""
        goals = [one for one in self._goals.values() if one.goal_query is None]
        statuses = tuple(GoalStatusMessage(goal.info, goal.status) for goal in goals)
        return encode(GoalStatusArray(statuses), Format.CDR)

    def _on_get_result(self, query: Query) -> None:
        request = decode_query(self._kind.get_result[0], query)
        goal = self._goals.get(goal_id_to_hex(getattr(request, "goal_id", GoalId())))
        if goal is None or len(goal.result_queries) >= MAX_RESULT_QUERIES:
            reply_to(query, self._kind.get_result[1](status=GoalStatusCode.UNKNOWN))
        elif goal.is_over:
            reply_to(query, goal.result)
        else:
            goal.result_queries.append(query)

    def _forget_oldest(self) -> None:
        over = [name for name, goal in self._goals.items() if goal.is_over]
        for name in over[: max(0, len(over) - MAX_FINISHED_ACTION_GOALS)]:
            del self._goals[name]


def goal_id_to_hex(goal_id: GoalId) -> str:
    """Write a goal's id in hexadecimal digits; empty for none."""
    return "" if goal_id.uuid == NO_GOAL_ID else bytes(goal_id.uuid).hex()


def decode_query(kind: type[Message], query: Query) -> Message | None:
    """Decode a request; None if it is malformed."""
    try:
        return decode(kind, query.payload, CDR_ENCODING)
    except MalformedPayload:
        return None


def reply_to(query: Query, response: msgspec.Struct) -> None:
    """Reply to a request of ROS 2."""
    attachment = answer_attachment(query.request_id, time.time_ns())
    query.reply(encode(response, Format.CDR), CDR_ENCODING, attachment=attachment)
