"""Lumped inertials, mimics, and chains for planar and floating joints."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sim_server.description.robots import (
    a_joint,
    a_link,
    a_robot,
    an_inertial,
    link_names,
    mentions,
)
from zensim.proto.messages.model_messages import (
    Frame,
    Inertial,
    Joint,
    Link,
    Mimic,
    Origin,
    Quat,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import compose, transform_point
from zensim.sim_server.description.joint_reduction import (
    MAX_JOINTS,
    combine_inertials,
    lump_fixed_joints,
)
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

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
def point_masses(draw: st.DrawFn) -> tuple[Array, Array]:
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
@given(st.lists(st.tuples(point_masses(), origins()), min_size=1, max_size=6))
def test_lumped_inertial_is_that_of_all_points(
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
        transform_point(pose, (p[0], p[1], p[2]))
        for ((_, cloud), _), pose in zip(parts, poses, strict=True)
        for p in cloud.tolist()
    ]
    expected = inertial_of(np.concatenate([m for (m, _), _ in parts]), np.array(points))

    lumped = lump_fixed_joints(links, joints, kept=frozenset())

    found = lumped.links[0].inertial
    assert found.mass_kg == pytest.approx(expected.mass_kg, abs=1e-9)
    assert found.com_in_link == pytest.approx(expected.com_in_link, abs=1e-9)
    assert found.inertia == pytest.approx(expected.inertia, rel=1e-9, abs=1e-9)


def test_offset_of_a_child_adds_to_the_inertia_when_lumped() -> None:
    unit = (0.02, 0.0, 0.0, 0.02, 0.0, 0.02)
    links = [
        Link("a", Inertial(1.0, (0, 0, 0), unit)),
        Link("b", Inertial(1.0, (0, 0, -0.5), unit)),
    ]
    joints = [Joint("j", "fixed", "a", "b", Origin((0.2, 0.0, 0.0)))]

    inertial = lump_fixed_joints(links, joints, kept=frozenset()).links[0].inertial

    assert inertial.com_in_link == pytest.approx((0.1, 0.0, -0.25))
    assert inertial.inertia == pytest.approx((0.165, 0.0, 0.05, 0.185, 0.0, 0.06))


def test_single_link_is_unchanged() -> None:
    link = Link("a", Inertial(1.0, (0.1, 0.2, 0.3), (1.0, 0.1, 0.2, 1.0, 0.3, 1.0)))

    assert lump_fixed_joints([link], [], kept=frozenset()).links == (link,)


def test_empty_root_has_the_inertial_of_the_link_fixed_to_it() -> None:
    body = Inertial(2.0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    links = [Link("base_link"), Link("chassis", body)]

    lumped = lump_fixed_joints(
        links, [Joint("j", "fixed", "base_link", "chassis")], kept=frozenset()
    )

    assert lumped.links == (Link("base_link", body),)
    assert lumped.frames == (Frame("chassis", "base_link"),)


def test_frames_of_merged_links_are_in_the_remaining_link() -> None:
    links = [Link("a"), Link("b"), Link("c")]
    step = Origin((1.0, 0.0, 0.0), QUARTER_LEFT)
    joints = [Joint("j", "fixed", "a", "b", step), Joint("k", "fixed", "b", "c", step)]

    frames = lump_fixed_joints(links, joints, kept=frozenset()).frames

    assert [(frame.name, frame.parent) for frame in frames] == [("b", "a"), ("c", "a")]
    assert frames[1].origin.position == pytest.approx((1.0, 1.0, 0.0))


def test_shapes_keep_friction_and_colour_when_their_link_merges() -> None:
    caster = Shape("sphere", (0.1, 0.0, 0.0), Origin((0.0, 0.0, 0.5)), friction=0.0)
    paint = Shape("box", (1.0, 1.0, 1.0), rgba=(1.0, 0.0, 0.0, 1.0))
    links = [Link("a"), Link("b", collisions=(caster,), visuals=(paint,))]
    joints = [Joint("j", "fixed", "a", "b", Origin((0.0, 0.0, 1.0)))]

    link = lump_fixed_joints(links, joints, kept=frozenset()).links[0]

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

    moved = lump_fixed_joints(links, joints, kept=frozenset()).joints[0]

    assert (moved.parent, moved.child, moved.axis) == ("base", "wheel", (0.0, 1.0, 0.0))
    assert moved.origin.position == pytest.approx((0.0, 1.0, 1.0))
    assert moved.origin.orientation == pytest.approx(QUARTER_LEFT)


def test_kept_fixed_joint_is_not_lumped() -> None:
    links = [Link("a"), Link("b"), Link("c")]
    joints = [Joint("j", "fixed", "a", "b"), Joint("k", "fixed", "b", "c")]

    lumped = lump_fixed_joints(links, joints, kept=frozenset({"j"}))

    assert [link.name for link in lumped.links] == ["a", "b"]
    assert [(joint.name, joint.kind) for joint in lumped.joints] == [("j", "fixed")]
    assert lumped.frames == (Frame("c", "b"),)


def test_combined_empty_inertials_are_empty() -> None:
    assert combine_inertials([(Inertial(), Origin())]) == Inertial()


def test_massless_inertia_is_rotated_when_combined() -> None:
    part = Inertial(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 2.0, 0.0, 3.0))

    found = combine_inertials([(part, Origin((5.0, 0.0, 0.0), QUARTER_LEFT))])

    assert found.inertia == pytest.approx((2.0, 0.0, 0.0, 1.0, 0.0, 3.0), abs=1e-12)


LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def a_gripper(*inside: str, kinds: tuple[str, ...] = ("revolute",) * 3) -> str:
    """A palm with three fingers `f0` to `f2`, moved by `j0` to `j2`."""
    fingers = "".join(
        a_link(f"f{i}", an_inertial()) + a_joint(f"j{i}", ("palm", f"f{i}"), kind, LIMIT + extra)
        for i, (extra, kind) in enumerate(zip((*inside, "", "", "")[:3], kinds, strict=True))
    )
    return a_robot(a_link("palm", an_inertial()), fingers)


def test_valid_mimic_is_kept() -> None:
    mimic = '<mimic joint="j0" multiplier="-2" offset="0.1"/>'

    model = read_urdf(a_gripper("", mimic, '<mimic joint="j1"/>'))

    assert [joint.mimic for joint in model.joints] == [
        None,
        Mimic("j0", -2.0, 0.1),
        Mimic("j1", 1.0, 0.0),
    ]
    assert mentions(model.report, "applied", "joint 'j1': <mimic>", "'j0'")


@pytest.mark.parametrize(
    ("inside", "kinds", "fault"),
    [
        (("", '<mimic joint="missing"/>'), ("revolute",) * 3, "'missing'"),
        (("", '<mimic joint="j2"/>'), ("revolute", "revolute", "fixed"), "'j2'"),
        (("", '<mimic joint="j1"/>'), ("revolute",) * 3, "'j1' would"),
        (('<mimic joint="j1"/>', '<mimic joint="j0"/>'), ("revolute",) * 3, "'j0' would"),
        (("", '<mimic joint="j0" multiplier="0"/>'), ("revolute",) * 3, "multiplier"),
        (("", '<mimic joint="j0"/>'), ("planar", "revolute", "revolute"), "'j0' is planar"),
        (('<mimic joint="j1"/>',), ("floating", "revolute", "revolute"), "floating"),
    ],
)
def test_invalid_mimic_is_reported(
    inside: tuple[str, ...], kinds: tuple[str, ...], fault: str
) -> None:
    model = read_urdf(a_gripper(*inside, kinds=kinds))

    assert mentions(model.report, "suspicious", "<mimic>", fault)
    assert [joint.mimic for joint in model.joints if joint.mimic] == []


PAIR = a_link("a", an_inertial()) + a_link("b", an_inertial())
PLACE = '<origin xyz="1 2 3"/><axis xyz="0 0 1"/>'


def test_planar_joint_slides_in_its_plane_then_turns() -> None:
    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "planar", PLACE)))

    assert [(j.name, j.kind, j.parent, j.child, j.axis) for j in model.joints] == [
        ("j_x", "prismatic", "a", "b_x", (1.0, 0.0, 0.0)),
        ("j_y", "prismatic", "b_x", "b_y", (0.0, 1.0, 0.0)),
        ("j", "continuous", "b_y", "b", (0.0, 0.0, 1.0)),
    ]
    assert [j.origin for j in model.joints] == [Origin((1.0, 2.0, 3.0)), Origin(), Origin()]
    assert model.mass_kg == 2.0


def test_floating_joint_slides_and_turns_in_all_ways() -> None:
    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "floating", PLACE)))

    assert link_names(model) == ["a", "b_x", "b_y", "b_z", "b_yaw", "b_pitch", "b"]
    assert [j.kind for j in model.joints] == ["prismatic"] * 3 + ["continuous"] * 3
    assert mentions(model.report, "applied", "joint 'j'", "floating", "6 joints")


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: sum(a * a for a in axis) > 0.01))
def test_planar_joint_slides_across_any_normal(axis: tuple[float, float, float]) -> None:
    place = f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'

    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "planar", place)))

    axes = np.array([joint.axis for joint in model.joints])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.cross(axes[0], axes[1]) == pytest.approx(axes[2], abs=1e-9)


def test_names_of_a_chain_are_unique() -> None:
    links = a_link("b_x", an_inertial()) + a_joint("j_x", ("a", "b_x"), "continuous")

    model = read_urdf(a_robot(PAIR, links, a_joint("j", ("a", "b"), "planar")))

    assert len({*link_names(model)}) == len(model.links) == 5
    assert len({joint.name for joint in model.joints}) == 4


def test_robot_on_a_floating_world_joint_is_free() -> None:
    world = a_joint("free", ("world", "a"), "floating")

    model = read_urdf(a_robot(a_link("world"), a_link("a", an_inertial()), world))

    assert (link_names(model), model.joints, model.is_static) == (["a"], (), False)


def test_robot_with_a_world_root_is_static() -> None:
    fixed = a_joint("nail", ("world", "a")) + a_joint("j", ("a", "b"), "continuous")

    model = read_urdf(a_robot(a_link("world"), PAIR, fixed))

    assert (link_names(model), model.is_static, model.mass_kg) == (["world", "b"], True, 2.0)
    assert [frame.name for frame in model.frames] == ["a"]


def a_robot_with_joints(spines: int, kind: str) -> str:
    return a_robot(
        a_link("body", an_inertial()),
        *(
            a_link(f"s{i}", an_inertial()) + a_joint(f"j{i}", ("body", f"s{i}"), kind)
            for i in range(spines)
        ),
    )


@pytest.mark.parametrize(("spines", "kind"), [(MAX_JOINTS + 1, "continuous"), (41, "planar")])
def test_robot_is_refused_when_too_many_joints_are_left(spines: int, kind: str) -> None:
    with pytest.raises(ModelError, match=str(MAX_JOINTS)) as caught:
        read_urdf(a_robot_with_joints(spines, kind))

    assert caught.value.slug == "urdf.joints"


@pytest.mark.parametrize(("spines", "kind"), [(MAX_JOINTS, "continuous"), (499, "fixed")])
def test_robot_is_read_when_joints_do_not_exceed_the_maximum(spines: int, kind: str) -> None:
    assert read_urdf(a_robot_with_joints(spines, kind)).mass_kg == pytest.approx(spines + 1)
