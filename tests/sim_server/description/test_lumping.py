"""Lumping keeps mass, centre and inertia: compared with clouds of point masses."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.proto.messages.model_messages import (
    Frame,
    Inertial,
    Joint,
    Link,
    Origin,
    Quat,
    Shape,
    Vec3,
)
from zensim.sim_server.description.lumping import combine, lump
from zensim.sim_server.description.transforms import compose, placed

Array = npt.NDArray[np.float64]
HALF = 0.5**0.5
QUARTER_LEFT: Quat = (0.0, 0.0, HALF, HALF)


def coordinates(limit: float = 2.0) -> st.SearchStrategy[Vec3]:
    number = st.floats(-limit, limit)
    return st.tuples(number, number, number)


@st.composite
def origins(draw: st.DrawFn) -> Origin:
    parts = np.array(draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4)))
    length = np.linalg.norm(parts)
    x, y, z, w = (parts / length).tolist() if length > 0.1 else (0.0, 0.0, 0.0, 1.0)
    return Origin(draw(coordinates()), (x, y, z, w))


@st.composite
def clouds(draw: st.DrawFn) -> tuple[Array, Array]:
    count = draw(st.integers(1, 5))
    masses = draw(st.lists(st.floats(0.01, 5.0), min_size=count, max_size=count))
    points = draw(st.lists(coordinates(), min_size=count, max_size=count))
    return np.array(masses), np.array(points)


def inertial_of(masses: Array, points: Array) -> Inertial:
    mass = masses.sum()
    com = masses @ points / mass
    arms = points - com
    matrix = sum(
        m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        for m, arm in zip(masses, arms, strict=True)
    )
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = np.asarray(matrix).tolist()
    x, y, z = com.tolist()
    return Inertial(float(mass), (x, y, z), (ixx, ixy, ixz, iyy, iyz, izz))


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(clouds(), origins()), min_size=1, max_size=6))
def test_chain_of_fixed_joints_weighs_as_its_points_do(
    parts: list[tuple[tuple[Array, Array], Origin]],
) -> None:
    links = [Link(f"l{i}", inertial_of(*cloud)) for i, (cloud, _) in enumerate(parts)]
    joints = [
        Joint(f"j{i}", "fixed", f"l{i}", f"l{i + 1}", origin)
        for i, (_, origin) in enumerate(parts[1:])
    ]
    poses = [Origin()]
    for joint in joints:
        poses.append(compose(poses[-1], joint.origin))
    points = [
        placed(pose, (p[0], p[1], p[2]))
        for ((_, cloud), _), pose in zip(parts, poses, strict=True)
        for p in cloud.tolist()
    ]
    expected = inertial_of(np.concatenate([m for (m, _), _ in parts]), np.array(points))

    lumped = lump(links, joints, kept=frozenset())

    found = lumped.links[0].inertial
    assert found.mass_kg == pytest.approx(expected.mass_kg, abs=1e-9)
    assert found.com_in_link == pytest.approx(expected.com_in_link, abs=1e-9)
    assert found.inertia == pytest.approx(expected.inertia, rel=1e-9, abs=1e-9)


def test_child_with_an_offset_centre_counts_in_full_when_lumped() -> None:
    unit = (0.02, 0.0, 0.0, 0.02, 0.0, 0.02)
    links = [
        Link("a", Inertial(1.0, (0, 0, 0), unit)),
        Link("b", Inertial(1.0, (0, 0, -0.5), unit)),
    ]
    joints = [Joint("j", "fixed", "a", "b", Origin((0.2, 0.0, 0.0)))]

    inertial = lump(links, joints, kept=frozenset()).links[0].inertial

    assert inertial.com_in_link == pytest.approx((0.1, 0.0, -0.25))
    assert inertial.inertia == pytest.approx((0.165, 0.0, 0.05, 0.185, 0.0, 0.06))


def test_lone_link_is_untouched_when_nothing_merges() -> None:
    link = Link("a", Inertial(1.0, (0.1, 0.2, 0.3), (1.0, 0.1, 0.2, 1.0, 0.3, 1.0)))

    assert lump([link], [], kept=frozenset()).links == (link,)


def test_empty_root_takes_over_the_body_that_is_fixed_to_it() -> None:
    body = Inertial(2.0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    links = [Link("base_link"), Link("chassis", body)]

    lumped = lump(links, [Joint("j", "fixed", "base_link", "chassis")], kept=frozenset())

    assert lumped.links == (Link("base_link", body),)
    assert lumped.frames == (Frame("chassis", "base_link"),)


def test_frames_of_frames_hang_from_the_link_that_is_left() -> None:
    links = [Link("a"), Link("b"), Link("c")]
    step = Origin((1.0, 0.0, 0.0), QUARTER_LEFT)
    joints = [Joint("j", "fixed", "a", "b", step), Joint("k", "fixed", "b", "c", step)]

    frames = lump(links, joints, kept=frozenset()).frames

    assert [(frame.name, frame.parent) for frame in frames] == [("b", "a"), ("c", "a")]
    assert frames[1].origin.position == pytest.approx((1.0, 1.0, 0.0))


def test_shapes_keep_friction_and_colour_when_their_link_merges() -> None:
    caster = Shape("sphere", (0.1, 0.0, 0.0), Origin((0.0, 0.0, 0.5)), friction=0.0)
    paint = Shape("box", (1.0, 1.0, 1.0), rgba=(1.0, 0.0, 0.0, 1.0))
    links = [Link("a"), Link("b", collisions=(caster,), visuals=(paint,))]
    joints = [Joint("j", "fixed", "a", "b", Origin((0.0, 0.0, 1.0)))]

    link = lump(links, joints, kept=frozenset()).links[0]

    assert [(s.friction, s.origin.position) for s in link.collisions] == [(0.0, (0.0, 0.0, 1.5))]
    assert [(s.rgba, s.origin.position) for s in link.visuals] == [
        ((1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    ]


def test_joint_moves_to_the_link_that_is_left_when_its_parent_merges() -> None:
    links = [Link("base"), Link("chassis"), Link("wheel")]
    joints = [
        Joint("j", "fixed", "base", "chassis", Origin((0.0, 0.0, 1.0), QUARTER_LEFT)),
        Joint("k", "continuous", "chassis", "wheel", Origin((1.0, 0.0, 0.0)), axis=(0.0, 1.0, 0.0)),
    ]

    moved = lump(links, joints, kept=frozenset()).joints[0]

    assert (moved.parent, moved.child, moved.axis) == ("base", "wheel", (0.0, 1.0, 0.0))
    assert moved.origin.position == pytest.approx((0.0, 1.0, 1.0))
    assert moved.origin.orientation == pytest.approx(QUARTER_LEFT)


def test_fixed_joint_stays_when_it_is_to_be_kept() -> None:
    links = [Link("a"), Link("b"), Link("c")]
    joints = [Joint("j", "fixed", "a", "b"), Joint("k", "fixed", "b", "c")]

    lumped = lump(links, joints, kept=frozenset({"j"}))

    assert [link.name for link in lumped.links] == ["a", "b"]
    assert [(joint.name, joint.kind) for joint in lumped.joints] == [("j", "fixed")]
    assert lumped.frames == (Frame("c", "b"),)


def test_nothing_weighs_nothing_when_combined() -> None:
    assert combine([(Inertial(), Origin())]) == Inertial()


def test_massless_inertia_is_turned_when_combined() -> None:
    part = Inertial(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 2.0, 0.0, 3.0))

    found = combine([(part, Origin((5.0, 0.0, 0.0), QUARTER_LEFT))])

    assert found.inertia == pytest.approx((2.0, 0.0, 0.0, 1.0, 0.0, 3.0), abs=1e-12)
