"""The action SimulateSteps: acceptance, feedback, cancel, result."""

from typing import TypeVar

import msgspec

from tests.fakes import CallList, MemoryCall, PublishedPayloads
from tests.sim_server.fakes import ServerFixture, a_server
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import (
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepsProgress,
)
from zensim.proto.messages.standard_messages import NANOSECONDS, Time, ns_from_time
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.action_server import (
    CDR_ENCODING,
    MAX_FINISHED_ACTION_GOALS,
    MAX_RESULT_QUERIES,
)
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.sim_server.ros2_node.steps_action import SimulateStepsAction

Answer = TypeVar("Answer", bound=msgspec.Struct)
SEND_GOAL_SERVICE, CANCEL_GOAL_SERVICE, GET_RESULT_SERVICE = action.ACTION_SERVICES
FEEDBACK_TOPIC, STATUS_TOPIC = action.ACTION_TOPICS
FIRST = action.GoalId(tuple(range(1, 17)))
SECOND = action.GoalId(tuple(range(101, 117)))
GID = bytes(16)


class ActionFixture:
    """A loop with the action as a source of calls."""

    def __init__(self, *, is_paused: bool = True) -> None:
        self.server: ServerFixture = a_server()
        if is_paused:
            self.server.world.clock.pause()
        self.queues = {name: CallList() for name in action.ACTION_SERVICES}
        self.publishers = {name: PublishedPayloads() for name in action.ACTION_TOPICS}
        self.action = SimulateStepsAction(
            self.queues, self.publishers, lambda: self.server.world.clock.time_ns
        )

    def request(self, name: str, request: msgspec.Struct) -> MemoryCall:
        return self.send(name, encode(request, Format.CDR))

    def send(self, name: str, payload: bytes) -> MemoryCall:
        attachment = write_attachment(Attachment(5, 1, GID))
        call = MemoryCall(f"0{name}", payload, CDR_ENCODING, attachment)
        self.queues[name].calls.append(call)
        return call

    def begin(self, goal_id: action.GoalId, steps: int) -> MemoryCall:
        return self.request(
            SEND_GOAL_SERVICE, action.SendGoalRequest(goal_id, action.StepsGoal(steps))
        )

    def result(self, goal_id: action.GoalId) -> MemoryCall:
        return self.request(GET_RESULT_SERVICE, action.GetResultRequest(goal_id))

    def cancel(self, goal_id: action.GoalId, stamp: Time = Time()) -> MemoryCall:  # noqa: B008
        info = action.GoalInfo(goal_id, stamp)
        return self.request(CANCEL_GOAL_SERVICE, action.CancelGoalRequest(info))

    def turn(self, turns: int = 1) -> None:
        for _ in range(turns):
            self.server.inbox.calls += self.action.take()  # type: ignore[arg-type]
            before = len(self.server.publisher.sent)
            self.server.loop.turn()
            for topic, message in self.server.publisher.sent[before:]:
                if topic == "simulate_steps_feedback" and isinstance(message, StepsProgress):
                    self.action.on_progress(message)

    def statuses(self) -> list[int]:
        sent = decode(
            action.GoalStatusArray, self.publishers[STATUS_TOPIC].payloads[-1], CDR_ENCODING
        )
        return [one.status for one in sent.status_list]


def read(call: MemoryCall, kind: type[Answer]) -> Answer:
    (answer,) = call.answers
    return decode(kind, answer.payload, CDR_ENCODING)


def test_goal_is_accepted_before_it_ends() -> None:
    fixture = ActionFixture()
    sent, asked = fixture.begin(FIRST, 10_000), fixture.result(FIRST)

    fixture.turn(3)

    assert read(sent, action.SendGoalResponse).accepted
    assert asked.answers == []
    assert fixture.statuses() == [action.GoalStatusCode.EXECUTING]


def test_goal_makes_its_steps_and_returns_its_status() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 7)
    asked = fixture.result(FIRST)

    fixture.turn(20)

    sent = read(asked, action.GetResultResponse)
    assert (sent.status, sent.result.result.result) == (
        action.GoalStatusCode.SUCCEEDED,
        ResultCode.OK,
    )
    assert fixture.server.world.clock.steps == 7
    assert fixture.statuses() == [action.GoalStatusCode.SUCCEEDED]


