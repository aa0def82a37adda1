"""Interpolation and validation of trajectories, by the rules of joint_trajectory_controller."""

import msgspec
import pytest

from zensim.proto.messages.model_messages import JointController, PositionTolerance
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration, Header, Time
from zensim.proto.ros2.trajectory_messages import (
    JointTolerance,
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
    TrajectoryCode,
    TrajectoryGoal,
)
from zensim.robot_agent.joint_trajectory import (
    InvalidTrajectory,
    JointsState,
    Tolerances,
    Trajectory,
    Waypoint,
    find_errors,
    find_excess,
    interpolate,
    read_goal,
)

ARM = JointController("arm", ("a", "b"))
NOW_NS = 10 * NANOSECONDS
ANY = Tolerances((0.0,), (0.0,), (0.0,), (0.0,), 0)


def a_waypoint(time_s: float, *columns: float) -> Waypoint:
    return Waypoint(round(time_s * NANOSECONDS), JointsState(*((one,) for one in columns)))


def a_point(
    time_s: float, *positions: float, velocities: tuple[float, ...] = ()
) -> JointTrajectoryPoint:
    whole = int(time_s)
    duration = Duration(whole, round((time_s - whole) * NANOSECONDS))
    return JointTrajectoryPoint(positions, velocities, time_from_start=duration)


def a_goal(*points: JointTrajectoryPoint, names: tuple[str, ...] = ("a", "b")) -> TrajectoryGoal:
    return TrajectoryGoal(JointTrajectory(joint_names=names, points=points))


GOOD = a_goal(a_point(1.0, 0.1, 0.2), a_point(2.0, 0.3, 0.4))


def at(before: Waypoint, after: Waypoint, time_s: float) -> tuple[float, float, float]:
    state = interpolate(before, after, round(time_s * NANOSECONDS))
    return state.positions[0], state.velocities[0], state.accelerations[0]


def test_positions_alone_are_joined_by_a_line() -> None:
    assert at(a_waypoint(1.0, 1.0), a_waypoint(3.0, 2.0), 2.0) == pytest.approx((1.5, 0.5, 0.0))


def test_velocities_at_both_ends_are_joined_by_a_cubic() -> None:
    one, other = a_waypoint(0.0, 0.0, 1.0), a_waypoint(2.0, 1.0, 0.0)

    assert at(one, other, 0.0)[:2] == pytest.approx((0.0, 1.0))
    assert at(one, other, 2.0)[:2] == pytest.approx((1.0, 0.0))
    assert at(one, other, 1.0) == pytest.approx((0.75, 0.5, -0.5))


def test_accelerations_at_both_ends_are_joined_by_a_quintic() -> None:
    one, other = a_waypoint(0.0, 0.0, 0.0, 0.0), a_waypoint(2.0, 1.0, 0.5, -0.25)

    assert at(one, other, 0.0) == pytest.approx((0.0, 0.0, 0.0))
    assert at(one, other, 2.0) == pytest.approx((1.0, 0.5, -0.25))
    step = 1e-4
    before, after = at(one, other, 1.0 - step), at(one, other, 1.0 + step)
    middle = at(one, other, 1.0)
    assert middle[1] == pytest.approx((after[0] - before[0]) / (2.0 * step), rel=1e-6)
    assert middle[2] == pytest.approx((after[1] - before[1]) / (2.0 * step), rel=1e-6)


def test_velocity_of_one_end_only_gives_a_line() -> None:
    assert at(a_waypoint(0.0, 0.0, 5.0), a_waypoint(1.0, 1.0), 0.5)[1] == pytest.approx(1.0)


def test_trajectory_goes_from_its_start_through_its_points_and_stays_at_the_last() -> None:
    trajectory = Trajectory(("a",), (a_waypoint(1.0, 1.0), a_waypoint(2.0, 3.0)), ANY)
    start = a_waypoint(0.0, 0.0)

    found = [
        trajectory.sample(start, round(time_s * NANOSECONDS)).positions[0]
        for time_s in (0.0, 0.5, 1.0, 1.5, 2.0, 9.0)
    ]

    assert found == pytest.approx([0.0, 0.5, 1.0, 2.0, 3.0, 3.0])
    assert trajectory.sample(start, trajectory.end_ns).velocities == (0.0,)


