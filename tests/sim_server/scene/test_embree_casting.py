"""Rays cast by Embree hit what the exact caster and the planar one say."""

import math

import numpy as np
import pytest

from tests.sim_server.scene.test_planar_casting import (
    CIRCLE,
    JOINTS,
    SOLIDS,
    Trial,
    a_crowd,
    a_mixture,
    a_model,
    a_pose,
    a_warehouse,
    random_sensors,
)
from zensim.proto.messages.model_messages import Shape
from zensim.proto.se3 import FloatArray, rotate
from zensim.sim_server.scene.embree_casting import MAX_PASSES, EmbreeCaster
from zensim.sim_server.scene.ray_casting import GROUND, NO_ENTITY, RayHits, Rays, cast_rays_exactly


def cast(trial: Trial, rays: Rays) -> RayHits:
    return EmbreeCaster(trial.layout.is_fixed)(trial.layout.place(trial.base, JOINTS), rays)


def random_rays(rng: np.random.Generator, count: int, entities: int) -> Rays:
    origins = rng.uniform((-8.0, -8.0, 0.05), (8.0, 8.0, 2.0), (count, 3))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return Rays(origins, directions, 10.0, rng.integers(NO_ENTITY, entities, count))


def count_differences(found: RayHits, expected: RayHits, limit_m: float) -> int:
    """Count rays whose ranges differ by more than a limit, or of which one hits nothing."""
    both = np.isfinite(found.ranges) & np.isfinite(expected.ranges)
    away = np.abs(np.where(both, found.ranges, 0.0) - np.where(both, expected.ranges, 0.0))
    is_other = np.isfinite(found.ranges) != np.isfinite(expected.ranges)
    return int((is_other | (away > limit_m)).sum())


@pytest.mark.parametrize("world", [a_warehouse, a_crowd, a_mixture])
def test_rays_of_any_direction_hit_what_the_exact_caster_says(world: object) -> None:
    rng = np.random.default_rng(5)
    trial = Trial(world(rng))  # type: ignore[operator]
    rays = random_rays(rng, 5000, len(trial.base))

    found = cast(trial, rays)

    expected = cast_rays_exactly(trial.layout.place(trial.base, JOINTS), rays)
    assert count_differences(found, expected, 1e-6) == 0
    # Boxes on the ground share their lower face with it.
    is_ground = (found.entities == GROUND) | (expected.entities == GROUND)
    assert np.array_equal(found.entities[~is_ground], expected.entities[~is_ground])


def test_moving_shapes_of_all_kinds_are_hit_exactly_from_outside_and_inside() -> None:
    rng = np.random.default_rng(7)
    places, turns = rng.uniform(-3.0, 3.0, (40, 3)), rng.uniform(-3.0, 3.0, (40, 3))
    placed = [
        (a_model(SOLIDS[i % len(SOLIDS)], is_static=False), a_pose(*places[i], *turns[i]))
        for i in range(40)
    ]
    trial = Trial(placed)
    rays = random_rays(rng, 4000, len(placed))
    rays.origins[::2] = places[rng.integers(0, 40, 2000)] + rng.uniform(-0.6, 0.6, (2000, 3))

    found = cast(trial, rays)

    expected = cast_rays_exactly(trial.layout.place(trial.base, JOINTS), rays)
    assert count_differences(found, expected, 1e-6) == 0
    assert np.array_equal(found.entities, expected.entities)


def test_faces_in_one_plane_hide_no_shape() -> None:
    rim, tyre = Shape("cylinder", (0.3, 0.4, 0.0)), Shape("cylinder", (0.5, 0.4, 0.0))
    wall = a_model(Shape("box", (9.0, 9.0, 0.1)))
    beside_rim = (0.29, 0.29, 2.0)

    found = [
        cast(
            Trial(
                [(a_model(*shapes, is_static=False), a_pose(0.0, 0.0)), (wall, a_pose(0.0, 0.0))]
            ),
            look(beside_rim, (0.0, 0.0, -1.0)),
        )
        for shapes in ((rim, tyre), (tyre, rim))
    ]

    assert [hits.ranges[0] for hits in found] == pytest.approx([1.8, 1.8], abs=1e-12)


