"""Links and joints come out as the file has them, in zensim's own terms."""

import math

import pytest
from lxml import etree

from tests.sim_server.description.robots import (
    BALL,
    a_collision,
    a_joint,
    a_link,
    a_robot,
    a_visual,
    an_inertial,
    reasons,
)
from zensim.proto.messages.model_messages import Origin
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.assets import no_meshes
from zensim.sim_server.description.parts import read_parts
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.shapes import MeshRule
from zensim.sim_server.description.strict_xml import parse_xml
from zensim.sim_server.description.urdf import read_urdf
from zensim.sim_server.errors import ModelError

MESH = '<geometry><mesh filename="package://r/body.stl" scale="2"/></geometry>'


def test_shapes_have_sizes_in_metres_when_read() -> None:
    geometries = (
        '<box size="1 2 3"/>',
        '<sphere radius="4"/>',
        '<cylinder length="6" radius="5"/>',
        '<mesh filename="m.stl"/>',
        '<mesh filename="m.stl" scale="1 2 3"/>',
    )
    inside = "".join(a_collision(f"<geometry>{shape}</geometry>") for shape in geometries)

    model = read_urdf(a_robot(a_link("a", inside)), has_mesh=lambda _uri: True)

    assert [(shape.kind, shape.size, shape.mesh) for shape in model.links[0].collisions] == [
        ("box", (1.0, 2.0, 3.0), ""),
        ("sphere", (4.0, 0.0, 0.0), ""),
        ("cylinder", (5.0, 6.0, 0.0), ""),
        ("mesh", (1.0, 1.0, 1.0), "m.stl"),
        ("mesh", (1.0, 2.0, 3.0), "m.stl"),
    ]


def test_origin_turns_about_fixed_axes_when_it_has_roll_pitch_yaw() -> None:
    quarter = math.pi / 2
    text = a_robot(
        a_link("a", a_visual(BALL, f'<origin xyz="1 2 3" rpy="{quarter} 0 {quarter}"/>'))
    )

    origin = read_urdf(text).links[0].visuals[0].origin

    assert origin.position == (1.0, 2.0, 3.0)
    assert origin.orientation == pytest.approx((0.5, 0.5, 0.5, 0.5))


def test_inertia_is_in_link_axes_when_its_origin_is_turned() -> None:
    inertial = (
        f'<inertial><origin xyz="0 0 1" rpy="{math.pi / 2} 0 0"/><mass value="2"/>'
        '<inertia ixx="1" iyy="2" izz="3"/></inertial>'
    )

    read = read_urdf(a_robot(a_link("a", inertial))).links[0].inertial

    assert (read.mass_kg, read.com_in_link) == (2.0, (0.0, 0.0, 1.0))
    assert read.inertia == pytest.approx((1, 0, 0, 3, 0, 2), abs=1e-12)


def test_joint_keeps_limits_and_dynamics_when_read() -> None:
    inside = (
        '<limit lower="-1" upper="2" effort="3" velocity="4"/><dynamics damping="5" friction="6"/>'
    )
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    joint = read_urdf(a_robot(pair, a_joint("j", ("a", "b"), "revolute", inside))).joints[0]

    assert (joint.lower, joint.upper, joint.effort, joint.velocity) == (-1.0, 2.0, 3.0, 4.0)
    assert (joint.damping, joint.friction) == (5.0, 6.0)
    assert (joint.axis, joint.origin) == ((1.0, 0.0, 0.0), Origin())


@pytest.mark.parametrize("kind", ["continuous", "floating", "planar"])
def test_joint_needs_no_limit_when_its_kind_has_none(kind: str) -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    last = read_urdf(a_robot(pair, a_joint("j", ("a", "b"), kind))).joints[-1]

    assert (last.name, last.kind) == ("j", "continuous")


@pytest.mark.parametrize(
    ("kind", "slug"),
    [("hinge", "urdf.joint_type"), ("revolute", "urdf.limit"), ("prismatic", "urdf.limit")],
)
def test_joint_is_refused_when_its_kind_is_none_or_lacks_a_limit(kind: str, slug: str) -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    with pytest.raises(ModelError, match="joint 'j'") as caught:
        read_urdf(a_robot(pair, a_joint("j", ("a", "b"), kind)))

    assert caught.value.slug == slug


def test_visual_mesh_is_dropped_and_noted_when_it_is_not_here() -> None:
    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(MESH) + a_visual())))

    assert [shape.kind for shape in model.links[0].visuals] == ["sphere"]
    assert reasons(model.report, "suspicious") == [
        "link 'a', visual 1: visual mesh 'package://r/body.stl' is not on the server; not drawn"
    ]


def test_collision_mesh_refuses_the_robot_when_it_is_not_here() -> None:
    with pytest.raises(ModelError, match=r"package://r/body\.stl") as caught:
        read_urdf(a_robot(a_link("a", a_collision(MESH))))

    assert (caught.value.code, caught.value.slug) == (SpawnCode.MISSING_ASSETS, "mesh.missing")


def test_reader_is_asked_for_each_mesh_when_meshes_are_named() -> None:
    asked: list[str] = []

    def has_mesh(uri: str) -> bool:
        asked.append(uri)
        return True

    model = read_urdf(a_robot(a_link("a", a_visual(MESH) + a_collision(MESH))), has_mesh=has_mesh)

    assert set(asked) == {"package://r/body.stl"}
    assert model.links[0].visuals[0].size == (2.0, 2.0, 2.0)


@pytest.mark.parametrize("inside", ["<joint name='j'/>", "<link/>"])
def test_parts_are_refused_when_the_grammar_was_not_checked(inside: str) -> None:
    robot = parse_xml(a_robot(inside), root_tag="robot", slug="urdf")

    with pytest.raises(ModelError) as caught:
        read_parts(robot, MeshRule(no_meshes), Report())

    assert caught.value.slug == "urdf.unreadable"
    assert etree.tostring(robot)
