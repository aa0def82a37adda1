"""Who drives which robot from the page, and when it is stopped."""

import itertools
from contextlib import suppress

import pytest

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    Limits,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.path_following import PathController
from zensim.spawner.page.drive_control import (
    HOLD_S,
    KEEP_S,
    PATH_HOLD_S,
    REPEAT_S,
    STOP,
    STOP_COMMANDS,
    DriveControl,
    RobotBusy,
    Velocity,
    find_scale,
)

AHEAD = Velocity(0.5)
ANN, BOB = 1, 2


def run(control: DriveControl, start_s: float, end_s: float) -> list[tuple[float, str, Velocity]]:
    """Take commands when they are due, until a time; return them with their times."""
    found, now_s = [], start_s
    while now_s <= end_s:
        found += [(now_s, robot, velocity) for robot, velocity in control.take_due(now_s)]
        now_s = max(now_s + 1e-3, control.find_next_s())
    return found


def test_a_held_key_is_repeated_and_its_end_stops_the_robot_within_the_hold() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)

    sent = run(control, 0.0, 10.0)

    assert sent[0] == (0.0, "r1", AHEAD)
    driven = [at for at, _, velocity in sent if velocity == AHEAD]
    assert max(b - a for a, b in itertools.pairwise(driven)) <= REPEAT_S + 1e-9
    stops = [at for at, _, velocity in sent if velocity == STOP]
    assert stops[0] == pytest.approx(HOLD_S, abs=2e-3)
    assert len(stops) == STOP_COMMANDS


def test_a_release_stops_the_robot_at_once_and_more_than_once() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.take_due(0.0)

    control.drive(ANN, "r1", STOP, 0.01)

    assert [velocity for _, _, velocity in run(control, 0.01, 1.0)] == [STOP] * STOP_COMMANDS


def test_stops_are_not_prolonged_by_further_releases() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.drive(ANN, "r1", STOP, 0.01)
    control.drive(ANN, "r1", STOP, 0.02)

    assert len(run(control, 0.02, 1.0)) == STOP_COMMANDS


def test_a_change_of_direction_is_sent_at_once() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.take_due(0.0)

    control.drive(ANN, "r1", Velocity(turn=1.0), 0.001)

    assert control.take_due(0.001) == [("r1", Velocity(turn=1.0))]


def test_a_second_visitor_is_refused_until_the_first_has_stopped_for_a_while() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)

    with pytest.raises(RobotBusy):
        control.drive(BOB, "r1", AHEAD, 0.1)
    run(control, 0.0, 1.0)
    assert control.find_driver("r1") == ANN
    run(control, HOLD_S + KEEP_S, HOLD_S + KEEP_S + 0.1)
    control.drive(BOB, "r1", STOP, 10.0)
    control.drive(BOB, "r1", AHEAD, 10.0)

    assert control.find_driver("r1") == BOB


def test_releases_of_a_visitor_that_does_not_drive_have_no_effect() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)

    control.drive(BOB, "r1", STOP, 0.0)
    control.drive(BOB, "r2", STOP, 0.0)

    assert control.take_due(0.0) == [("r1", AHEAD)]


def test_taking_over_stops_the_robot_and_names_who_drove() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)

    assert control.take_over(BOB, "r1", 0.1) == ANN
    assert control.take_due(0.1) == [("r1", STOP)]
    assert control.take_over(BOB, "r1", 0.1) is None
    with pytest.raises(RobotBusy):
        control.drive(ANN, "r1", AHEAD, 0.2)


def hold_beyond(control: DriveControl, end_s: float) -> None:
    """Repeat the input of a key that ANN holds, and that another visitor may refuse."""
    for number in range(2, round(end_s / REPEAT_S)):
        with suppress(RobotBusy):
            control.drive(ANN, "r1", AHEAD, number * REPEAT_S)
        control.take_due(number * REPEAT_S)


@pytest.mark.parametrize("is_over", [STOP, None], ids=["released", "left"])
def test_a_key_that_is_held_during_a_take_over_drives_after_it_is_pressed_anew(
    is_over: Velocity | None,
) -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.take_over(BOB, "r1", 0.1)

    hold_beyond(control, 2 * KEEP_S)
    assert control.find_driver("r1") is None
    if is_over is None:
        control.release(ANN, 2 * KEEP_S)
    else:
        control.drive(ANN, "r1", is_over, 2 * KEEP_S)
    control.drive(ANN, "r1", AHEAD, 2 * KEEP_S)

    assert control.find_driver("r1") == ANN


