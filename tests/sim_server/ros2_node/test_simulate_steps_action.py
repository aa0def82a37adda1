"""The action SimulateSteps: accepted, told of, canceled, and its result fetched."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import msgspec

from tests.fakes import MemoryCall
from tests.sim_server.fakes import ServerFixture, a_server
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import (
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.messages.standard_messages import Time, ns_from_time
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.sim_server.ros2_node.simulate_steps_action import (
    CDR_ENCODING,
    MAX_FINISHED_ACTION_GOALS,
    MAX_RESULT_QUERIES,
    SimulateStepsAction,
)

Answer = TypeVar("Answer", bound=msgspec.Struct)
FIRST = action.GoalId(tuple(range(1, 17)))
SECOND = action.GoalId(tuple(range(101, 117)))
GID = bytes(16)


@dataclass
class ListQueue:
    calls: list[MemoryCall] = field(default_factory=list)

    def take(self) -> list[MemoryCall]:
        taken, self.calls = self.calls, []
        return taken


@dataclass
class Told:
    is_matched: bool = True
    payloads: list[bytes] = field(default_factory=list)
    latched: bytes = b""

    def send(self, payload: bytes) -> None:
        self.payloads.append(payload)

    def reply_to_late_joiners(self, payload: Callable[[], bytes]) -> None:
        self.latched = payload()


class Scene:
    """A loop, and the action before it."""

    def __init__(self, *, is_paused: bool = True) -> None:
        self.server: ServerFixture = a_server()
        if is_paused:
            self.server.world.clock.pause()
        self.queues = {name: ListQueue() for name in action.ACTION_SERVICES}
        self.tellers = {name: Told() for name in action.ACTION_TOPICS}
        self.action = SimulateStepsAction(self.queues, self.tellers)

    def ask(self, name: str, request: msgspec.Struct) -> MemoryCall:
        return self.send(name, encode(request, Format.CDR))

    def send(self, name: str, payload: bytes) -> MemoryCall:
        attachment = write_attachment(Attachment(5, 1, GID))
        call = MemoryCall(f"0{name}", payload, CDR_ENCODING, attachment)
        self.queues[name].calls.append(call)
        return call

    def begin(self, goal_id: action.GoalId, steps: int) -> MemoryCall:
        return self.ask(
            action.SEND_GOAL_SERVICE, action.SendGoalRequest(goal_id, action.StepsGoal(steps))
        )

    def result(self, goal_id: action.GoalId) -> MemoryCall:
        return self.ask(action.GET_RESULT_SERVICE, action.GetResultRequest(goal_id))

    def cancel(self, goal_id: action.GoalId, stamp: Time = Time()) -> MemoryCall:  # noqa: B008
        info = action.GoalInfo(goal_id, stamp)
        return self.ask(action.CANCEL_GOAL_SERVICE, action.CancelGoalRequest(info))

    def turn(self, turns: int = 1) -> None:
        for _ in range(turns):
            self.server.inbox.calls += self.action.take()  # type: ignore[arg-type]
            before = len(self.server.publisher.told)
            self.server.loop.turn()
            for topic, message in self.server.publisher.told[before:]:
                if topic == "simulate_steps_feedback" and isinstance(message, StepsProgress):
                    self.action.on_progress(message)

    def statuses(self) -> list[int]:
        told = decode(
            action.GoalStatusArray, self.tellers[action.STATUS_TOPIC].payloads[-1], CDR_ENCODING
        )
        return [one.status for one in told.status_list]


def read(call: MemoryCall, kind: type[Answer]) -> Answer:
    (answer,) = call.answers
    return decode(kind, answer.payload, CDR_ENCODING)


def test_goal_is_accepted_before_it_is_over() -> None:
    scene = Scene()
    sent, asked = scene.begin(FIRST, 10_000), scene.result(FIRST)

    scene.turn(3)

    assert read(sent, action.SendGoalResponse).accepted
    assert asked.answers == []
    assert scene.statuses() == [action.GoalStatusCode.EXECUTING]


def test_goal_makes_its_steps_and_tells_how_it_ended() -> None:
    scene = Scene()
    scene.begin(FIRST, 7)
    asked = scene.result(FIRST)

    scene.turn(20)

    told = read(asked, action.GetResultResponse)
    assert (told.status, told.result.result.result) == (
        action.GoalStatusCode.SUCCEEDED,
        ResultCode.OK,
    )
    assert scene.server.world.clock.steps == 7
    assert scene.statuses() == [action.GoalStatusCode.SUCCEEDED]


def test_result_of_a_goal_that_is_over_is_told_at_once() -> None:
    scene = Scene()
    scene.begin(FIRST, 2)
    scene.turn(20)

    asked = scene.result(FIRST)
    scene.turn()

    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.SUCCEEDED


def test_feedback_tells_steps_made_and_left() -> None:
    scene = Scene()
    scene.begin(FIRST, 7)

    scene.turn(20)

    payloads = scene.tellers[action.FEEDBACK_TOPIC].payloads
    told = [decode(action.FeedbackMessage, payload, CDR_ENCODING) for payload in payloads]
    assert {one.goal_id for one in told} == {FIRST}
    assert told[-1].feedback == action.StepsFeedback(7, 0)


def test_feedback_is_not_written_when_nobody_listens() -> None:
    scene = Scene()
    scene.tellers[action.FEEDBACK_TOPIC].is_matched = False
    scene.begin(FIRST, 7)

    scene.turn(20)

    assert scene.tellers[action.FEEDBACK_TOPIC].payloads == []


def test_goal_is_not_accepted_while_time_runs() -> None:
    scene = Scene(is_paused=False)
    sent = scene.begin(FIRST, 7)
    scene.turn(3)
    asked = scene.result(FIRST)
    scene.turn()

    assert not read(sent, action.SendGoalResponse).accepted
    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN


def test_id_of_a_goal_is_taken_once() -> None:
    scene = Scene()
    first, again = scene.begin(FIRST, 10_000), scene.begin(FIRST, 10_000)

    scene.turn(3)

    assert read(first, action.SendGoalResponse).accepted
    assert not read(again, action.SendGoalResponse).accepted


def test_goal_without_an_id_is_not_accepted() -> None:
    scene = Scene()
    sent = scene.begin(action.GoalId(), 3)

    scene.turn(3)

    assert not read(sent, action.SendGoalResponse).accepted


def test_second_goal_is_accepted_while_the_first_goes_on() -> None:
    scene = Scene()
    scene.begin(FIRST, 10_000)
    second = scene.begin(SECOND, 10_000)

    scene.turn(3)

    assert read(second, action.SendGoalResponse).accepted
    assert scene.statuses() == [action.GoalStatusCode.EXECUTING] * 2


def test_who_comes_late_is_told_of_all_goals() -> None:
    scene = Scene()
    scene.begin(FIRST, 10_000)

    scene.turn(3)

    told = decode(action.GoalStatusArray, scene.tellers[action.STATUS_TOPIC].latched, CDR_ENCODING)
    assert [one.goal_info.goal_id for one in told.status_list] == [FIRST]


def test_canceled_goal_is_named_and_tells_that_it_was() -> None:
    scene = Scene()
    scene.begin(FIRST, 10_000)
    asked = scene.result(FIRST)
    scene.turn(3)

    canceled = scene.cancel(FIRST)
    scene.turn(3)

    told = read(canceled, action.CancelGoalResponse)
    assert told.return_code == action.CancelCode.NONE
    assert [info.goal_id for info in told.goals_canceling] == [FIRST]
    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.CANCELED


def test_cancel_without_an_id_ends_all_goals() -> None:
    scene = Scene()
    scene.begin(FIRST, 10_000)
    scene.begin(SECOND, 10_000)
    scene.turn(3)

    canceled = scene.cancel(action.GoalId())
    scene.turn(3)

    told = read(canceled, action.CancelGoalResponse)
    assert {info.goal_id for info in told.goals_canceling} == {FIRST, SECOND}
    assert scene.statuses() == [action.GoalStatusCode.CANCELED] * 2


def stamp_of(sent: MemoryCall) -> Time:
    return read(sent, action.SendGoalResponse).stamp


def two_goals(scene: Scene) -> tuple[MemoryCall, MemoryCall]:
    """Begin two goals, the second later by the clock."""
    first = scene.begin(FIRST, 10_000)
    scene.turn(2)
    second = scene.begin(SECOND, 10_000)
    scene.turn(2)
    assert ns_from_time(stamp_of(first)) < ns_from_time(stamp_of(second))
    return first, second


def test_cancel_by_a_time_ends_the_goals_that_had_begun() -> None:
    scene = Scene()
    first, _ = two_goals(scene)

    canceled = scene.cancel(action.GoalId(), stamp_of(first))
    scene.turn(3)

    told = read(canceled, action.CancelGoalResponse)
    assert (told.return_code, ids_of(told)) == (action.CancelCode.NONE, {FIRST})
    assert scene.statuses() == [action.GoalStatusCode.CANCELED, action.GoalStatusCode.EXECUTING]


def test_cancel_by_id_and_time_ends_that_goal_and_the_goals_before() -> None:
    scene = Scene()
    first, _ = two_goals(scene)

    canceled = scene.cancel(SECOND, stamp_of(first))
    scene.turn(3)

    assert ids_of(read(canceled, action.CancelGoalResponse)) == {FIRST, SECOND}


def test_cancel_by_a_time_before_all_goals_ends_none_and_is_no_error() -> None:
    scene = Scene()
    two_goals(scene)

    canceled = scene.cancel(action.GoalId(), Time(1, 0))
    scene.turn(3)

    told = read(canceled, action.CancelGoalResponse)
    assert (told.return_code, ids_of(told)) == (action.CancelCode.NONE, set())


def ids_of(told: action.CancelGoalResponse) -> set[action.GoalId]:
    return {info.goal_id for info in told.goals_canceling}


def test_cancel_of_all_leaves_the_steps_that_others_asked_for() -> None:
    scene = Scene()
    asked = scene.server.ask("simulate_steps", SimulateStepsRequest(50, "plain"))
    sent = scene.begin(FIRST, 10_000)
    scene.turn()
    assert asked.answers == []

    scene.cancel(action.GoalId())
    scene.turn(200)

    assert read(sent, action.SendGoalResponse).accepted
    (answer,) = asked.answers
    told = decode(SimulateStepsResponse, answer.payload, answer.encoding)
    assert told.result.result == ResultCode.OK


def test_cancel_of_nothing_says_which_nothing() -> None:
    scene = Scene()
    scene.begin(FIRST, 1)
    scene.turn(20)

    over, unknown = scene.cancel(FIRST), scene.cancel(SECOND)
    scene.turn(2)

    assert read(over, action.CancelGoalResponse).return_code == action.CancelCode.GOAL_TERMINATED
    unknown_code = read(unknown, action.CancelGoalResponse).return_code
    assert unknown_code == action.CancelCode.UNKNOWN_GOAL_ID


def test_malformed_requests_are_answered_with_a_no() -> None:
    scene = Scene()
    sent, canceled, asked = (
        scene.send(name, b"\x00\x01\x00\x00\x07") for name in action.ACTION_SERVICES
    )

    scene.turn(2)

    assert not read(sent, action.SendGoalResponse).accepted
    assert read(canceled, action.CancelGoalResponse).return_code == action.CancelCode.REJECTED
    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN


def test_answer_has_the_number_and_the_name_of_who_asked() -> None:
    scene = Scene()
    sent = scene.begin(FIRST, 5)

    scene.turn(3)

    told = read_attachment(sent.answers[0].attachment)
    assert told is not None
    assert (told.sequence_number, told.gid) == (5, GID)


def test_result_is_awaited_by_so_many_and_no_more() -> None:
    scene = Scene()
    scene.begin(FIRST, 10_000)
    asked = [scene.result(FIRST) for _ in range(MAX_RESULT_QUERIES + 1)]

    scene.turn(2)

    assert read(asked[-1], action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN
    assert [call for call in asked[:-1] if call.answers] == []


def test_oldest_goals_that_are_over_are_forgotten() -> None:
    scene = Scene()
    for number in range(MAX_FINISHED_ACTION_GOALS + 1):
        scene.begin(action.GoalId((1, number % 256, number // 256, *[0] * 13)), 1)
        scene.turn(5)

    asked = scene.result(action.GoalId((1, *[0] * 15)))
    scene.turn()

    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN
    assert len(scene.statuses()) == MAX_FINISHED_ACTION_GOALS
