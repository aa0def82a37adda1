"""The action FollowJointTrajectory of one controller: goals, feedback, cancel, results."""

from collections.abc import Sequence
from typing import TypeVar

import msgspec
import pytest

from tests.fakes import CallList, MemoryCall, PublishedPayloads
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.model_messages import JointController, PositionTolerance
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration, Time, time_from_ns
from zensim.proto.ros2.action_messages import (
    CancelCode,
    CancelGoalRequest,
    CancelGoalResponse,
    GoalId,
    GoalInfo,
    GoalStatusArray,
    GoalStatusCode,
)
from zensim.proto.ros2.action_server import CDR_ENCODING, ActionGoals
from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.proto.ros2.trajectory_messages import (
    FOLLOW_JOINT_TRAJECTORY,
    GetTrajectoryResultRequest,
    GetTrajectoryResultResponse,
    JointTolerance,
    JointTrajectory,
    JointTrajectoryPoint,
    SendTrajectoryRequest,
    SendTrajectoryResponse,
    TrajectoryCode,
    TrajectoryFeedbackMessage,
    TrajectoryGoal,
)
from zensim.robot_agent.joint_trajectory import JointsState
from zensim.robot_agent.trajectory_follower import TrajectoryFollower

Answer = TypeVar("Answer", bound=msgspec.Struct)
FIRST, SECOND = (GoalId(tuple(range(start, start + 16))) for start in (1, 101))
JOINTS = ("a", "b")
STEP_NS = NANOSECONDS // 100
SLOW_STEP_NS = NANOSECONDS // 50
"""Step length that does not divide the period of the feedback."""


class ArmFixture:
    """A controller of two joints, which go to their positions at once unless they are stuck."""

    def __init__(self, controller: JointController | None = None) -> None:
        self.queues = [CallList() for _ in range(3)]
        self.feedback, self.status = PublishedPayloads(), PublishedPayloads()
        goals = ActionGoals(FOLLOW_JOINT_TRAJECTORY, self.queues, (self.feedback, self.status))
        self.follower = TrajectoryFollower(
            controller or JointController("arm", JOINTS), goals, frozenset()
        )
        self.positions = dict.fromkeys(JOINTS, 0.0)
        self.wanted = dict(self.positions)
        self.is_stuck = False
        self.time_ns = NANOSECONDS

    def request(self, place: int, request: msgspec.Struct) -> MemoryCall:
        attachment = write_attachment(Attachment(5, 1, bytes(16)))
        call = MemoryCall("k", encode(request, Format.CDR), CDR_ENCODING, attachment)
        self.queues[place].calls.append(call)
        return call

    def send(
        self, goal_id: GoalId, *points: JointTrajectoryPoint, **tolerances: object
    ) -> MemoryCall:
        goal = TrajectoryGoal(JointTrajectory(joint_names=JOINTS, points=points))
        goal = msgspec.structs.replace(goal, **tolerances)
        return self.request(0, SendTrajectoryRequest(goal_id, goal))

    def cancel(self, goal_id: GoalId, stamp: Time = Time()) -> MemoryCall:  # noqa: B008
        return self.request(1, CancelGoalRequest(GoalInfo(goal_id, stamp)))

    def result(self, goal_id: GoalId) -> MemoryCall:
        return self.request(2, GetTrajectoryResultRequest(goal_id))

    def run(self, duration_s: float = 0.0, step_ns: int = STEP_NS) -> None:
        for _ in range(max(1, round(duration_s * NANOSECONDS / step_ns))):
            self.time_ns += step_ns
            self.follower.update(self.time_ns, self._read, self._move)
            if not self.is_stuck:
                self.positions = dict(self.wanted)

    def statuses(self) -> list[int]:
        sent = decode(GoalStatusArray, self.status.payloads[-1], CDR_ENCODING)
        return [one.status for one in sent.status_list]

    def _read(self, names: Sequence[str]) -> JointsState:
        return JointsState(tuple(self.positions[name] for name in names), (0.0,) * len(names))

    def _move(self, names: Sequence[str], positions: Sequence[float]) -> None:
        self.wanted.update(zip(names, positions, strict=True))


def a_point(time_s: int, *positions: float) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(positions, time_from_start=Duration(time_s))


def read(call: MemoryCall, kind: type[Answer]) -> Answer:
    (answer,) = call.answers
    return decode(kind, answer.payload, CDR_ENCODING)


def ended(call: MemoryCall) -> tuple[int, int]:
    response = read(call, GetTrajectoryResultResponse)
    return response.status, response.result.error_code


def test_goal_is_accepted_followed_and_succeeds_at_its_end() -> None:
    arm = ArmFixture()
    sent, asked = arm.send(FIRST, a_point(1, 0.5, -0.5)), arm.result(FIRST)

    arm.run(0.51)
    middle = dict(arm.wanted)
    arm.run(0.6)

    assert read(sent, SendTrajectoryResponse).accepted
    assert middle == pytest.approx({"a": 0.25, "b": -0.25})
    assert arm.wanted == pytest.approx({"a": 0.5, "b": -0.5})
    assert ended(asked) == (GoalStatusCode.SUCCEEDED, TrajectoryCode.SUCCESSFUL)
    assert arm.statuses() == [GoalStatusCode.SUCCEEDED]
    assert arm.follower.joints == ()


def test_feedback_has_desired_actual_and_error_at_20_hz() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(1, 0.5, -0.5))

    arm.run(0.5)

    messages = [
        decode(TrajectoryFeedbackMessage, one, CDR_ENCODING) for one in arm.feedback.payloads
    ]
    assert len(messages) == 10
    last = messages[-1].feedback
    assert last.joint_names == JOINTS
    wanted, found = last.desired.positions, last.actual.positions
    assert last.error.positions == pytest.approx(
        [one - other for one, other in zip(wanted, found, strict=True)]
    )
    assert wanted[0] == pytest.approx(0.225, abs=0.006)


