"""TrajectoryFollower: the action FollowJointTrajectory of one controller of a robot."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from zensim.proto.messages.model_messages import JointController
from zensim.proto.messages.standard_messages import Header, time_from_ns
from zensim.proto.network_protocols import Query
from zensim.proto.rate_limiter import RateLimiter
from zensim.proto.ros2.action_messages import (
    CancelCode,
    CancelGoalRequest,
    CancelGoalResponse,
    GoalStatusCode,
)
from zensim.proto.ros2.action_server import ActionGoal, ActionGoals, goal_id_to_hex, reply_to
from zensim.proto.ros2.trajectory_messages import (
    SendTrajectoryRequest,
    TrajectoryCode,
    TrajectoryFeedback,
    TrajectoryFeedbackMessage,
    TrajectoryResult,
)
from zensim.robot_agent.joint_trajectory import (
    InvalidTrajectory,
    JointsState,
    Trajectory,
    Waypoint,
    find_errors,
    find_excess,
    read_goal,
)

LOG = logging.getLogger("zensim.agent")
FEEDBACK_HZ = 20.0
"""Rate of feedback in simulation time, as in ros2_controllers."""
ReadJoints = Callable[[Sequence[str]], JointsState]
"""Reads positions and velocities of joints, by name, at the present state."""
SetPositions = Callable[[Sequence[str], Sequence[float]], None]
"""Sets the positions that joints are to have."""


@dataclass
class _ActiveGoal:
    """The goal that is followed.

    Attributes:
        start: Where the joints were when it came.
        feedback: Whether feedback is due.
    """

    goal: ActionGoal
    trajectory: Trajectory
    start: Waypoint
    turns: tuple[bool, ...]
    feedback: RateLimiter


@dataclass(frozen=True)
class _Progress:
    """Desired and actual state at a time, and the errors of positions and velocities."""

    time_ns: int
    desired: JointsState
    actual: JointsState
    errors: JointsState


class TrajectoryFollower:
    """Follows the goals of one controller, the newest at a time, as ros2_controllers does."""

    def __init__(
        self, controller: JointController, goals: ActionGoals, turning: frozenset[str]
    ) -> None:
        """Start without a goal.

        Args:
            controller: Joints and default tolerances.
            goals: Of its action.
            turning: Joints that turn without limits: their errors are the shorter way round.
        """
        self._controller = controller
        self._goals = goals
        self._turning = turning
        self._active: _ActiveGoal | None = None

    @property
    def name(self) -> str:
        """Name of the controller."""
        return self._controller.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that a goal moves now."""
        return self._active.trajectory.joints if self._active is not None else ()

    def abort(self, reason: str) -> None:
        """Abort the goal, if there is one."""
        self._end(GoalStatusCode.ABORTED, TrajectoryCode.INVALID_GOAL, reason)

    def update(self, time_ns: int, read: ReadJoints, move: SetPositions) -> None:
        """Take requests, and move the joints on.

        Args:
            time_ns: Simulation time.
            read: Reads joints.
            move: Sets their positions.
        """
        for goal, request in self._goals.take_new(time_ns):
            assert isinstance(request, SendTrajectoryRequest)
            self._start(goal, request, time_ns, read)
        for query, cancel in self._goals.take_cancellations():
            if self._cancel(query, cancel):
                self._hold_at(self.joints, read(self.joints), move)
                self._end(GoalStatusCode.CANCELED, TrajectoryCode.SUCCESSFUL, "canceled")
        self._goals.poll()
        if self._active is not None:
            self._follow(self._active, time_ns, read, move)

    def _start(
        self, goal: ActionGoal, request: SendTrajectoryRequest, time_ns: int, read: ReadJoints
    ) -> None:
        try:
            trajectory = read_goal(request.goal, self._controller, time_ns)
        except InvalidTrajectory as error:
            LOG.warning(
                "trajectory controller=%s code=%s reason=%r",
                *(self._controller.name, error.code.name, str(error)),
            )
            self._goals.refuse(goal)
            return
        self.abort("another goal has replaced it")
        self._goals.accept(goal)
        turns = tuple(name in self._turning for name in trajectory.joints)
        start = Waypoint(time_ns, read(trajectory.joints))
        self._active = _ActiveGoal(goal, trajectory, start, turns, RateLimiter(FEEDBACK_HZ))

    def _follow(
        self, active: _ActiveGoal, time_ns: int, read: ReadJoints, move: SetPositions
    ) -> None:
        trajectory, tolerances = active.trajectory, active.trajectory.tolerances
        progress = _measure(active, time_ns, read(trajectory.joints))
        if active.feedback.is_due(time_ns):
            self._goals.publish_feedback(lambda: _make_feedback(active, progress))
        late_ns = time_ns - trajectory.end_ns
        if late_ns < 0:
            excess = _find_excess(progress.errors, tolerances.path, tolerances.path_velocity)
            if excess is not None:
                self._abort_at(excess, progress, TrajectoryCode.PATH_TOLERANCE_VIOLATED)
                self._hold_at(trajectory.joints, progress.actual, move)
                return
        move(trajectory.joints, progress.desired.positions)
        if late_ns < 0:
            return
        excess = _find_excess(progress.errors, tolerances.goal, tolerances.stopped)
        if excess is None:
            self._end(GoalStatusCode.SUCCEEDED, TrajectoryCode.SUCCESSFUL, "")
        elif 0 < tolerances.goal_time_ns < late_ns:
            self._abort_at(excess, progress, TrajectoryCode.GOAL_TOLERANCE_VIOLATED)
            self._hold_at(trajectory.joints, progress.actual, move)

    def _cancel(self, query: Query, request: CancelGoalRequest) -> bool:
        """Reply to a request to cancel; return whether it is about the goal that is followed."""
        wanted, code = self._goals.select_canceled(request), CancelCode.NONE
        if not wanted and (name := goal_id_to_hex(request.goal_info.goal_id)):
            is_known = self._goals.find(name) is not None
            code = CancelCode.GOAL_TERMINATED if is_known else CancelCode.UNKNOWN_GOAL_ID
        reply_to(query, CancelGoalResponse(code, tuple(goal.info for goal in wanted)))
        return bool(wanted)

    def _hold_at(self, joints: Sequence[str], state: JointsState, move: SetPositions) -> None:
        move(joints, state.positions)

    def _abort_at(self, place: int, progress: _Progress, code: TrajectoryCode) -> None:
        joint = self.joints[place]
        position, velocity = progress.errors.positions[place], progress.errors.velocities[place]
        self._end(
            GoalStatusCode.ABORTED,
            code,
            f"joint '{joint}' is {position:.4g} from its position, {velocity:.4g} from its speed",
        )

    def _end(self, status: GoalStatusCode, code: TrajectoryCode, reason: str) -> None:
        if (active := self._active) is None:
            return
        self._active = None
        self._goals.end(active.goal, status, TrajectoryResult(code, reason))


def _measure(active: _ActiveGoal, time_ns: int, actual: JointsState) -> _Progress:
    desired = active.trajectory.sample(active.start, time_ns)
    speeds = zip(desired.velocities, actual.velocities, strict=True)
    errors = JointsState(
        find_errors(desired.positions, actual.positions, active.turns),
        tuple(wanted - found for wanted, found in speeds),
    )
    return _Progress(time_ns, desired, actual, errors)


def _find_excess(
    errors: JointsState, positions: Sequence[float], velocities: Sequence[float]
) -> int | None:
    excess = find_excess(errors.positions, positions)
    return find_excess(errors.velocities, velocities) if excess is None else excess


def _make_feedback(active: _ActiveGoal, progress: _Progress) -> TrajectoryFeedbackMessage:
    elapsed_ns = progress.time_ns - active.start.time_ns
    return TrajectoryFeedbackMessage(
        active.goal.goal_id,
        TrajectoryFeedback(
            Header(time_from_ns(progress.time_ns)),
            active.trajectory.joints,
            progress.desired.to_message(elapsed_ns),
            progress.actual.to_message(elapsed_ns),
            progress.errors.to_message(elapsed_ns),
        ),
    )
