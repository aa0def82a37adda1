"""Checks on hand-made states: margins, times and verdicts."""

import math
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np
import pytest

from zensim.scenario.check_monitors import (
    CheckedState,
    CheckMonitor,
    CheckResult,
    MessageCount,
    Outline,
    ScenarioEvent,
    WorldOutlines,
    find_depths,
    find_gaps,
    make_monitor,
    make_outline,
    make_rate_margin,
)
from zensim.scenario.scenario_format import Check, RateCheck
from zensim.scenario.wall_outlines import Wall

WALLS = [
    Wall("north", 0.0, 10.0, 0.0, 20.0, 0.1),
    Wall("slanted", 20.0, 0.0, math.pi / 4, 2.0, 0.1),
]
SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]


def state(
    now: float,
    poses: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0), (5.0, 0.0, 0.0)),
    *,
    speeds: Sequence[float] = (0.0, 0.0),
    events: tuple[ScenarioEvent, ...] = (),
    active: frozenset[str] = frozenset(),
) -> CheckedState:
    twists = np.zeros((len(poses), 6))
    twists[:, 0] = speeds
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1))
    return CheckedState(now, 0.1, np.array(poses), twists, upright, 2.0, events, active)


def check_of(that: str, **values: object) -> Check:
    found: Check = msgspec.convert({"that": that, "name": "c", **values}, Check)
    return found


def monitor_of(check: Check, robots: int = 2, **others: CheckMonitor) -> CheckMonitor:
    outlines = WorldOutlines(
        {f"r{row}": Outline(0.0, 0.0, 0.5, 0.25) for row in range(robots)}, WALLS
    )
    names = [f"r{row}" for row in range(robots)]
    return make_monitor(
        check, names, rows=np.arange(robots), place="f:1", outlines=outlines, others=others
    )


def judge(check: Check, states: Iterator[CheckedState] | Sequence[CheckedState]) -> CheckResult:
    monitor = monitor_of(check)
    for one in states:
        monitor.update(one)
    return monitor.report()


def with_speeds(*speeds: float) -> list[CheckedState]:
    return [state(0.1 * n, speeds=(v, 0.0)) for n, v in enumerate(speeds)]


@pytest.mark.parametrize(
    ("check", "pose", "margin"),
    [
        (check_of("distance", above=3.0), (5.0, 0.0, 0.0), 2.0),
        (check_of("distance", below=4.0), (5.0, 0.0, 0.0), -1.0),
        (check_of("no_collision"), (5.0, 0.0, 0.0), 4.0),
        (check_of("no_collision"), (0.9, 0.0, 0.0), -0.1),
        (check_of("no_collision"), (0.9, 0.0, math.pi / 2.0), 0.15),
        (check_of("no_collision", radius=1.0), (1.5, 0.0, 0.0), -0.5),
        (check_of("reached", point=[3, 0], tolerance=2.5, by=1.0), (5.0, 0.0, 0.0), -0.5),
        (check_of("inside", polygon=SQUARE), (1.0, 2.0, 0.0), 0.0),
        (check_of("outside", polygon=SQUARE), (1.0, 2.0, 0.0), -1.0),
        (check_of("tracking", path=[[0, 0], [4, 0]], below=0.5), (2.0, 1.0, 0.0), -0.5),
        (check_of("upright", below=0.5), (5.0, 0.0, 0.0), 0.5),
        (check_of("real_time_factor", above=1.5), (5.0, 0.0, 0.0), 0.5),
    ],
)
def test_margin_of_each_kind(check: Check, pose: tuple[float, float, float], margin: float) -> None:
    found = judge(check, [state(0.0, ((0.0, 0.0, 0.0), pose))])

    assert found.margin == pytest.approx(margin)
    assert found.verdict == ("passed" if margin >= 0.0 else "failed")


def test_speed_has_two_limits() -> None:
    assert judge(check_of("speed", below=0.5), with_speeds(0.1, 0.4)).margin == pytest.approx(0.1)
    assert judge(check_of("speed", above=0.0), with_speeds(0.1, 0.4)).verdict == "passed"
    assert judge(check_of("speed", above=0.1), with_speeds(0.1, 0.4)).verdict == "failed"


def test_acceleration_is_the_change_of_speed() -> None:
    check = check_of("acceleration", below=2.0)
    monitor = monitor_of(check)
    before = state(0.0, speeds=(0.0, 0.0))
    monitor.update(before)

    fast = state(0.1, speeds=(0.3, 0.0))
    monitor.update(
        CheckedState(fast.now, 0.1, fast.poses, fast.twists, fast.orientations, 1.0, before=before)
    )

    assert monitor.report().margin == pytest.approx(-1.0)


