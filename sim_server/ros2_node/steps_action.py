"""Action of the server: simulate steps, with feedback, results and cancelling."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Final, TypeVar

import msgspec

from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    CancelStepsResponse,
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.messages.standard_messages import ns_from_time
from zensim.proto.network_protocols import Query, QuerySource, ServiceCall
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.action_server import (
    ActionGoal,
    ActionGoals,
    ActionTopic,
    goal_id_to_hex,
    reply_to,
)
from zensim.proto.security.roles import ROS_USER
from zensim.proto.service_catalog import CANCEL_STEPS, SIMULATE_STEPS

MSGPACK_ENCODING: Final = str(Format.MSGPACK.value)
STEPS_STATUSES: Final = {
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


@dataclass
class CancelBatch:
    """Results of canceling several goals by one request."""

    awaited: int
    """Goals whose result is not known yet."""
    ended: list[str] = field(default_factory=list)


class ActionCall:
    """A call of the server's own step services by this action; see `ServiceCall`."""

    payload, start, encoding, request_id, size = b"", b"", MSGPACK_ENCODING, b"", 0
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
        self,
        queues: Mapping[str, QuerySource],
        publishers: Mapping[str, ActionTopic],
        read_time_ns: Callable[[], int],
    ) -> None:
        """Start without goals.

        Args:
            queues: One for each of `action_messages.ACTION_SERVICES`.
            publishers: One for each of `action_messages.ACTION_TOPICS`.
            read_time_ns: Reads the simulation time.
        """
        self._read_time_ns = read_time_ns
        self._goals = ActionGoals(
            action.SIMULATE_STEPS_ACTION,
            [queues[name] for name in action.ACTION_SERVICES],
            [publishers[name] for name in action.ACTION_TOPICS],
        )
        self._new: list[ActionGoal] = []

    def take(self) -> list[ServiceCall]:
        """Take the requests received, as calls of the server's step services."""
        while self._new:
            self._goals.accept(self._new.pop())  # a refusal would have come before this turn
        calls: list[ServiceCall] = []
        for goal, request in self._goals.take_new(self._read_time_ns()):
            assert isinstance(request, action.SendGoalRequest)
            self._new.append(goal)
            steps = SimulateStepsRequest(request.goal.steps, goal.name)
            calls.append(ActionCall(SIMULATE_STEPS.name, steps, partial(self._end, goal)))
        for query, cancel in self._goals.take_cancellations():
            calls += self._on_cancel_goal(query, cancel)
        self._goals.poll()
        return calls

    def on_progress(self, progress: StepsProgress) -> None:
        """Publish the progress of a goal of this action as feedback."""
        goal = self._goals.find(progress.goal_id)
        if goal is None:
            return
        self._goals.accept(goal)
        steps = action.StepsFeedback(progress.completed_steps, progress.remaining_steps)
        self._goals.publish_feedback(lambda: action.FeedbackMessage(goal.goal_id, steps))

    def _end(self, goal: ActionGoal, payload: bytes, encoding: str) -> None:
        """Handle the reply of simulate_steps; a refused goal was never accepted."""
        response = decode(SimulateStepsResponse, payload, encoding)
        is_refused = response.result.result != ResultCode.OK and not response.goal_id
        if goal.goal_query is not None and is_refused:
            self._goals.refuse(goal)
            return
        result = action.StepsResult(response.result)
        self._goals.end(goal, STEPS_STATUSES[response.status], result)

    def _reply_canceled(self, query: Query, payload: bytes, encoding: str) -> None:
        response = decode(CancelStepsResponse, payload, encoding)
        code = CANCEL_CODES.get(response.result.result, action.CancelCode.REJECTED)
        infos = self._goals.list_infos(response.goal_ids)
        reply_to(query, action.CancelGoalResponse(code, infos))

    def _on_cancel_goal(self, query: Query, request: action.CancelGoalRequest) -> list[ServiceCall]:
        """Cancel one goal by its id, whose service says why it cannot be, or several."""
        info = request.goal_info
        if (name := goal_id_to_hex(info.goal_id)) and not ns_from_time(info.stamp):
            on_reply = partial(self._reply_canceled, query)
            return [ActionCall(CANCEL_STEPS.name, CancelStepsRequest(name), on_reply)]
        wanted = self._goals.select_canceled(request)
        if not wanted:
            reply_to(query, action.CancelGoalResponse(action.CancelCode.NONE))
        on_reply = partial(self._collect_canceled, query, CancelBatch(len(wanted)))
        return [
            ActionCall(CANCEL_STEPS.name, CancelStepsRequest(goal.name), on_reply)
            for goal in wanted
        ]

    def _collect_canceled(
        self, query: Query, batch: CancelBatch, payload: bytes, encoding: str
    ) -> None:
        batch.ended += decode(CancelStepsResponse, payload, encoding).goal_ids
        batch.awaited -= 1
        if not batch.awaited:
            ended = self._goals.list_infos(batch.ended)
            reply_to(query, action.CancelGoalResponse(action.CancelCode.NONE, ended))