def test_feedback_is_at_20_hz_on_average_if_steps_do_not_fit() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(4, 0.5, -0.5))

    arm.run(3.0, SLOW_STEP_NS)

    assert len(arm.feedback.payloads) == pytest.approx(60, abs=1)


def test_refused_goal_leaves_the_one_before() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(1, 0.5, -0.5))
    arm.run()

    refused = arm.send(SECOND, a_point(1, 0.5))
    arm.run(1.2)

    assert not read(refused, SendTrajectoryResponse).accepted
    assert arm.statuses() == [GoalStatusCode.SUCCEEDED]


def test_canceled_goal_leaves_the_joints_where_they_are() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(1, 1.0, 0.0))
    asked = arm.result(FIRST)
    arm.run(0.5)
    place = arm.positions["a"]

    canceled = arm.cancel(FIRST)
    arm.run(1.0)

    response = read(canceled, CancelGoalResponse)
    assert response.return_code == CancelCode.NONE
    assert [one.goal_id for one in response.goals_canceling] == [FIRST]
    assert ended(asked)[0] == GoalStatusCode.CANCELED
    assert arm.wanted["a"] == pytest.approx(place)


def test_goal_has_the_simulation_time_and_is_canceled_by_it() -> None:
    arm = ArmFixture()
    sent = arm.send(FIRST, a_point(1, 0.5, 0.5))
    arm.run(0.5)

    too_early = arm.cancel(GoalId(), Time(1))
    arm.run()
    now = arm.cancel(GoalId(), time_from_ns(arm.time_ns))
    arm.run()

    assert read(sent, SendTrajectoryResponse).stamp == time_from_ns(NANOSECONDS + STEP_NS)
    assert read(too_early, CancelGoalResponse).goals_canceling == ()
    assert [one.goal_id for one in read(now, CancelGoalResponse).goals_canceling] == [FIRST]


def test_cancel_of_an_unknown_or_ended_goal_says_so() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(1, 1.0, 0.0))
    arm.run(1.2)

    of_ended, of_unknown = arm.cancel(FIRST), arm.cancel(SECOND)
    arm.run()

    codes = [read(one, CancelGoalResponse).return_code for one in (of_ended, of_unknown)]
    assert codes == [CancelCode.GOAL_TERMINATED, CancelCode.UNKNOWN_GOAL_ID]


def test_new_goal_replaces_the_one_before_from_where_the_joints_are() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(1, 1.0, 0.0))
    asked = arm.result(FIRST)
    arm.run(0.5)

    arm.send(SECOND, a_point(1, 0.0, 0.0))
    arm.run(0.01)

    assert ended(asked) == (GoalStatusCode.ABORTED, TrajectoryCode.INVALID_GOAL)
    assert arm.wanted["a"] == pytest.approx(0.5, abs=0.02)


def test_joint_that_leaves_its_path_aborts_the_goal() -> None:
    arm = ArmFixture()
    arm.is_stuck = True
    arm.send(FIRST, a_point(1, 1.0, 0.0), path_tolerance=(JointTolerance("a", 0.2),))
    asked = arm.result(FIRST)

    arm.run(0.15)
    assert not asked.answers
    arm.run(0.2)

    assert ended(asked) == (GoalStatusCode.ABORTED, TrajectoryCode.PATH_TOLERANCE_VIOLATED)
    assert arm.wanted["a"] == 0.0


@pytest.mark.parametrize(("allowed", "code"), [(0.9, -4), (1.1, 0)])
def test_joint_that_is_too_slow_or_too_fast_on_its_path_aborts_the_goal(
    allowed: float, code: int
) -> None:
    arm = ArmFixture()  # its joints measure no velocity
    limits = (JointTolerance("a", velocity=allowed),)
    arm.send(FIRST, a_point(1, 1.0, 0.0), path_tolerance=limits)
    asked = arm.result(FIRST)

    arm.run(1.2)

    assert ended(asked)[1] == code


def test_joint_that_does_not_reach_the_goal_in_time_aborts_it() -> None:
    controller = JointController(
        "arm", JOINTS, tolerances=(PositionTolerance("a", goal=0.1),), goal_time_s=0.5
    )
    arm = ArmFixture(controller)
    arm.is_stuck = True
    arm.send(FIRST, a_point(1, 1.0, 0.0))
    asked = arm.result(FIRST)

    arm.run(1.4)
    assert not asked.answers
    arm.run(0.2)

    assert ended(asked) == (GoalStatusCode.ABORTED, TrajectoryCode.GOAL_TOLERANCE_VIOLATED)


def test_goal_waits_for_its_tolerance_without_a_time() -> None:
    arm = ArmFixture()
    arm.is_stuck = True
    arm.send(FIRST, a_point(1, 1.0, 0.0), goal_tolerance=(JointTolerance("a", 0.1),))
    asked = arm.result(FIRST)
    arm.run(30.0)
    assert not asked.answers

    arm.is_stuck = False
    arm.run(0.02)

    assert ended(asked) == (GoalStatusCode.SUCCEEDED, TrajectoryCode.SUCCESSFUL)


def test_abort_ends_the_goal_with_a_reason() -> None:
    arm = ArmFixture()
    arm.send(FIRST, a_point(1, 1.0, 0.0))
    asked = arm.result(FIRST)
    arm.run(0.1)

    arm.follower.abort("the world was reset")

    assert ended(asked) == (GoalStatusCode.ABORTED, TrajectoryCode.INVALID_GOAL)
    assert "reset" in read(asked, GetTrajectoryResultResponse).result.error_string