def test_result_of_an_ended_goal_is_returned_at_once() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 2)
    fixture.turn(20)

    asked = fixture.result(FIRST)
    fixture.turn()

    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.SUCCEEDED


def test_feedback_has_completed_and_remaining_steps() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 7)

    fixture.turn(20)

    payloads = fixture.publishers[FEEDBACK_TOPIC].payloads
    sent = [decode(action.FeedbackMessage, payload, CDR_ENCODING) for payload in payloads]
    assert {one.goal_id for one in sent} == {FIRST}
    assert sent[-1].feedback == action.StepsFeedback(7, 0)


def test_feedback_is_not_encoded_without_a_subscriber() -> None:
    fixture = ActionFixture()
    fixture.publishers[FEEDBACK_TOPIC].is_matched = False
    fixture.begin(FIRST, 7)

    fixture.turn(20)

    assert fixture.publishers[FEEDBACK_TOPIC].payloads == []


def test_goal_is_not_accepted_while_playing() -> None:
    fixture = ActionFixture(is_paused=False)
    sent = fixture.begin(FIRST, 7)
    fixture.turn(3)
    asked = fixture.result(FIRST)
    fixture.turn()

    assert not read(sent, action.SendGoalResponse).accepted
    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN


def test_goal_id_is_accepted_once() -> None:
    fixture = ActionFixture()
    first, again = fixture.begin(FIRST, 10_000), fixture.begin(FIRST, 10_000)

    fixture.turn(3)

    assert read(first, action.SendGoalResponse).accepted
    assert not read(again, action.SendGoalResponse).accepted


def test_goal_without_an_id_is_not_accepted() -> None:
    fixture = ActionFixture()
    sent = fixture.begin(action.GoalId(), 3)

    fixture.turn(3)

    assert not read(sent, action.SendGoalResponse).accepted


def test_second_goal_is_accepted_while_the_first_is_active() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 10_000)
    second = fixture.begin(SECOND, 10_000)

    fixture.turn(3)

    assert read(second, action.SendGoalResponse).accepted
    assert fixture.statuses() == [action.GoalStatusCode.EXECUTING] * 2


def test_late_subscriber_gets_the_status_of_all_goals() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 10_000)

    fixture.turn(3)

    sent = decode(action.GoalStatusArray, fixture.publishers[STATUS_TOPIC].latched, CDR_ENCODING)
    assert [one.goal_info.goal_id for one in sent.status_list] == [FIRST]


def test_canceled_goal_is_listed_with_its_status() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 10_000)
    asked = fixture.result(FIRST)
    fixture.turn(3)

    canceled = fixture.cancel(FIRST)
    fixture.turn(3)

    sent = read(canceled, action.CancelGoalResponse)
    assert sent.return_code == action.CancelCode.NONE
    assert [info.goal_id for info in sent.goals_canceling] == [FIRST]
    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.CANCELED


def test_cancel_without_an_id_ends_all_goals() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 10_000)
    fixture.begin(SECOND, 10_000)
    fixture.turn(3)

    canceled = fixture.cancel(action.GoalId())
    fixture.turn(3)

    sent = read(canceled, action.CancelGoalResponse)
    assert {info.goal_id for info in sent.goals_canceling} == {FIRST, SECOND}
    assert fixture.statuses() == [action.GoalStatusCode.CANCELED] * 2


def stamp_of(sent: MemoryCall) -> Time:
    return read(sent, action.SendGoalResponse).stamp


def two_goals(fixture: ActionFixture) -> tuple[MemoryCall, MemoryCall]:
    """Start two goals after some time, the second later than the first."""
    fixture.server.world.clock.steps = 1000
    first = fixture.begin(FIRST, 10_000)
    fixture.turn(2)
    second = fixture.begin(SECOND, 10_000)
    fixture.turn(2)
    times_ns = [ns_from_time(stamp_of(one)) for one in (first, second)]
    assert NANOSECONDS < times_ns[0] < times_ns[1] <= fixture.server.world.clock.time_ns
    return first, second