def test_goal_begins_now_or_at_its_stamp() -> None:
    now = read_goal(GOOD, ARM, NOW_NS)
    stamped = msgspec.structs.replace(GOOD.trajectory, header=Header(Time(20)))
    later = read_goal(msgspec.structs.replace(GOOD, trajectory=stamped), ARM, NOW_NS)

    assert [one.time_ns - NOW_NS for one in now.waypoints] == [NANOSECONDS, 2 * NANOSECONDS]
    assert later.end_ns == 22 * NANOSECONDS


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        (a_goal(a_point(1.0, 0.1, 0.2), names=("a", "c")), TrajectoryCode.INVALID_JOINTS),
        (a_goal(a_point(1.0, 0.1, 0.2), names=("a", "a")), TrajectoryCode.INVALID_JOINTS),
        (a_goal(a_point(1.0, 0.1), names=("a",)), TrajectoryCode.INVALID_JOINTS),
        (a_goal(names=()), TrajectoryCode.INVALID_JOINTS),
        (a_goal(), TrajectoryCode.INVALID_GOAL),
        (a_goal(a_point(1.0, 0.1)), TrajectoryCode.INVALID_GOAL),
        (a_goal(a_point(1.0, 0.1, float("nan"))), TrajectoryCode.INVALID_GOAL),
        (a_goal(a_point(1.0, 0.1, 0.2), a_point(1.0, 0.3, 0.4)), TrajectoryCode.INVALID_GOAL),
        (a_goal(a_point(-1.0, 0.1, 0.2)), TrajectoryCode.INVALID_GOAL),
        (a_goal(a_point(1.0, 0.1, 0.2, velocities=(1.0,))), TrajectoryCode.INVALID_GOAL),
        (a_goal(a_point(1.0, 0.1, 0.2, velocities=(0.0, 0.1))), TrajectoryCode.INVALID_GOAL),
        (
            msgspec.structs.replace(GOOD, path_tolerance=(JointTolerance("c", 0.1),)),
            TrajectoryCode.INVALID_JOINTS,
        ),
        (
            msgspec.structs.replace(GOOD, goal_tolerance=(JointTolerance("a", -0.5),)),
            TrajectoryCode.INVALID_GOAL,
        ),
        (
            msgspec.structs.replace(GOOD, path_tolerance=(JointTolerance("a", acceleration=1.0),)),
            TrajectoryCode.INVALID_GOAL,
        ),
        (
            msgspec.structs.replace(GOOD, goal_tolerance=(JointTolerance("b", acceleration=1.0),)),
            TrajectoryCode.INVALID_GOAL,
        ),
        (
            msgspec.structs.replace(GOOD, goal_time_tolerance=Duration(-1)),
            TrajectoryCode.INVALID_GOAL,
        ),
        (
            msgspec.structs.replace(
                GOOD, trajectory=msgspec.structs.replace(GOOD.trajectory, header=Header(Time(1)))
            ),
            TrajectoryCode.OLD_HEADER_TIMESTAMP,
        ),
        (
            msgspec.structs.replace(
                GOOD,
                multi_dof_trajectory=MultiDOFJointTrajectory(
                    points=(MultiDOFJointTrajectoryPoint(),)
                ),
            ),
            TrajectoryCode.INVALID_GOAL,
        ),
    ],
)
def test_goal_is_refused_with_its_code(goal: TrajectoryGoal, code: TrajectoryCode) -> None:
    with pytest.raises(InvalidTrajectory) as refused:
        read_goal(goal, ARM, NOW_NS)

    assert refused.value.code is code


def test_controller_may_allow_partial_goals_and_a_moving_end() -> None:
    generous = JointController("arm", ("a", "b"), allows_partial_goals=True, allows_moving_end=True)

    found = read_goal(a_goal(a_point(1.0, 0.1, velocities=(0.5,)), names=("b",)), generous, NOW_NS)

    assert found.joints == ("b",)


def test_tolerances_are_those_of_the_goal_else_of_the_controller() -> None:
    limited = JointController(
        "arm",
        ("a", "b"),
        tolerances=(PositionTolerance("a", 0.1, 0.2), PositionTolerance("b", 0.3, 0.4)),
        goal_time_s=2.0,
    )
    given = msgspec.structs.replace(
        GOOD,
        path_tolerance=(JointTolerance("a", 0.7, 0.6, -1.0), JointTolerance("b", -1.0)),
        goal_tolerance=(JointTolerance("b", 0.0, velocity=0.5),),
    )

    found = read_goal(given, limited, NOW_NS).tolerances

    assert found.path == (0.7, 0.0)
    assert found.path_velocity == (0.6, 0.0)
    assert found.goal == (0.2, 0.4)
    assert found.stopped == (0.01, 0.5)
    assert found.goal_time_ns == 2 * NANOSECONDS


def test_error_of_a_joint_without_limits_is_the_shorter_way_round() -> None:
    assert find_errors((3.1, 3.1), (-3.1, -3.1), (True, False)) == pytest.approx(
        (6.2 - 6.283185307, 6.2)
    )


def test_excess_is_the_first_joint_beyond_its_limit() -> None:
    assert find_excess((9.0, -0.3, 0.4), (0.0, 0.2, 0.2)) == 1
    assert find_excess((0.1, 0.1), (0.2, 0.0)) is None