def test_tilt_is_found_from_the_orientation() -> None:
    monitor = monitor_of(check_of("upright", below=0.5), robots=1)
    tilted = np.array([[math.sin(0.4), 0.0, 0.0, math.cos(0.4)]])

    monitor.update(CheckedState(0.0, 0.1, np.zeros((1, 3)), np.zeros((1, 6)), tilted))

    assert monitor.report().margin == pytest.approx(-0.3)


def test_failure_names_robot_time_and_margin() -> None:
    found = judge(check_of("speed", below=0.5), with_speeds(0.1, 0.9, 0.2))

    assert (found.robot, found.place) == ("r0", "f:1")
    assert found.time == pytest.approx(0.1)
    assert found.margin == pytest.approx(-0.4)
    assert found.is_failure


def test_warning_is_no_failure() -> None:
    found = judge(check_of("speed", below=0.5, severity="warn"), with_speeds(0.9))

    assert found.verdict == "failed"
    assert not found.is_failure


def test_samples_outside_of_from_and_to_do_not_count() -> None:
    check = check_of("speed", below=0.5, **{"from": 0.1, "to": 0.2})

    assert judge(check, with_speeds(9.0, 0.1, 0.2, 9.0)).verdict == "passed"


def test_by_needs_it_once() -> None:
    check = check_of("speed", above=0.5, by=0.2, robots="r0")
    monitor = make_monitor(
        check, ["r0"], rows=np.array([0]), place="", outlines=WorldOutlines(), others={}
    )

    for one in with_speeds(0.0, 0.7, 0.0, 0.0):
        monitor.update(one)

    assert monitor.report().margin == pytest.approx(0.2)


def test_exception_is_not_looked_at() -> None:
    check = check_of("speed", below=0.5, **{"except": "deaf"})
    states = [state(0.0, speeds=(0.1, 0.0)), state(0.1, speeds=(9, 0), active=frozenset({"deaf"}))]

    assert judge(check, states).verdict == "passed"


def test_until_ends_the_check() -> None:
    check = check_of("speed", below=0.5, until="deaf")
    event = ScenarioEvent(0.1, "deaf", "start")
    states = [state(0.0), state(0.1, speeds=(9.0, 0.0), events=(event,)), state(0.2, speeds=(9, 0))]

    assert judge(check, states).verdict == "passed"


def test_response_is_needed_after_each_start() -> None:
    check = check_of("speed", below=0.1, after="dies", within=0.2)
    start = (ScenarioEvent(0.0, "dies", "start"),)
    again = (ScenarioEvent(0.5, "dies", "start"),)
    quick = [state(0.0, speeds=(1, 0), events=start), state(0.2), state(0.3, speeds=(1, 0))]
    late = [state(0.5, speeds=(1, 0), events=again), state(0.7, speeds=(1, 0)), state(0.8)]

    assert judge(check, quick).verdict == "passed"
    assert judge(check, [*quick, *late]).verdict == "failed"


def test_check_whose_event_never_came_is_not_evaluated() -> None:
    found = judge(check_of("speed", below=0.1, after="dies", within=0.2), with_speeds(0.0, 0.0))

    assert found.verdict == "not_evaluated"
    assert found.is_failure
    assert math.isnan(found.margin)


def test_hold_has_to_be_kept() -> None:
    check = check_of("speed", below=0.5, by=0.3, hold=0.2)

    assert judge(check, with_speeds(1, 0, 1, 0, 1, 0, 1)).verdict == "failed"
    assert judge(check, with_speeds(1, 0, 0, 0, 1, 0, 1)).verdict == "passed"


def test_hold_that_is_not_over_at_the_end_is_named() -> None:
    found = judge(check_of("speed", below=0.5, by=0.3, hold=9.0), with_speeds(0, 0, 0))

    assert found.verdict == "failed"
    assert "`hold` (9 s)" in found.message
    assert math.isnan(found.time)


def test_no_event_fails_when_it_comes() -> None:
    check = check_of("no_event", event="dies")
    event = ScenarioEvent(0.1, "dies", "start")

    assert judge(check, [state(0.0)]).verdict == "passed"
    assert judge(check, [state(0.0), state(0.1, events=(event,))]).verdict == "failed"


@pytest.mark.parametrize(("that", "verdict"), [("all_of", "failed"), ("any_of", "passed")])
def test_checks_combine(that: str, verdict: str) -> None:
    parts = {
        "slow": monitor_of(check_of("speed", below=0.5)),
        "near": monitor_of(check_of("distance", below=4.0)),
    }
    combined = monitor_of(check_of(that, checks=[*parts]), 2, **parts)

    for one in (*parts.values(), combined):
        one.update(state(0.0))

    assert combined.report().verdict == verdict


