"""Short form of `python -m benchmarks wheels`: fails when an engine gets worse."""

import pytest

from benchmarks.bench_wheels import WITHIN, measure_robot
from benchmarks.wheel_models import list_robots

ROBOTS = {robot.name: robot for robot in list_robots()}
MOST_CREEP_MM_S = 1.0
MOST_TILT_OFF_RAD = 0.005
MOST_KINEMATIC_OFF = 0.01
"""Percent."""
BOTH = (
    "mass_ratio_1",
    "mass_ratio_1000",
    "radius_0.01_m",
    "radius_0.3_m",
    "mass_0.1_kg",
    "mass_500_kg",
    "com_high",
    "feather_caster_1_g",
    "swivel_behind",
    "track_10_off",
    "car_20_kg",
    "tricycle_20_kg",
    "mover_on_wheels",
    "ball_mu_0.5",
    "cylinder_foot",
    "sprung_wheels",
    "skid_light_wheels",
    "skid_500_kg",
    "mu_100",
)
PYBULLET = tuple(ROBOTS)
MUJOCO = (
    *BOTH,
    "swivels_all_around",
    "skid_square",
    "skid_long",
    "skid_com_left",
    "skid_eight_wheels",
    "skid_fdir1_ahead",
    "skid_fdir1_axle",
)
CASES = [("pybullet", name) for name in PYBULLET] + [("mujoco", name) for name in MUJOCO]


def test_robots_of_the_benchmark_have_different_names() -> None:
    assert len(ROBOTS) == len(list_robots()) >= 60


@pytest.mark.short_form
@pytest.mark.parametrize(("engine", "name"), CASES)
def test_robot_drives_as_friction_allows(engine: str, name: str) -> None:
    (row,) = measure_robot(ROBOTS[name], [engine])

    assert row.off_percent <= WITHIN[0], row
    assert row.creep_mm_s <= MOST_CREEP_MM_S
    assert abs(row.tilt_rad - row.predicted_tilt_rad) <= MOST_TILT_OFF_RAD


@pytest.mark.parametrize("name", ROBOTS)
def test_kinematic_robot_drives_as_friction_allows(name: str) -> None:
    (row,) = measure_robot(ROBOTS[name], ["kinematic"])

    assert row.off_percent < MOST_KINEMATIC_OFF, row