def test_level_scans_differ_from_those_of_the_planar_caster_by_less_than_a_tenth_of_a_mm() -> None:
    rng = np.random.default_rng(6)
    trial = Trial([*a_mixture(rng), *a_warehouse(rng)])
    sensors = random_sensors(rng, 100, 8.0)
    level = np.stack([np.cos(CIRCLE.angles), np.sin(CIRCLE.angles), np.zeros(360)], axis=1)
    directions = rotate(sensors[:, None, 3:], level).reshape(-1, 3)
    origins = np.repeat(sensors[:, :3], 360, axis=0)
    rays = Rays(origins, directions, CIRCLE.range_max_m, np.full(36000, NO_ENTITY))

    found = cast(trial, rays)

    planar = trial.cast(CIRCLE, sensors)
    expected = RayHits(planar.ranges.reshape(-1), planar.entities.reshape(-1))
    assert count_differences(found, expected, 1e-4) <= 3


def look(origin: tuple[float, ...], *directions: tuple[float, ...], ignored: int = -1) -> Rays:
    towards: FloatArray = np.array(directions)
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    count = len(directions)
    return Rays(np.repeat([origin], count, axis=0), towards, 100.0, np.full(count, ignored))


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: solid.kind)
def test_ray_passes_through_its_own_robot(solid: Shape) -> None:
    trial = Trial([(a_model(solid, is_static=False), a_pose(0.0, 0.0, 2.0))])

    hits = cast(trial, look((0.01, 0.02, 2.1), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), ignored=0))

    assert hits.ranges.tolist() == [pytest.approx(2.1, abs=1e-12), np.inf]
    assert hits.entities.tolist() == [GROUND, NO_ENTITY]


def test_ray_that_misses_a_ball_within_its_prism_hits_what_is_behind_it() -> None:
    ball, wall = a_model(SOLIDS[1]), a_model(Shape("box", (1.0, 9.0, 9.0)))
    trial = Trial([(ball, a_pose(3.0, 0.0)), (wall, a_pose(6.0, 0.0))], ground=False)

    hits = cast(trial, look((0.0, 0.69, 0.69), (1.0, 0.0, 0.0)))

    assert (hits.ranges[0], hits.entities[0]) == (pytest.approx(5.5, abs=1e-12), 1)


def test_ray_through_more_surfaces_than_the_limit_is_still_exact() -> None:
    shells = [Shape("sphere", (0.7 + 0.01 * i, 0.0, 0.0)) for i in range(MAX_PASSES)]
    own = a_model(*shells, is_static=False)
    trial = Trial([(own, a_pose(0.0, 0.0)), (a_model(SOLIDS[0]), a_pose(5.0, 0.0))])

    hits = cast(trial, look((-3.0, 0.0, 0.1), (1.0, 0.0, 0.0), ignored=0))

    assert (hits.ranges[0], hits.entities[0]) == (pytest.approx(7.8, abs=1e-12), 1)


def test_fixed_entity_is_hit_where_a_request_puts_it() -> None:
    trial = Trial([(a_model(SOLIDS[0]), a_pose(3.0, 0.0))])
    caster, found = EmbreeCaster(trial.layout.is_fixed), []
    for x in (3.0, 5.0):
        trial.base = np.array([a_pose(x, 0.0)])
        shapes = trial.layout.place(trial.base, JOINTS)
        found.append(caster(shapes, look((0.0, 0.0, 0.1), (1.0, 0.0, 0.0))).ranges[0])

    assert found == pytest.approx([2.8, 4.8], abs=1e-12)


def test_no_rays_and_no_shapes_give_no_hits() -> None:
    nothing = Trial([], ground=False)

    assert len(cast(nothing, random_rays(np.random.default_rng(0), 0, 1)).ranges) == 0
    assert cast(nothing, look((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))).entities.tolist() == [NO_ENTITY]


def test_slope_of_the_ground_is_hit_at_its_distance() -> None:
    angle = math.radians(16.0)
    down = (math.cos(angle), 0.0, -math.sin(angle))

    hits = cast(Trial([]), look((0.0, 0.0, 0.5), down))

    assert hits.ranges[0] == pytest.approx(0.5 / math.sin(angle), abs=1e-12)