def test_gap_of_turned_rectangles_has_the_right_sign() -> None:
    boxes = np.array([[0.0, 0.0, 1.0, 0.1]] * 2)
    crossing = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, math.pi / 2.0]])
    beside = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]])
    first, second = np.array([0]), np.array([1])

    assert find_gaps(crossing, boxes, first, second)[0] < 0.0
    assert find_gaps(beside, boxes, first, second)[0] == pytest.approx(0.3)


def test_depth_in_a_polygon_is_signed() -> None:
    depths = find_depths(np.array([[2.0, 2.0], [5.0, 2.0], [3.5, 2.0]]), np.array(SQUARE, float))

    assert depths == pytest.approx([2.0, -1.0, 0.5])


def test_outline_is_around_two_corners() -> None:
    assert make_outline([(1.0, 0.2), (-0.5, -0.2)]) == Outline(0.25, 0.0, 0.75, 0.2)
    assert make_outline([]) == Outline()


def test_end_of_a_run_is_known_early() -> None:
    limit = monitor_of(check_of("speed", below=0.5))
    goal = monitor_of(check_of("speed", below=0.5, by=1.0))

    for monitor in (limit, goal):
        monitor.update(state(0.0))

    assert not limit.has_passed(0.0)
    assert goal.has_passed(0.0)
    limit.update(state(0.1, speeds=(9.0, 0.0)))
    assert limit.has_failed(0.1)
    assert not goal.has_failed(0.1)


def test_a_hundred_robots_are_checked_at_once() -> None:
    names = [f"r{row}" for row in range(100)]
    rows = np.arange(100)
    made = [
        make_monitor(check, names, rows=rows, place="", outlines=WorldOutlines(), others={})
        for check in (check_of("distance", above=0.1), check_of("speed", below=9.0))
    ]
    poses = np.column_stack([np.arange(100.0), np.zeros(100), np.zeros(100)])
    sample = state(0.0, poses.tolist(), speeds=[0.0] * 100)

    for _ in range(20):
        for monitor in made:
            monitor.update(sample)

    assert [monitor.report().verdict for monitor in made] == ["passed", "passed"]


def test_walls_count_as_collisions() -> None:
    check = check_of("no_collision")

    result = judge(check, [state(0.0, [[0.0, 9.0, 0.0], [5.0, 0.0, 0.0]])])
    touching = judge(check, [state(0.0, [[0.0, 9.0, math.pi / 2], [5.0, 0.0, 0.0]])])

    assert (result.verdict, result.robot) == ("passed", "r0, north")
    assert result.margin == pytest.approx(0.65)
    assert touching.margin == pytest.approx(0.4)


def test_slanted_wall_is_a_slanted_rectangle() -> None:
    result = judge(check_of("no_collision"), [state(0.0, [[20.0, 2.0, 0.0], [5.0, 0.0, 0.0]])])

    # The nearest corner of the robot is at (20.5, 1.75), 1.25 / sqrt(2) from the middle line.
    assert result.robot == "r0, slanted"
    assert result.margin == pytest.approx(1.25 / math.sqrt(2.0) - 0.1)


def test_walls_can_be_left_out() -> None:
    far_away = [[0.0, 9.9, 0.0], [500.0, 0.0, 0.0]]

    result = judge(check_of("no_collision", walls=False), [state(0.0, far_away)])

    assert result.margin > 400.0


def rate_result(times: Sequence[float], check: Check, end: float) -> CheckResult:
    count = MessageCount()
    assert isinstance(check, RateCheck)
    monitor = CheckMonitor(check, make_rate_margin(check, count), [""])
    left = list(times)
    for step in range(round(end * 10) + 1):
        now = step / 10
        while left and left[0] <= now + 1e-9:
            count.note(left.pop(0))
        monitor.update(state(now))
    return monitor.report()


def test_rate_is_counted_over_its_window() -> None:
    steady = [number / 10 for number in range(50)]
    check = check_of("rate", topic="r0/scan", above=9.0, window=1.0)

    assert rate_result(steady, check, 4.0).margin == pytest.approx(1.0)
    with_gap = [time for time in steady if not 2.0 <= time < 3.0]
    assert rate_result(with_gap, check, 4.0).margin == pytest.approx(-9.0)
    assert rate_result(steady, check, 0.5).verdict == "not_evaluated"


def test_rate_may_be_too_high() -> None:
    check = check_of("rate", topic="r0/scan", below=5.0)

    assert rate_result([number / 10 for number in range(30)], check, 2.0).verdict == "failed"