def test_cancel_by_a_time_ends_the_goals_accepted_before() -> None:
    fixture = ActionFixture()
    first, _ = two_goals(fixture)

    canceled = fixture.cancel(action.GoalId(), stamp_of(first))
    fixture.turn(3)

    sent = read(canceled, action.CancelGoalResponse)
    assert (sent.return_code, ids_of(sent)) == (action.CancelCode.NONE, {FIRST})
    assert fixture.statuses() == [action.GoalStatusCode.CANCELED, action.GoalStatusCode.EXECUTING]


def test_cancel_by_id_and_time_ends_that_goal_and_the_goals_before() -> None:
    fixture = ActionFixture()
    first, _ = two_goals(fixture)

    canceled = fixture.cancel(SECOND, stamp_of(first))
    fixture.turn(3)

    assert ids_of(read(canceled, action.CancelGoalResponse)) == {FIRST, SECOND}


def test_cancel_by_a_time_before_all_goals_ends_none_and_is_no_error() -> None:
    fixture = ActionFixture()
    two_goals(fixture)

    canceled = fixture.cancel(action.GoalId(), Time(1, 0))
    fixture.turn(3)

    sent = read(canceled, action.CancelGoalResponse)
    assert (sent.return_code, ids_of(sent)) == (action.CancelCode.NONE, set())


def ids_of(sent: action.CancelGoalResponse) -> set[action.GoalId]:
    return {info.goal_id for info in sent.goals_canceling}


def test_cancel_of_all_leaves_the_steps_of_other_clients() -> None:
    fixture = ActionFixture()
    asked = fixture.server.request("simulate_steps", SimulateStepsRequest(50, "plain"))
    sent = fixture.begin(FIRST, 10_000)
    fixture.turn()
    assert asked.answers == []

    fixture.cancel(action.GoalId())
    fixture.turn(200)

    assert read(sent, action.SendGoalResponse).accepted
    (answer,) = asked.answers
    response = decode(SimulateStepsResponse, answer.payload, answer.encoding)
    assert response.result.result == ResultCode.OK


def test_cancel_of_nothing_returns_a_code() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 1)
    fixture.turn(20)

    over, unknown = fixture.cancel(FIRST), fixture.cancel(SECOND)
    fixture.turn(2)

    assert read(over, action.CancelGoalResponse).return_code == action.CancelCode.GOAL_TERMINATED
    unknown_code = read(unknown, action.CancelGoalResponse).return_code
    assert unknown_code == action.CancelCode.UNKNOWN_GOAL_ID


def test_malformed_requests_are_refused() -> None:
    fixture = ActionFixture()
    sent, canceled, asked = (
        fixture.send(name, b"\x00\x01\x00\x00\x07") for name in action.ACTION_SERVICES
    )

    fixture.turn(2)

    assert not read(sent, action.SendGoalResponse).accepted
    assert read(canceled, action.CancelGoalResponse).return_code == action.CancelCode.REJECTED
    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN


def test_reply_has_sequence_number_and_gid_of_the_client() -> None:
    fixture = ActionFixture()
    sent = fixture.begin(FIRST, 5)

    fixture.turn(3)

    attachment = read_attachment(sent.answers[0].attachment)
    assert attachment is not None
    assert (attachment.sequence_number, attachment.gid) == (5, GID)


def test_number_of_waiting_result_requests_is_limited() -> None:
    fixture = ActionFixture()
    fixture.begin(FIRST, 10_000)
    asked = [fixture.result(FIRST) for _ in range(MAX_RESULT_QUERIES + 1)]

    fixture.turn(2)

    assert read(asked[-1], action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN
    assert [call for call in asked[:-1] if call.answers] == []


def test_oldest_ended_goals_are_forgotten() -> None:
    fixture = ActionFixture()
    for number in range(MAX_FINISHED_ACTION_GOALS + 1):
        fixture.begin(action.GoalId((1, number % 256, number // 256, *[0] * 13)), 1)
        fixture.turn(5)

    asked = fixture.result(action.GoalId((1, *[0] * 15)))
    fixture.turn()

    assert read(asked, action.GetResultResponse).status == action.GoalStatusCode.UNKNOWN
    assert len(fixture.statuses()) == MAX_FINISHED_ACTION_GOALS
