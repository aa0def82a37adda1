"""Wheel speeds worked out by hand, by the rules of Gazebo's plug-in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.drives.differential_drive import limit_velocity
from zensim.proto.messages.drive_messages import DiffDrive, Limits, WheelPair

AT_REST, DT_S = 0.0, 0.1


def test_velocity_is_unchanged_when_unlimited() -> None:
    assert limit_velocity(Limits(), 1e9, AT_REST, DT_S, FLOAT_MATH) == 1e9


@pytest.mark.parametrize(("wanted", "found"), [(0.3, 0.3), (9.0, 1.0), (-9.0, -0.5)])
def test_velocity_stays_within_its_limits(wanted: float, found: float) -> None:
    limits = Limits(min_velocity=-0.5, max_velocity=1.0)

    assert limit_velocity(limits, wanted, AT_REST, DT_S, FLOAT_MATH) == found


@pytest.mark.parametrize(("now", "wanted", "found"), [(0.2, 1.0, 0.4), (0.4, -1.0, 0.0)])
def test_velocity_changes_within_the_acceleration_limits(
    now: float, wanted: float, found: float
) -> None:
    limits = Limits(min_acceleration=-4.0, max_acceleration=2.0)

    assert limit_velocity(limits, wanted, now, DT_S, FLOAT_MATH) == pytest.approx(found)


@given(st.lists(st.floats(-5.0, 5.0), max_size=20))
def test_velocity_never_leaves_its_limits(commands: list[float]) -> None:
    limits = Limits(-1.0, 2.0, -3.0, 3.0)
    before = 0.0
    for wanted in commands:
        now = limit_velocity(limits, wanted, before, DT_S, FLOAT_MATH)
        assert -1.0 <= now <= 2.0
        assert abs(now - before) <= 0.3 + 1e-12
        before = now


PAIR = WheelPair("left", "right", separation_m=0.4, diameter_m=0.2)
REAR = WheelPair("left2", "right2", separation_m=0.6, diameter_m=0.1)
RADIUS = 0.1
STILL = (0.0, 0.0)


def limited(max_acceleration: float = 1.0) -> SingleDrive:
    return SingleDrive(DiffDrive(pairs=(PAIR,), max_acceleration=max_acceleration))


def rims(targets: tuple[float, ...]) -> list[float]:
    return [target * RADIUS for target in targets]


@pytest.mark.parametrize(
    ("speed", "turn", "left", "right"),
    [
        (0.0, 0.0, 0.0, 0.0),
        (0.5, 0.0, 5.0, 5.0),
        (-0.5, 0.0, -5.0, -5.0),
        (0.0, 1.0, -2.0, 2.0),
        (0.0, -1.0, 2.0, -2.0),
        (0.5, 1.0, 3.0, 7.0),
        (0.2, 1.0, 0.0, 4.0),
        (1000.0, 0.0, 10_000.0, 10_000.0),
    ],
)
def test_drive_finds_wheel_speeds(speed: float, turn: float, left: float, right: float) -> None:
    drive = SingleDrive(DiffDrive(pairs=(PAIR,)))

    targets = drive.update(speed, turn, velocities=STILL, dt_s=0.01)

    assert targets == pytest.approx((left, right))


def test_drive_uses_forward_speed_and_turn_only() -> None:
    drive = SingleDrive(DiffDrive(pairs=(PAIR,)))

    targets = drive.update(vy=1.0, velocities=STILL, dt_s=0.01)

    assert targets == (0.0, 0.0)


def test_drive_gives_each_pair_its_own_separation_and_diameter() -> None:
    drive = SingleDrive(DiffDrive(pairs=(PAIR, REAR)))

    targets = drive.update(0.5, 1.0, velocities=(0.0,) * 4, dt_s=0.01)

    assert targets == pytest.approx((3.0, 7.0, 4.0, 16.0))


def test_drive_has_no_targets_when_it_has_no_wheels() -> None:
    drive = SingleDrive(DiffDrive())

    assert drive.update(1.0, velocities=(), dt_s=0.01) == ()


def test_drive_limits_acceleration_at_the_rim() -> None:
    drive = limited(1.0)

    first = drive.update(0.5, velocities=STILL, dt_s=0.01)
    second = drive.update(0.5, velocities=(0.1, 0.1), dt_s=0.02)

    assert rims(first) == pytest.approx([0.01, 0.01])
    assert rims(second) == pytest.approx([0.03, 0.03])


def test_drive_limits_deceleration_at_the_rim() -> None:
    drive = limited(1.0)

    targets = drive.update(0.0, velocities=(5.0, -5.0), dt_s=0.01)

    assert rims(targets) == pytest.approx([-0.01, 0.01])


def test_drive_adds_at_most_the_missing_speed() -> None:
    drive = limited(10.0)

    targets = drive.update(0.5, velocities=(4.8, 4.8), dt_s=0.1)

    assert rims(targets) == pytest.approx([0.02, 0.02])


@pytest.mark.parametrize(
    ("measured", "expected"), [(0.4901, 0.5), (0.5099, 0.5), (0.4899, 0.01), (0.5101, -0.01)]
)
def test_drive_commands_the_speed_itself_when_both_rims_are_within_a_centimetre_a_second(
    measured: float, expected: float
) -> None:
    drive = limited(1.0)
    speed = measured / RADIUS

    targets = drive.update(0.5, velocities=(speed, speed), dt_s=0.01)

    assert rims(targets) == pytest.approx([expected, expected])


def test_drive_limits_both_wheels_when_one_is_not_there_yet() -> None:
    drive = limited(1.0)

    targets = drive.update(0.5, velocities=(5.0, 0.0), dt_s=0.01)

    assert rims(targets) == pytest.approx([0.0, 0.01])


def test_drive_limits_pairs_one_by_one() -> None:
    drive = SingleDrive(DiffDrive(pairs=(PAIR, REAR), max_acceleration=1.0))

    targets = drive.update(0.5, velocities=(5.0, 5.0, 0.0, 0.0), dt_s=0.01)

    assert targets == pytest.approx((5.0, 5.0, 0.2, 0.2))


def test_drive_keeps_its_command_while_the_speed_is_reached() -> None:
    drive = limited(1.0)
    for _ in range(3):
        drive.update(0.5, velocities=STILL, dt_s=0.01)
    drive.update(0.5, velocities=(5.0, 5.0), dt_s=0.01)

    targets = drive.update(0.0, velocities=(5.0, 5.0), dt_s=0.01)

    assert rims(targets) == pytest.approx([0.02, 0.02])


def test_drive_forgets_its_command_at_a_reset() -> None:
    drive = limited(1.0)
    drive.update(0.5, velocities=STILL, dt_s=0.3)

    drive.reset()

    assert rims(drive.update(0.5, velocities=STILL, dt_s=0.01)) == pytest.approx([0.01, 0.01])


def test_drive_limits_the_twist() -> None:
    drive = SingleDrive(
        DiffDrive(
            pairs=(PAIR,),
            linear_limits=Limits(max_velocity=0.3),
            angular_limits=Limits(max_acceleration=1.0),
        )
    )

    first = drive.update(9.0, 1.0, velocities=STILL, dt_s=0.5)
    drive.reset()
    again = drive.update(9.0, 1.0, velocities=STILL, dt_s=0.5)

    assert first == again == pytest.approx((2.0, 4.0))


@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_drive_does_not_wind_up_when_its_wheels_are_held(speed: float) -> None:
    drive = limited(1.0)
    for _ in range(1000):
        targets = drive.update(speed, velocities=STILL, dt_s=0.1)

    assert rims(targets) == pytest.approx([math.copysign(0.6, speed)] * 2)


def test_drive_keeps_targets_finite_when_the_twist_overflows() -> None:
    drive = limited(1.0)

    far = drive.update(1e308, 1e308, velocities=STILL, dt_s=0.01)
    direct = SingleDrive(DiffDrive(pairs=(REAR,)))

    assert all(map(math.isfinite, far))
    assert all(map(math.isfinite, direct.update(-1.7e308, 1.7e308, velocities=STILL, dt_s=0.01)))


@given(
    speed=st.floats(-10.0, 10.0),
    turn=st.floats(-10.0, 10.0),
    separation=st.floats(0.01, 10.0),
    diameter=st.floats(0.01, 10.0),
)
def test_drive_speeds_give_the_twist_back(
    speed: float, turn: float, separation: float, diameter: float
) -> None:
    pair = WheelPair("left", "right", separation, diameter)
    drive = SingleDrive(DiffDrive(pairs=(pair,)))

    left, right = drive.update(speed, turn, velocities=STILL, dt_s=0.01)

    rim_left, rim_right = left * diameter / 2.0, right * diameter / 2.0
    assert (rim_left + rim_right) / 2.0 == pytest.approx(speed, abs=1e-9)
    assert (rim_right - rim_left) / separation == pytest.approx(turn, abs=1e-9)


@given(
    commands=st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-4.0, 4.0)), max_size=30),
    acceleration=st.floats(0.1, 10.0),
)
def test_drive_never_exceeds_its_acceleration(
    commands: list[tuple[float, float]], acceleration: float
) -> None:
    drive, elapsed_s = limited(acceleration), 0.01
    wheels: tuple[float, ...] = STILL
    for speed, turn in commands:
        targets = drive.update(speed, turn, velocities=wheels, dt_s=elapsed_s)
        change = max(abs(b - a) for a, b in zip(rims(wheels), rims(targets), strict=True))
        # Within the tolerance the speed itself is commanded.
        assert change <= max(acceleration * elapsed_s, 0.01) + 0.011
        wheels = targets
