"""Trajectories of joints: validation, interpolation, tolerances. No network, no clock.

As joint_trajectory_controller of ros2_controllers has them: linear between positions, cubic where
both points have velocities, quintic where both have accelerations, too.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from zensim.proto.messages.model_messages import JointController
from zensim.proto.messages.standard_messages import NANOSECONDS, duration_from_ns, ns_from_time
from zensim.proto.ros2.trajectory_messages import (
    JointTolerance,
    JointTrajectory,
    JointTrajectoryPoint,
    TrajectoryCode,
    TrajectoryGoal,
)

ERASED: Final = -1.0
"""Tolerance without a limit, whatever the controller has."""
MAX_POINTS: Final = 10_000
FULL_TURN_RAD: Final = 2.0 * math.pi


class InvalidTrajectory(ValueError):
    """A goal that cannot be followed."""

    def __init__(self, code: TrajectoryCode, reason: str) -> None:
        super().__init__(reason)
        self.code = code


@dataclass(frozen=True)
class JointsState:
    """Positions, velocities and accelerations of some joints; the last two may be empty.

    Attributes:
        positions: [rad or m].
    """

    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()

    def to_message(self, time_ns: int = 0) -> JointTrajectoryPoint:
        """Make a point at a time from the start."""
        return JointTrajectoryPoint(
            self.positions,
            self.velocities,
            self.accelerations,
            time_from_start=duration_from_ns(time_ns),
        )


@dataclass(frozen=True)
class Waypoint:
    """State of joints at a simulation time."""

    time_ns: int
    state: JointsState


@dataclass(frozen=True)
class Tolerances:
    """Greatest errors of each joint; 0 = any.

    Attributes:
        path: Of positions, before the end [rad or m].
        path_velocity: Of velocities, before the end [rad/s or m/s].
        goal: Of positions, at the end.
        stopped: Of velocities at the end [rad/s or m/s].
        goal_time_ns: Time after the end to come within them; 0 = unlimited.
    """

    path: tuple[float, ...]
    path_velocity: tuple[float, ...]
    goal: tuple[float, ...]
    stopped: tuple[float, ...]
    goal_time_ns: int


@dataclass(frozen=True)
class Trajectory:
    """Waypoints of some joints, in order of time.

    Attributes:
        joints: Names, in the order of the numbers.
    """

    joints: tuple[str, ...]
    waypoints: tuple[Waypoint, ...]
    tolerances: Tolerances

    @property
    def end_ns(self) -> int:
        """Time of the last waypoint."""
        return self.waypoints[-1].time_ns

    def sample(self, start: Waypoint, time_ns: int) -> JointsState:
        """Find where the joints shall be.

        Args:
            start: Where they were when the trajectory began.
            time_ns: Simulation time, not before that.
        """
        place = bisect_right(self.waypoints, time_ns, key=lambda waypoint: waypoint.time_ns)
        if place == len(self.waypoints):
            return _rest_at(self.waypoints[-1].state)
        before = self.waypoints[place - 1] if place else start
        return interpolate(before, self.waypoints[place], time_ns)


def _rest_at(state: JointsState) -> JointsState:
    zeros = (0.0,) * len(state.positions)
    return JointsState(state.positions, state.velocities or zeros, state.accelerations or zeros)


def interpolate(before: Waypoint, after: Waypoint, time_ns: int) -> JointsState:
    """Find the state between two waypoints.

    Args:
        before: Earlier one.
        after: Later one.
        time_ns: Between their times.
    """
    span_s = (after.time_ns - before.time_ns) / NANOSECONDS
    at_s = (time_ns - before.time_ns) / NANOSECONDS
    one, other = before.state, after.state
    has_velocities = bool(one.velocities and other.velocities)
    has_accelerations = has_velocities and bool(one.accelerations and other.accelerations)
    columns = []
    for place in range(len(one.positions)):
        ends: tuple[float, ...] = (one.positions[place], other.positions[place])
        if has_velocities:
            ends += (one.velocities[place] * span_s, other.velocities[place] * span_s)
        if has_accelerations:
            square = span_s * span_s
            ends += (one.accelerations[place] * square, other.accelerations[place] * square)
        columns.append(_evaluate(_find_coefficients(ends), at_s / span_s, span_s))
    positions, velocities, accelerations = zip(*columns, strict=True)
    return JointsState(positions, velocities, accelerations)


def _find_coefficients(ends: tuple[float, ...]) -> tuple[float, ...]:
    """Find the coefficients of the polynomial over 0 to 1 with given values at both ends.

    Args:
        ends: Positions; velocities; accelerations: each at 0 and at 1.
    """
    start, end, *more = ends
    way = end - start
    if not more:
        return (start, way)
    v0, v1, *more = more
    if not more:
        return (start, v0, 3.0 * way - 2.0 * v0 - v1, v0 + v1 - 2.0 * way)
    a0, a1 = more
    return (
        start,
        v0,
        a0 / 2.0,
        10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
        -15.0 * way + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
        6.0 * way - 3.0 * (v0 + v1) + 0.5 * (a1 - a0),
    )


def _evaluate(
    coefficients: tuple[float, ...], share: float, span_s: float
) -> tuple[float, float, float]:
    """Evaluate a polynomial and its derivatives by time at a share of the span."""
    position = velocity = acceleration = 0.0
    for coefficient in reversed(coefficients):
        acceleration = acceleration * share + 2.0 * velocity
        velocity = velocity * share + position
        position = position * share + coefficient
    return position, velocity / span_s, acceleration / (span_s * span_s)


def find_errors(
    desired: Sequence[float], actual: Sequence[float], turns: Sequence[bool]
) -> tuple[float, ...]:
    """Find desired minus actual positions; the shorter way round for joints that turn freely."""
    return tuple(
        math.remainder(wanted - found, FULL_TURN_RAD) if is_turning else wanted - found
        for wanted, found, is_turning in zip(desired, actual, turns, strict=True)
    )


def find_excess(errors: Sequence[float], limits: Sequence[float]) -> int | None:
    """Find the first joint whose error is beyond its limit; limits of 0 do not count."""
    for place, (error, limit) in enumerate(zip(errors, limits, strict=True)):
        if 0.0 < limit < abs(error):
            return place
    return None


def read_goal(goal: TrajectoryGoal, controller: JointController, now_ns: int) -> Trajectory:
    """Read the goal of a controller.

    Args:
        goal: As received.
        controller: Its joints and default tolerances.
        now_ns: Simulation time, at which a trajectory without a stamp starts.

    Raises:
        InvalidTrajectory: It cannot be followed.
    """
    if goal.multi_dof_trajectory.points:
        raise InvalidTrajectory(
            TrajectoryCode.INVALID_GOAL,
            "planar and floating joints have no trajectories; leave multi_dof_trajectory empty",
        )
    trajectory = goal.trajectory
    _check_joints(trajectory.joint_names, controller)
    _check_points(trajectory, controller)
    start_ns = ns_from_time(trajectory.header.stamp) or now_ns
    waypoints = tuple(_read_waypoint(point, start_ns) for point in trajectory.points)
    if waypoints[-1].time_ns < now_ns:
        raise InvalidTrajectory(
            TrajectoryCode.OLD_HEADER_TIMESTAMP,
            f"it ends {(now_ns - waypoints[-1].time_ns) / NANOSECONDS:.3f} s before now; "
            "stamp it with simulation time, or 0",
        )
    tolerances = _read_tolerances(goal, controller)
    return Trajectory(trajectory.joint_names, waypoints, tolerances)


def _read_waypoint(point: JointTrajectoryPoint, start_ns: int) -> Waypoint:
    state = JointsState(point.positions, point.velocities, point.accelerations)
    return Waypoint(start_ns + ns_from_time(point.time_from_start), state)


def _check_joints(names: Sequence[str], controller: JointController) -> None:
    unknown = [name for name in names if name not in controller.joints]
    if unknown or not names or len(set(names)) < len(names):
        what = f"'{unknown[0][:80]}' is none" if unknown else "joints are missing or named twice"
        raise InvalidTrajectory(
            TrajectoryCode.INVALID_JOINTS,
            f"{what} of controller '{controller.name}': {', '.join(controller.joints)}",
        )
    if len(names) < len(controller.joints) and not controller.allows_partial_goals:
        missing = [name for name in controller.joints if name not in names]
        raise InvalidTrajectory(
            TrajectoryCode.INVALID_JOINTS,
            f"joint '{missing[0]}' is missing; name all joints of controller '{controller.name}', "
            "or set its allow_partial_joints_goal",
        )


def _check_points(trajectory: JointTrajectory, controller: JointController) -> None:
    points, count = trajectory.points, len(trajectory.joint_names)
    if not 1 <= len(points) <= MAX_POINTS:
        raise _refuse(f"{len(points)} points; send 1 to {MAX_POINTS}")
    before_ns = -1
    for number, point in enumerate(points):
        time_ns = ns_from_time(point.time_from_start)
        if time_ns <= before_ns:
            raise _refuse(f"point {number} is not later than the one before; times must rise")
        before_ns = time_ns
        _check_numbers(point, number, count)
    if any(points[-1].velocities) and not controller.allows_moving_end:
        raise _refuse("the last point has a velocity; joints must stop there")


def _check_numbers(point: JointTrajectoryPoint, number: int, count: int) -> None:
    if point.effort:
        raise _refuse(f"point {number} has efforts; trajectories have positions")
    if len(point.positions) != count:
        raise _refuse(f"point {number} has {len(point.positions)} positions for {count} joints")
    for listed in (point.velocities, point.accelerations):
        if len(listed) not in (0, count):
            raise _refuse(f"point {number} has {len(listed)} derivatives for {count} joints")
    if not all(map(math.isfinite, (*point.positions, *point.velocities, *point.accelerations))):
        raise _refuse(f"point {number} has a number that is not finite")


def _refuse(reason: str) -> InvalidTrajectory:
    return InvalidTrajectory(TrajectoryCode.INVALID_GOAL, reason)


def _read_tolerances(goal: TrajectoryGoal, controller: JointController) -> Tolerances:
    names = goal.trajectory.joint_names
    defaults = {one.joint: one for one in controller.tolerances}
    path = {name: defaults[name].path for name in names if name in defaults}
    ends = {name: defaults[name].goal for name in names if name in defaults}
    stopped = dict.fromkeys(names, controller.stopped_velocity)
    path_velocity = dict.fromkeys(names, 0.0)
    for one in (*goal.path_tolerance, *goal.goal_tolerance):
        if one.acceleration not in (0.0, ERASED):
            raise _refuse(
                f"a tolerance of '{one.name[:80]}' is an acceleration, which no joint measures; "
                "use 0, and limit position or velocity"
            )
    for one in goal.path_tolerance:
        _override(path, one.position, one, names)
        _override(path_velocity, one.velocity, one, names)
    for one in goal.goal_tolerance:
        _override(ends, one.position, one, names)
        _override(stopped, one.velocity, one, names)
    time_ns = ns_from_time(goal.goal_time_tolerance)
    if time_ns < 0:
        raise _refuse("goal_time_tolerance is negative")
    return Tolerances(
        tuple(path.get(name, 0.0) for name in names),
        tuple(path_velocity[name] for name in names),
        tuple(ends.get(name, 0.0) for name in names),
        tuple(stopped[name] for name in names),
        time_ns or round(controller.goal_time_s * NANOSECONDS),
    )


def _override(
    limits: dict[str, float], given: float, tolerance: JointTolerance, names: Sequence[str]
) -> None:
    if tolerance.name not in names:
        raise InvalidTrajectory(
            TrajectoryCode.INVALID_JOINTS,
            f"a tolerance is of '{tolerance.name[:80]}', which is not in the trajectory",
        )
    if (given < 0.0 and given != ERASED) or not math.isfinite(given):
        raise _refuse(f"a tolerance of '{tolerance.name}' is {given:g}; use -1 for none")
    if given != 0.0:
        limits[tolerance.name] = max(given, 0.0)