def test_a_key_that_was_held_in_vain_drives_after_it_is_pressed_anew() -> None:
    control = DriveControl()
    control.drive(BOB, "r1", AHEAD, 0.1)

    hold_beyond(control, 2 * KEEP_S)

    assert control.find_driver("r1") is None


def test_a_visitor_that_leaves_stops_and_frees_all_its_robots() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.follow(ANN, "r2", PathController([(1.0, 0.0)], 0.5), 0.0)
    control.drive(BOB, "r3", AHEAD, 0.0)

    control.leave(ANN, 0.1)

    assert dict(control.take_due(0.1)) == {"r1": STOP, "r2": STOP, "r3": AHEAD}
    assert control.list_paths(ANN) == frozenset()
    control.drive(BOB, "r1", AHEAD, 0.1)


def test_a_hidden_page_stops_only_what_is_driven_by_hand() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.follow(ANN, "r2", PathController([(1.0, 0.0)], 0.5), 0.0)

    control.release(ANN, 0.1)

    assert ("r1", STOP) in control.take_due(0.1)
    assert control.list_paths(ANN) == {"r2"}


def test_stop_all_stops_robots_of_everybody_and_those_that_no_visitor_drives() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)

    control.stop_all(["r1", "r2"], 0.1)

    assert dict(control.take_due(0.1)) == {"r1": STOP, "r2": STOP}
    control.drive(BOB, "r2", AHEAD, 0.2)
    assert control.find_driver("r2") == BOB


def test_a_robot_reaches_the_point_that_it_is_sent_to_and_is_stopped_there() -> None:
    control = DriveControl()
    control.follow(ANN, "r1", PathController([(1.0, 0.0)], 0.5), 0.0)
    x, now_s, sent = 0.0, 0.0, [("r1", STOP)]
    while control.list_paths(ANN) and now_s < 20.0:
        control.observe("r1", (x, 0.0, 0.0), now_s)
        sent = control.take_due(now_s) or sent
        x, now_s = x + sent[-1][1].forward * 0.05, now_s + 0.05

    assert x == pytest.approx(1.0, abs=0.06)
    assert run(control, now_s, now_s + 1.0)[-1][2] == STOP


def test_a_robot_on_a_path_stops_without_newer_poses() -> None:
    control = DriveControl()
    control.follow(ANN, "r1", PathController([(9.0, 0.0)], 0.5), 0.0)
    control.observe("r1", (0.0, 0.0, 0.0), 0.0)

    sent = run(control, 0.0, 2.0)

    assert sent[0][2] == Velocity(0.5)
    assert next(at for at, _, one in sent if one == STOP) == pytest.approx(PATH_HOLD_S, abs=2e-3)
    assert control.list_paths(ANN) == frozenset()


def test_a_driven_robot_that_is_sent_to_a_point_stops_first() -> None:
    control = DriveControl()
    control.drive(ANN, "r1", AHEAD, 0.0)
    control.take_due(0.0)

    control.follow(ANN, "r1", PathController([(9.0, 0.0)], 0.5), 0.1)

    assert control.take_due(0.1) == [("r1", STOP)]


def test_a_key_ends_the_path_of_a_robot() -> None:
    control = DriveControl()
    control.follow(ANN, "r1", PathController([(9.0, 0.0)], 0.5), 0.0)

    control.drive(ANN, "r1", AHEAD, 0.1)

    assert control.list_paths(ANN) == frozenset()


def test_poses_of_robots_without_a_path_have_no_effect() -> None:
    control = DriveControl()

    control.observe("r1", (0.0, 0.0, 0.0), 0.0)

    assert control.take_due(0.0) == []
    assert control.find_next_s() == float("inf")


LIMITED = Limits(max_velocity=0.2)


@pytest.mark.parametrize(
    ("drive", "forward", "can_move_sideways"),
    [
        (DiffDrive(), 0.5, False),
        (DiffDrive(linear_limits=LIMITED), 0.2, False),
        (OmniDrive(linear_limits=LIMITED), 0.2, True),
        (PlanarMove(), 0.5, True),
        (AckermannDrive(max_speed=0.3), 0.3, False),
        (SteeringDrive(), 1.0, False),
        (TricycleDrive(), 0.5, False),
    ],
)
def test_full_deflection_is_the_limit_of_the_drive(
    drive: Drive, forward: float, *, can_move_sideways: bool
) -> None:
    scale = find_scale(drive)

    assert scale.forward == forward
    assert bool(scale.left) == can_move_sideways
    assert scale.turn > 0.0
