"""Bounds, reach and overlaps of convex shapes agree with closed forms."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.models import an_arm
from zensim.proto.messages.model_messages import JointKind, Link, Model, Origin, Shape
from zensim.proto.se3 import FloatArray, from_rpy
from zensim.sim_server.description.model_geometry import NO_MESHES
from zensim.sim_server.scene.convex_shapes import (
    UNIT_CUBE,
    ConvexShape,
    are_overlapping,
    find_bounding_radius,
    find_extreme_points,
    list_collision_shapes,
)
from zensim.sim_server.scene.scene import place_collision_shapes

numbers = st.floats(-2.0, 2.0)
points = st.tuples(numbers, numbers, numbers)
sizes = st.floats(0.01, 1.5)


def solid_of(shape: Shape) -> ConvexShape:
    ((_, solid),) = list_collision_shapes(Model("m", (Link("l", collisions=(shape,)),)), NO_MESHES)
    return solid


def at(*place: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloatArray:
    return np.concatenate([place, from_rpy(*turn)])


def ball(centre: tuple[float, float, float], radius: float) -> ConvexShape:
    return ConvexShape(np.array([centre]), sphere_radius_m=radius)


@pytest.mark.parametrize(
    ("shape", "high"),
    [
        (Shape("box", (0.2, 0.4, 0.6)), (0.1, 0.2, 0.3)),
        (Shape("sphere", (0.5, 0.0, 0.0)), (0.5, 0.5, 0.5)),
        (Shape("cylinder", (0.5, 2.0, 0.0)), (0.5, 0.5, 1.0)),
        (Shape("capsule", (0.5, 2.0, 0.0)), (0.5, 0.5, 1.5)),
    ],
)
def test_bounds_are_those_of_the_shape(shape: Shape, high: tuple[float, float, float]) -> None:
    low_found, high_found = solid_of(shape).bounds_at(at(1.0, 0.0, 0.0)[None])

    assert high_found[0] == pytest.approx([1.0 + high[0], high[1], high[2]])
    assert low_found[0] == pytest.approx([1.0 - high[0], -high[1], -high[2]])


def test_bounds_of_a_rotated_cylinder_are_exact() -> None:
    solid = solid_of(Shape("cylinder", (0.5, 2.0, 0.0)))

    _, high = solid.bounds_at(at(0.0, 0.0, 0.0, turn=(math.pi / 4.0, 0.0, 0.0))[None])

    assert high[0] == pytest.approx([0.5, 1.5 * math.sqrt(0.5), 1.5 * math.sqrt(0.5)])


def test_planes_are_left_out() -> None:
    assert (
        list(
            list_collision_shapes(Model("m", (Link("l", collisions=(Shape("plane"),)),)), NO_MESHES)
        )
        == []
    )


@settings(max_examples=40)
@given(points, sizes)
def test_sphere_overlaps_a_box_within_its_radius(
    centre: tuple[float, float, float], radius: float
) -> None:
    gap = math.hypot(*(max(abs(part) - 0.5, 0.0) for part in centre))

    found = are_overlapping(ConvexShape(UNIT_CUBE), ball(centre, radius))

    assert found == (gap <= radius) or abs(gap - radius) < 1e-4


@settings(max_examples=40)
@given(points, sizes)
def test_sphere_overlaps_a_cylinder_within_its_radius(
    centre: tuple[float, float, float], radius: float
) -> None:
    x, y, z = centre
    gap = math.hypot(max(math.hypot(x, y) - 0.4, 0.0), max(abs(z) - 0.5, 0.0))

    found = are_overlapping(solid_of(Shape("cylinder", (0.4, 1.0, 0.0))), ball(centre, radius))

    assert found == (gap <= radius) or abs(gap - radius) < 1e-4


@settings(max_examples=25)
@given(st.lists(points, min_size=1, max_size=9), st.lists(points, min_size=1, max_size=9))
def test_overlap_is_symmetric_and_true_for_shared_points(
    one: list[tuple[float, float, float]], other: list[tuple[float, float, float]]
) -> None:
    left, right = ConvexShape(np.array(one)), ConvexShape(np.array(other))
    shared = ConvexShape(np.vstack([right.points, left.points.mean(axis=0)]))

    assert are_overlapping(left, right) == are_overlapping(right, left)
    assert are_overlapping(left, shared)


def test_extreme_points_of_a_box_are_its_corners() -> None:
    inner = np.random.default_rng(1).uniform(-0.4, 0.4, (200, 3))

    found = find_extreme_points(np.vstack([inner, UNIT_CUBE]))

    assert sorted(found.tolist()) == sorted(UNIT_CUBE.tolist())


@given(
    st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=1),
    st.sampled_from(["revolute", "prismatic"]),
)
def test_bounding_radius_holds_all_collisions(position: float, kind: JointKind) -> None:
    arm = an_arm(kind)
    tip = Link("arm", collisions=(Shape("box", (0.1, 0.2, 0.3), Origin((0.4, 0.0, 0.0))),))
    model = msgspec.structs.replace(arm, links=(arm.links[0], tip))

    (solid, places), *_ = place_collision_shapes(
        model, at(0.0, 0.0, 0.0)[None], np.array([[position]]), NO_MESHES
    )

    farthest = np.linalg.norm(solid.transformed_by(places[0]).points, axis=1).max()
    assert farthest <= find_bounding_radius(model, NO_MESHES) + 1e-9


def test_bounding_radius_of_an_unlimited_joint_is_infinite() -> None:
    arm = an_arm("prismatic")
    free = msgspec.structs.replace(arm.joints[0], lower=0.0, upper=0.0)
    tip = Link("arm", collisions=(Shape("sphere", (0.1, 0.0, 0.0)),))

    model = msgspec.structs.replace(arm, links=(arm.links[0], tip), joints=(free,))

    assert find_bounding_radius(model, NO_MESHES) == math.inf
