"""Each lidar is cast by the caster that suits it, with the same ranges as ray by ray."""

import math

import numpy as np
import pytest

from tests.sim_server.scene.test_planar_casting import (
    JOINTS,
    SOLIDS,
    Trial,
    a_mixture,
    a_model,
    a_pose,
    a_warehouse,
    random_sensors,
)
from zensim.proto.messages.model_messages import Origin, Shape
from zensim.proto.messages.sensor_messages import RaySensor, ScanAxis
from zensim.sim_server.scene import fleet_casting
from zensim.sim_server.scene.fleet_casting import FleetCaster, are_level
from zensim.sim_server.scene.ray_casting import cast_rays_exactly
from zensim.sim_server.scene.scan_casting import cast_ray_by_ray
from zensim.sim_server.scene.scene import SceneLayout

FLAT = RaySensor(ScanAxis(90, -math.pi, math.pi), range_max_m=10.0)
DEEP = RaySensor(ScanAxis(90, -math.pi, math.pi), ScanAxis(8, -0.3, 0.2), range_max_m=10.0)
UPWARD = RaySensor(ScanAxis(90, -1.0, 1.0), ScanAxis(1, 0.2, 0.2), range_max_m=10.0)


@pytest.fixture
def trial() -> Trial:
    rng = np.random.default_rng(8)
    return Trial([*a_mixture(rng), *a_warehouse(rng)])


@pytest.mark.parametrize("settings", [FLAT, DEEP, UPWARD], ids=["flat", "deep", "upward"])
@pytest.mark.parametrize("library", ["embreex", "none"])
def test_fleet_is_cast_as_ray_by_ray(
    trial: Trial, settings: RaySensor, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if library == "none":
        monkeypatch.setattr(fleet_casting, "find_library_fault", lambda _: "not installed")
    sensors = random_sensors(np.random.default_rng(9), 10, 8.0)
    carriers = np.arange(10)
    caster = FleetCaster(trial.layout)
    caster.place(trial.base, JOINTS)

    found = caster.cast(settings, sensors, carriers)

    shapes = trial.layout.place(trial.base, JOINTS)
    expected = cast_ray_by_ray(cast_rays_exactly, shapes, settings, sensors, carriers)
    assert found.shape == expected.shape
    is_hit = np.isfinite(expected)
    assert np.array_equal(np.isfinite(found), is_hit)
    assert np.abs(found[is_hit] - expected[is_hit]).max() <= 1e-6


def test_lidars_of_some_of_a_large_fleet_see_what_is_near_them_at_each_step() -> None:
    rng = np.random.default_rng(10)
    count = 400
    robot = a_model(Shape("box", (0.4, 0.3, 0.9)), SOLIDS[1], is_static=False)
    places = rng.uniform(-60.0, 60.0, (count, 2))
    trial = Trial([(robot, a_pose(x, y, 0.0, 0.0, 0.0, x)) for x, y in places], ground=False)
    caster = FleetCaster(trial.layout)
    near = RaySensor(ScanAxis(90, -math.pi, math.pi), range_max_m=3.0)

    for _ in range(4):
        trial.base[:, :2] += rng.uniform(-4.0, 4.0, (count, 2))
        caster.place(trial.base, JOINTS)
        for settings, carriers in ((near, np.arange(5)), (FLAT, np.array([60, 200, 399]))):
            found = caster.cast(settings, trial.base[carriers], carriers)

            shapes = trial.layout.place(trial.base, JOINTS)
            sensors = trial.base[carriers]
            expected = cast_ray_by_ray(cast_rays_exactly, shapes, settings, sensors, carriers)
            is_hit = np.isfinite(expected)
            assert is_hit.any()
            assert np.array_equal(np.isfinite(found), is_hit)
            assert np.abs(found[is_hit] - expected[is_hit]).max() <= 1e-6


@pytest.mark.parametrize(
    ("settings", "pitch_deg", "expected"),
    [
        (FLAT, 0.0, True),
        (FLAT, 1.9, True),
        (FLAT, 2.1, False),
        (DEEP, 0.0, False),
        (UPWARD, 0.0, False),
    ],
)
def test_scan_of_one_row_is_level_up_to_two_degrees(
    settings: RaySensor, pitch_deg: float, expected: object
) -> None:
    poses = np.array([a_pose(0.0, 0.0, 0.1, 0.0, math.radians(pitch_deg), 0.5)])

    assert are_level(settings, poses).tolist() == [expected]


def test_entities_near_lidars_are_found_with_their_reach() -> None:
    long, plane = Shape("box", (40.0, 0.1, 0.1)), Shape("plane")
    short = a_model(SOLIDS[1], is_static=False)
    hall = a_model(Shape("box", (900.0, 900.0, 9.0)))
    models = [short, short, a_model(long, is_static=False), a_model(plane, is_static=False), short]
    layout = SceneLayout([*models, hall], lambda _: np.zeros((0, 3)))
    places = (5.0, 0.0), (500.0, 0.0), (25.0, 0.0), (900.0, 0.0), (0.0, 100.0), (0.0, 5000.0)
    base = np.array([a_pose(*place) for place in places])

    found = layout.find_near(base, np.zeros((1, 2)), 10.0)
    assert found.tolist() == [True, False, True, True, False, False]
    assert layout.find_near(base, np.zeros((0, 2)), 10.0).tolist() == [False] * 6
    assert layout.find_near(base, np.zeros((1, 2)), math.inf).tolist() == [True] * 6


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_finite_leave_nothing_out(value: float) -> None:
    layout = SceneLayout([a_model(SOLIDS[1], is_static=False)] * 2, lambda _: np.zeros((0, 3)))
    base = np.array([a_pose(value, 0.0), a_pose(500.0, 0.0)])
    points = np.array([[0.0, 0.0], [value, 1.0]])

    assert layout.find_near(base, points[:1], 10.0).tolist() == [True, False]
    assert layout.find_near(base, points, 10.0).tolist() == [True, True]


def test_lidar_that_leans_sees_the_ground_and_its_level_neighbour_does_not() -> None:
    caster = FleetCaster(Trial([]).layout)
    caster.place(np.zeros((0, 7)), JOINTS)
    sensors = np.array([a_pose(0.0, 0.0, 0.1, 0.0, pitch, 0.0) for pitch in (0.1, 0.01)])

    ahead = RaySensor(ScanAxis(1), range_max_m=20.0)
    ranges = caster.cast(ahead, sensors, np.array([0, 1]))

    assert ranges.tolist() == [[pytest.approx(0.1 / math.sin(0.1))], [np.inf]]


@pytest.mark.parametrize("pitch", [0.0, 0.05])
def test_lidar_that_sees_itself_begins_at_its_least_range(pitch: float) -> None:
    housing = a_model(
        SOLIDS[1], Shape("box", (0.1, 9.0, 9.0), Origin((2.0, 0.0, 0.0))), is_static=False
    )
    caster = FleetCaster(Trial([(housing, a_pose(0.0, 0.0))], ground=False).layout)
    caster.place(np.array([a_pose(0.0, 0.0, 0.0, 0.0, pitch, 0.0)]), JOINTS)
    settings = RaySensor(ScanAxis(1), range_min_m=1.0, range_max_m=5.0, sees_itself=True)
    sensor = np.array([a_pose(0.0, 0.0, 0.0, 0.0, pitch, 0.0)])

    ranges = caster.cast(settings, sensor, np.array([0]))

    assert ranges.tolist() == [[pytest.approx(1.95)]]
