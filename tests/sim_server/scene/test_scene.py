"""Entities of a scene are posed by one reading, and found by region, distance and ray."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.models import a_state, an_arm
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.proto.se3 import FloatArray, conjugate, from_rpy, rotate
from zensim.sim_server.description.model_geometry import NO_MESHES
from zensim.sim_server.scene.convex_shapes import ConvexShape, find_distance
from zensim.sim_server.scene.ray_casting import NO_ENTITY
from zensim.sim_server.scene.scene import (
    ENTITIES_PER_TURN,
    CollisionScene,
    SceneLayout,
    make_region,
)

NONE = np.zeros(0)
BALL = Model("ball", (Link("base", collisions=(Shape("sphere", (0.5, 0.0, 0.0)),)),))
POST = Model(
    "post", (Link("base", collisions=(Shape("cylinder", (0.2, 2.0, 0.0)),)),), is_static=True
)
ARM = Model(
    "arm",
    (
        Link("base"),
        Link("tip", collisions=(Shape("box", (0.2, 0.2, 0.2), Origin((1.0, 0.0, 0.0))),)),
    ),
    (Joint("j", "revolute", "base", "tip", axis=(0.0, 0.0, 1.0)),),
)
NOTHING = Model("marker", (Link("base"),))


def at(*position: float) -> FloatArray:
    return a_state((position[0], position[1], position[2]))


def a_scene(
    *placed: tuple[Model, FloatArray], joints: FloatArray = NONE, ground: bool = False
) -> CollisionScene:
    layout = SceneLayout([model for model, _ in placed], NO_MESHES, has_ground=ground)
    return CollisionScene(layout, np.array([base for _, base in placed]).reshape(-1, 13), joints)


def a_ball(*centre: float, radius: float = 0.1) -> ConvexShape:
    return ConvexShape(np.array([centre]), radius)


def test_region_overlaps_entities_of_all_models() -> None:
    scene = a_scene(
        (BALL, at(0.0, 0.0, 0.0)),
        (POST, at(1.0, 0.0, 0.0)),
        (BALL, at(5.0, 0.0, 0.0)),
        (NOTHING, at(0.7, 0.0, 0.0)),
    )

    assert scene.overlaps(make_region(a_ball(0.7, 0.0, 0.0, radius=0.25))) == [0, 1, 3]


def test_overlaps_of_many_entities_come_a_few_at_a_time() -> None:
    count = 3 * ENTITIES_PER_TURN
    scene = a_scene(*[(BALL, at(0.01 * i, 0.0, 0.0)) for i in range(count)])

    turns = list(scene.iter_overlaps(make_region(a_ball(0.0, 0.0, 0.0, radius=9.0)), range(count)))

    assert len(turns) >= 3
    assert sorted(row for turn in turns for row in turn) == list(range(count))


def test_overlaps_are_limited_to_the_given_entities() -> None:
    scene = a_scene((BALL, at(0.0, 0.0, 0.0)), (BALL, at(0.1, 0.0, 0.0)))

    turns = scene.iter_overlaps(make_region(a_ball(0.0, 0.0, 0.0)), [1])

    assert [row for turn in turns for row in turn] == [1]


def test_entity_overlaps_others_but_not_itself() -> None:
    scene = a_scene((BALL, at(0.0, 0.0, 0.0)), (BALL, at(0.9, 0.0, 0.0)), (POST, at(1.7, 0.0, 0.0)))

    assert [scene.entity_overlaps(entity) for entity in range(3)] == [[1], [0], []]


def test_links_are_posed_by_their_joint_positions() -> None:
    joints = np.array([0.0, math.pi / 2.0])
    scene = a_scene((ARM, at(0.0, 0.0, 0.0)), (ARM, at(0.0, 0.0, 0.0)), joints=joints)

    assert scene.overlaps(make_region(a_ball(1.0, 0.0, 0.0))) == [0]
    assert scene.overlaps(make_region(a_ball(0.0, 1.0, 0.0))) == [1]
    assert scene.nearest(a_ball(0.0, 2.0, 0.0, radius=0.0))[0] == pytest.approx(0.9, abs=1e-5)


def test_prismatic_joint_moves_what_a_ray_hits() -> None:
    arm = an_arm("prismatic")
    tip = Link("arm", collisions=(Shape("sphere", (0.1, 0.0, 0.0)),))
    model = Model("lift", (arm.links[0], tip), arm.joints)
    layout = SceneLayout([model], NO_MESHES)
    down = np.array([[0.0, 0.0, -1.0]])
    ranges = [
        CollisionScene(layout, at(0.0, 0.0, 0.0)[None], np.array([position]))
        .cast_rays(np.array([[0.0, 0.0, 9.0]]), down, 20.0)
        .ranges[0]
        for position in (0.0, 0.25)
    ]

    assert ranges[0] - ranges[1] == pytest.approx(0.25)


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_nearest_is_the_smallest_of_the_closed_forms(point: tuple[float, float, float]) -> None:
    x, y, z = point
    scene = a_scene((BALL, at(1.0, 0.0, 0.0)), (POST, at(-1.0, 0.0, 0.0)), ground=True)
    to_ball = max(math.dist(point, (1.0, 0.0, 0.0)) - 0.5, 0.0)
    to_post = math.hypot(max(math.hypot(x + 1.0, y) - 0.2, 0.0), max(abs(z) - 1.0, 0.0))

    distance, _ = scene.nearest(ConvexShape(np.array([point])))

    assert distance == pytest.approx(min(to_ball, to_post, max(z, 0.0)), abs=1e-4)


def test_nearest_names_the_entity_and_leaves_ignored_ones_out() -> None:
    scene = a_scene((BALL, at(2.0, 0.0, 0.0)), (BALL, at(4.0, 0.0, 0.0)))
    ball = a_ball(0.0, 0.0, 0.0, radius=0.5)

    found = [scene.nearest(ball, ignored=ignored) for ignored in (set[int](), {0}, {0, 1})]

    assert [entity for _, entity in found] == [0, 1, NO_ENTITY]
    assert [distance for distance, _ in found] == pytest.approx([1.0, 3.0, math.inf], abs=1e-5)


def test_fixed_entities_are_posed_again_only_when_they_are_moved() -> None:
    layout = SceneLayout([POST, BALL], NO_MESHES)
    base = np.array([at(0.0, 0.0, 0.0), at(3.0, 0.0, 0.0)])
    moved = base + np.array([[0.0], [1.0]])
    both = np.array([at(1.0, 0.0, 0.0), at(3.0, 0.0, 0.0)])

    poses = [CollisionScene(layout, states, NONE).shapes.poses for states in (base, moved, both)]

    assert [one[:, 0].tolist() for one in poses] == [[0.0, 3.0], [0.0, 4.0], [1.0, 3.0]]


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(0.1, 1.0)] * 3),
)
def test_distance_of_a_point_and_a_box_is_that_of_the_closed_form(
    point: tuple[float, float, float],
    turn: tuple[float, float, float],
    size: tuple[float, float, float],
) -> None:
    model = Model("box", (Link("base", collisions=(Shape("box", size),)),))
    base = np.concatenate([np.zeros(3), from_rpy(*turn), np.zeros(6)])
    local = rotate(conjugate(base[3:7]), np.array(point))
    outside = np.maximum(np.abs(local) - np.array(size) / 2.0, 0.0)

    found, _ = a_scene((model, base)).nearest(ConvexShape(np.array([point])))

    assert found == pytest.approx(float(np.linalg.norm(outside)), abs=1e-5)


def test_distance_of_overlapping_shapes_is_zero() -> None:
    assert find_distance(a_ball(0.0, 0.0, 0.0), a_ball(0.15, 0.0, 0.0)) == 0.0
