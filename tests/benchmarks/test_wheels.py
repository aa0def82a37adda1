"""Short form of `python -m benchmarks wheels`: fails when an engine gets worse."""

import pytest

from benchmarks.bench_wheels import WITHIN, measure_robot
from tests.sim_server.description.wheel_models import (
    Chassis,
    Surface,
    WheelRobot,
    diff_tags,
    list_robots,
)

ROBOTS = {robot.name: robot for robot in list_robots()}
OF_EACH_DRIVE = (
    *("mass_ratio_1", "com_behind"),
    *(f"radius_{size}_m" for size in ("0.01", "0.03", "0.1", "0.3")),
    *(f"mass_{mass}_kg" for mass in ("0.1", "1", "20", "100", "500")),
    *("light_wheels_20_g", "mu_10", "mu_100", "diameter_10_percent_off", "track_10_off"),
    *("skid_square", "skid_500_kg", "skid_small", "skid_six_wheels", "skid_eight_wheels"),
    *("skid_fdir1_ahead", "car_model", "car_20_kg", "car_500_kg", "car_light_wheels"),
    *("tricycle_small", "tricycle_20_kg", "tricycle_200_kg", "mover_box"),
    *("car_by_turn_rate", "tricycle_by_turn_rate", "mecanum", "omni_wheels"),
)
"""One robot of each drive and command: a kinematic robot has no masses, contacts and friction."""
MOST_CREEP_MM_S = 1.0
MOST_TILT_OFF_RAD = 0.005
MOST_KINEMATIC_OFF = 0.01
"""Percent."""
BOTH = (
    "mass_ratio_1000",
    "radius_0.01_m",
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
    "skid_500_kg",
    "mu_100",
)
BETWEEN_OTHERS = (
    *("mass_ratio_10", "mass_ratio_100", "radius_0.03_m", "radius_0.1_m", "mass_1_kg"),
    *("mass_20_kg", "mass_100_kg", "com_behind", "com_ahead", "ball_mu_0.5"),
    *("ball_under_most_of_the_load_mu_0.7", "capsule_foot", "swivels_all_around", "skid_short"),
    *("skid_heavy_wheels", "skid_com_behind", "skid_six_wheels", "skid_fdir1_alike", "mu_10"),
    *("diameter_10_percent_off", "car_500_kg", "tricycle_20_kg", "mover_heavy"),
)
"""Those that differ from two others in one figure only: `make bench` drives them."""
PYBULLET = tuple(name for name in ROBOTS if name not in BETWEEN_OTHERS)
MUJOCO = (
    *BOTH,
    "swivels_all_around",
    "skid_square",
    "skid_com_left",
    "skid_eight_wheels",
    "skid_fdir1_ahead",
    "skid_fdir1_axle",
)
CASES = [("pybullet", name) for name in PYBULLET] + [("mujoco", name) for name in MUJOCO]


def test_robots_of_the_benchmark_have_different_names() -> None:
    assert len(ROBOTS) == len(list_robots()) >= 60


def test_robots_that_are_left_to_the_benchmark_are_some_of_its_own() -> None:
    assert set(BETWEEN_OTHERS) < set(ROBOTS)


def test_one_robot_of_each_drive_and_command_is_kinematic() -> None:
    every = {name: repr((robot.model().drive, robot.turn)) for name, robot in ROBOTS.items()}

    assert {every[name] for name in OF_EACH_DRIVE} == set(every.values())


@pytest.mark.short_form
@pytest.mark.parametrize(("engine", "name"), CASES)
def test_robot_drives_as_friction_allows(engine: str, name: str) -> None:
    (row,) = measure_robot(ROBOTS[name], [engine])

    assert row.off_percent <= WITHIN[0], row
    assert row.creep_mm_s <= MOST_CREEP_MM_S
    assert abs(row.tilt_rad - row.predicted_tilt_rad) <= MOST_TILT_OFF_RAD


@pytest.mark.parametrize("name", OF_EACH_DRIVE)
def test_kinematic_robot_drives_as_friction_allows(name: str) -> None:
    (row,) = measure_robot(ROBOTS[name], ["kinematic"])

    assert row.off_percent < MOST_KINEMATIC_OFF, row


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_rough_wheels_keep_their_load_while_others_slide(engine: str) -> None:
    chassis = Chassis(10.0, 0.1, 0.4)
    urdf = chassis.start("rough_middle")
    for number, (x, friction) in enumerate(((0.22, 1.0), (0.0, 100.0), (-0.22, 1.0))):
        for side, y in (("left", 0.2), ("right", -0.2)):
            chassis.wheel(urdf, f"{side}{number}", (x, y), surface=Surface(friction))
    urdf.plugin("libgazebo_ros_skid_steer_drive.so", diff_tags(chassis, 3, torque=4.0))

    (row,) = measure_robot(WheelRobot("rough_middle", urdf.text()), [engine])

    assert row.off_percent <= WITHIN[0], row
