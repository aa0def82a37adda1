"""Level lidars see what closed forms and the exact caster say, alone and in any batch."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.messages.sensor_messages import ScanAxis
from zensim.proto.se3 import FloatArray, from_rpy, rotate
from zensim.sim_server.scene import planar_casting
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.planar_casting import (
    LevelScan,
    PlanarCaster,
    find_tilts,
    make_level_scan,
)
from zensim.sim_server.scene.ray_casting import NO_ENTITY, RayHits
from zensim.sim_server.scene.scene import CollisionScene, SceneLayout

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
TRIANGLES = CORNERS[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
SOLIDS = (
    Shape("box", (0.4, 0.8, 1.2)),
    Shape("sphere", (0.7, 0.0, 0.0)),
    Shape("cylinder", (0.5, 1.6, 0.0)),
    Shape("capsule", (0.4, 1.0, 0.0)),
    Shape("mesh", (1.0, 2.0, 1.5), mesh="tetrahedron"),
)
JOINTS = np.zeros(0)
CIRCLE = make_level_scan(ScanAxis(360, -math.pi, math.pi - math.tau / 360), 10.0)
SCANS = [
    make_level_scan(ScanAxis(count, low, high), 30.0)
    for count, low, high in [
        (360, 0.0, 6.28),
        (360, -math.pi, math.pi),
        (720, -math.pi, math.pi - math.tau / 720),
        (1081, -math.radians(135), math.radians(135)),
        (181, -math.pi / 2, math.pi / 2),
        (90, math.pi - 0.5, math.pi + 0.5),
        (37, -2.0 * math.pi, 2.0 * math.pi),
        (5, 0.7, 0.9),
        (2, -0.3, 0.3),
        (1, -0.4, 0.4),
    ]
]


def a_model(*shapes: Shape, is_static: bool = True) -> Model:
    return Model("m", (Link("base", collisions=shapes),), is_static=is_static)


def a_pose(x: float, y: float, z: float = 0.0, *rpy: float) -> list[float]:
    return [x, y, z, *from_rpy(*rpy)] if rpy else [x, y, z, 0.0, 0.0, 0.0, 1.0]


class Trial:
    """Entities that are seen by the planar caster and by the exact one."""

    def __init__(self, placed: Sequence[tuple[Model, list[float]]], *, ground: bool = True) -> None:
        models = [model for model, _ in placed]
        self.base = np.array([pose for _, pose in placed]).reshape(-1, 7)
        self.layout = SceneLayout(models, lambda _: TRIANGLES, has_ground=ground)
        self.caster = PlanarCaster()
        self.place()

    def place(self) -> None:
        state = self.base, JOINTS
        moving = self.layout.place_moving(*state, np.ones(len(self.base), np.bool_))
        self.caster.place(self.layout.place_fixed(*state), moving)

    def cast(
        self, scan: LevelScan, sensors: FloatArray, ignored: IntArray | None = None
    ) -> RayHits:
        entities = np.zeros((len(sensors), scan.count), np.intp)
        ranges = self.caster.cast(scan, sensors, ignore_none(sensors, ignored), entities)
        return RayHits(ranges, entities)

    def cast_exactly(
        self, scan: LevelScan, sensors: FloatArray, ignored: IntArray | None = None
    ) -> RayHits:
        level = np.stack([np.cos(scan.angles), np.sin(scan.angles), np.zeros(scan.count)], axis=1)
        directions = rotate(sensors[:, None, 3:], level)
        directions[:, :, 2] = 0.0
        directions /= np.linalg.norm(directions, axis=2, keepdims=True)
        origins = np.repeat(sensors[:, None, :3], scan.count, axis=1).reshape(-1, 3)
        hits = CollisionScene(self.layout, self.base, JOINTS).cast_rays(
            origins,
            directions.reshape(-1, 3),
            scan.range_max_m,
            np.repeat(ignore_none(sensors, ignored), scan.count),
        )
        shape = len(sensors), scan.count
        return RayHits(hits.ranges.reshape(shape), hits.entities.reshape(shape))


def ignore_none(sensors: FloatArray, ignored: IntArray | None) -> IntArray:
    return np.full(len(sensors), NO_ENTITY) if ignored is None else ignored


def assert_same_hits(found: RayHits, expected: RayHits) -> None:
    is_hit = np.isfinite(expected.ranges)
    assert np.array_equal(np.isfinite(found.ranges), is_hit)
    assert np.abs(found.ranges[is_hit] - expected.ranges[is_hit]).max(initial=0.0) <= 1e-6
    assert np.array_equal(found.entities, expected.entities)


def random_sensors(rng: np.random.Generator, count: int, half_m: float) -> FloatArray:
    places = rng.uniform(-half_m, half_m, (count, 2))
    return np.array([a_pose(x, y, rng.uniform(0.05, 0.45), 0.0, 0.0, 6.0 * x) for x, y in places])


def test_ranges_in_a_room_are_the_least_of_four_quotients() -> None:
    walls = [
        (3.5, 0.0, 1.0, 6.0),
        (-3.5, 0.0, 1.0, 6.0),
        (0.0, 2.5, 8.0, 1.0),
        (0.0, -2.5, 8.0, 1.0),
    ]
    room = Trial([(a_model(Shape("box", (w, h, 1.0))), a_pose(x, y)) for x, y, w, h in walls])
    rng = np.random.default_rng(1)
    sensors = np.array(
        [
            a_pose(x, y, 0.2, 0.0, 0.0, yaw)
            for x, y, yaw in rng.uniform((-2.99, -1.99, -9.0), (2.99, 1.99, 9.0), (500, 3))
        ]
    )
    yaws = np.arctan2(2.0 * sensors[:, 6] * sensors[:, 5], 1.0 - 2.0 * sensors[:, 5] ** 2)
    angles = yaws[:, None] + CIRCLE.angles
    x, y, cos, sin = sensors[:, :1], sensors[:, 1:2], np.cos(angles), np.sin(angles)

    ranges = room.cast(CIRCLE, sensors).ranges

    expected = np.minimum((np.sign(cos) * 3.0 - x) / cos, (np.sign(sin) * 2.0 - y) / sin)
    assert np.isfinite(ranges).all()
    assert np.abs(ranges - expected).max() <= 1e-6


def test_lidar_in_a_ring_sees_the_faces_of_the_others_and_never_its_own_robot() -> None:
    radius, half = 2.0, 0.15
    robot = a_model(Shape("box", (2.0 * half, 2.0 * half, 0.3)), is_static=False)
    turns = np.arange(12) * math.tau / 12
    ring = [
        (robot, a_pose(radius * math.cos(t), radius * math.sin(t), 0.15, 0.0, 0.0, t))
        for t in turns
    ]
    trial = Trial([*ring, (robot, a_pose(0.0, 0.0, 0.15))])
    scan = make_level_scan(ScanAxis(1441, -math.pi, math.pi), 1.9)
    sensor = np.array([a_pose(0.0, 0.0, 0.2)])

    hits = trial.cast(scan, sensor, np.array([12]))

    aside = (scan.angles + math.tau / 24) % (math.tau / 12) - math.tau / 24
    expected = np.where(
        np.abs(np.tan(aside)) * (radius - half) <= half, (radius - half) / np.cos(aside), np.inf
    )
    is_hit = np.isfinite(expected)
    assert np.array_equal(np.isfinite(hits.ranges[0]), is_hit)
    assert np.abs(hits.ranges[0][is_hit] - expected[is_hit]).max() <= 1e-6
    assert set(hits.entities[0].tolist()) == {NO_ENTITY, *range(12)}


def an_empty_world(_: np.random.Generator) -> list[tuple[Model, list[float]]]:
    return []


def a_warehouse(rng: np.random.Generator) -> list[tuple[Model, list[float]]]:
    return [
        (a_model(Shape("box", (4.0, 1.0, 2.0))), a_pose(x, y, 1.0, 0.0, 0.0, rng.uniform(0, 0.2)))
        for x in (-8.0, -2.0, 4.0)
        for y in np.arange(-8.0, 9.0, 3.0).tolist()
    ]


def a_crowd(rng: np.random.Generator) -> list[tuple[Model, list[float]]]:
    """Boxes that lean as robots do: a little, much, and not at all."""
    box = a_model(Shape("box", (0.3, 0.24, 0.4)), is_static=False)
    leans = rng.choice([0.0, 1e-15, 1e-9, 0.01, 0.5, 2.0], (60, 2))
    return [(box, a_pose(*rng.uniform(-8, 8, 2), 0.2, *lean, rng.uniform(-3, 3))) for lean in leans]


def a_mixture(rng: np.random.Generator) -> list[tuple[Model, list[float]]]:
    """Shapes of all kinds, fixed and moving, upright and leaning."""
    return [
        (
            a_model(SOLIDS[number % 5], is_static=bool(number % 2)),
            a_pose(
                *rng.uniform(-8, 8, 2),
                rng.uniform(-0.3, 0.8),
                *rng.choice([0.0, 1e-3, 0.02, 1.0], 2),
                rng.uniform(-3, 3),
            ),
        )
        for number in range(40)
    ]


WORLDS = (an_empty_world, a_warehouse, a_crowd, a_mixture)


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("scan", SCANS, ids=lambda scan: f"{scan.count} rays")
def test_every_kind_of_scan_sees_what_the_exact_caster_sees(world: object, scan: LevelScan) -> None:
    rng = np.random.default_rng(scan.count)
    trial = Trial(world(rng))  # type: ignore[operator]
    sensors = random_sensors(rng, 12, 8.0)
    ignored = rng.integers(NO_ENTITY, max(len(trial.base), 1), len(sensors))

    found = trial.cast(scan, sensors, ignored)

    assert_same_hits(found, trial.cast_exactly(scan, sensors, ignored))


def test_ranges_have_the_same_bits_in_any_batch_order_and_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(3)
    trial = Trial([*a_mixture(rng), *a_warehouse(rng)])
    sensors, order = random_sensors(rng, 150, 8.0), rng.permutation(150)
    together = trial.cast(CIRCLE, sensors).ranges
    without_entities = trial.caster.cast(CIRCLE, sensors, ignore_none(sensors, None))

    shuffled = trial.cast(CIRCLE, sensors[order]).ranges
    alone = [trial.cast(CIRCLE, sensor[None]).ranges[0] for sensor in sensors]
    monkeypatch.setattr(planar_casting, "LIDARS_PER_BLOCK", 7)
    in_small_blocks = trial.cast(CIRCLE, sensors).ranges

    assert together.tobytes() == without_entities.tobytes()
    assert together[order].tobytes() == shuffled.tobytes()
    assert together.tobytes() == np.array(alone).tobytes() == in_small_blocks.tobytes()


def test_ranges_do_not_depend_on_which_cells_and_bands_are_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(4)
    trial = Trial([*a_mixture(rng), *a_warehouse(rng)])
    sensors = random_sensors(rng, 50, 8.0)
    expected = trial.cast(CIRCLE, sensors).ranges
    for limit in ("MAX_BANDS", "MAX_KEPT"):
        monkeypatch.setattr(planar_casting, limit, 1)

    found = [trial.cast(CIRCLE, sensors).ranges for _ in range(2)]

    assert expected.tobytes() == found[0].tobytes() == found[1].tobytes()


def test_fixed_entity_is_seen_where_a_request_puts_it() -> None:
    trial = Trial([(a_model(Shape("box", (1.0, 1.0, 1.0))), a_pose(3.0, 0.0))])
    sensor, ahead = np.array([a_pose(0.0, 0.0, 0.1)]), make_level_scan(ScanAxis(1), 10.0)
    before = trial.cast(ahead, sensor).ranges[0, 0]

    trial.base = np.array([a_pose(5.0, 0.0)])
    trial.place()

    assert (before, trial.cast(ahead, sensor).ranges[0, 0]) == pytest.approx((2.5, 4.5))


def test_moving_entity_is_seen_where_each_tick_places_it() -> None:
    trial = Trial([(a_model(SOLIDS[0], is_static=False), a_pose(3.0, 0.0))])
    sensor, ahead = np.array([a_pose(0.0, 0.0, 0.1)]), make_level_scan(ScanAxis(1), 10.0)

    found = []
    for x in (3.0, 4.0, 5.0):
        trial.base = np.array([a_pose(x, 0.0)])
        trial.place()
        found.append(trial.cast(ahead, sensor).ranges[0, 0])

    assert found == pytest.approx([2.8, 3.8, 4.8])


def test_inverted_lidar_scans_clockwise() -> None:
    trial = Trial([(a_model(Shape("box", (1.0, 1.0, 1.0))), a_pose(0.0, 3.0))])
    sensor = np.array([a_pose(0.0, 0.0, 0.1, math.pi, 0.0, 0.0)])
    scan = make_level_scan(ScanAxis(7, -2.0, 1.0), 10.0)

    hits = trial.cast(scan, sensor)

    assert_same_hits(hits, trial.cast_exactly(scan, sensor))
    assert np.flatnonzero(np.isfinite(hits.ranges[0])).tolist() == [1]


def test_lidar_inside_a_solid_sees_it_from_inside() -> None:
    trial = Trial(
        [
            (a_model(solid, is_static=bool(i % 2)), a_pose(0.0, 0.0, 0.1, 0.1, 0.0, 1.0))
            for i, solid in enumerate(SOLIDS)
        ]
    )
    sensor = np.array([a_pose(0.02, 0.01, 0.2)])

    hits = trial.cast(CIRCLE, sensor)

    assert np.isfinite(hits.ranges).all()
    assert_same_hits(hits, trial.cast_exactly(CIRCLE, sensor))


def test_rays_begin_where_the_scan_says() -> None:
    nearby = [(a_model(solid), a_pose(0.1, 0.05, 0.1, 0.0, 0.0, 0.4)) for solid in SOLIDS]
    trial = Trial([*nearby, (a_model(Shape("box", (1.0, 9.0, 1.0))), a_pose(4.0, 0.0))])
    scan = LevelScan(91, -0.5, 1.0 / 90.0, 10.0, start_m=0.6)
    sensor = np.array([a_pose(0.0, 0.0, 0.2)])
    shifted = np.array(
        [
            a_pose(0.6 * math.cos(t), 0.6 * math.sin(t), 0.2, 0.0, 0.0, t)
            for t in scan.angles.tolist()
        ]
    )

    found = trial.cast(scan, sensor).ranges[0]

    expected = trial.cast_exactly(make_level_scan(ScanAxis(1), 9.4), shifted).ranges[:, 0] + 0.6
    assert found == pytest.approx(expected, abs=1e-9)


def test_level_ground_is_not_seen_and_a_slope_is() -> None:
    slope = a_model(Shape("plane"))
    sensors = np.array([a_pose(0.0, 0.0, 0.3), a_pose(0.0, 0.0, 0.3, 0.0, 0.0, math.pi)])
    ahead = make_level_scan(ScanAxis(1), 50.0)

    level = Trial([]).cast(ahead, sensors)
    inclined = Trial([(slope, a_pose(0.0, 0.0, 0.0, 0.0, -0.1, 0.0))]).cast(ahead, sensors)

    assert level.entities.tolist() == [[NO_ENTITY], [NO_ENTITY]]
    assert inclined.entities.tolist() == [[0], [NO_ENTITY]]
    assert inclined.ranges[0, 0] == pytest.approx(0.3 / math.tan(0.1))


def test_nothing_is_seen_beyond_the_range() -> None:
    trial = Trial([(a_model(Shape("box", (1.0, 1.0, 1.0))), a_pose(3.0, 0.0))])
    sensor = np.array([a_pose(0.0, 0.0, 0.1)])

    found = [trial.cast(make_level_scan(ScanAxis(1), limit), sensor) for limit in (2.499, 2.501)]

    assert [(hit.ranges[0, 0], hit.entities[0, 0]) for hit in found] == [
        (np.inf, NO_ENTITY),
        (pytest.approx(2.5), 0),
    ]


def test_no_lidars_have_no_ranges() -> None:
    trial = Trial([(a_model(SOLIDS[0]), a_pose(3.0, 0.0))])

    assert trial.cast(CIRCLE, np.zeros((0, 7))).ranges.shape == (0, 360)


@pytest.mark.parametrize(
    ("rpy", "tilt_deg"),
    [((0.0, 0.0, 2.0), 0.0), ((0.0, 0.02, 1.0), 0.02 * 180 / math.pi), ((math.pi, 0.0, 0.5), 0.0)],
)
def test_tilt_is_the_angle_from_the_level(rpy: tuple[float, ...], tilt_deg: float) -> None:
    poses = np.array([a_pose(0.0, 0.0, 0.0, *rpy)])

    assert math.degrees(find_tilts(poses)[0]) == pytest.approx(tilt_deg, abs=1e-5)
