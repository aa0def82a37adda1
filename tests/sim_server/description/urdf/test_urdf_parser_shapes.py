"""Collisions and visuals: kinds, sizes, and meshes that are not here."""

import pytest

from tests.sim_server.description.robots import (
    BALL,
    a_collision,
    a_link,
    a_robot,
    a_visual,
    mentions,
)
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

MESH = '<geometry><mesh filename="package://r/body.stl" scale="-1 1 1"/></geometry>'


def test_capsule_is_read_when_a_link_has_one() -> None:
    capsule = '<geometry><capsule radius="0.1" length="0.4"/></geometry>'

    (shape,) = read_urdf(a_robot(a_link("a", a_collision(capsule)))).links[0].collisions

    assert (shape.kind, shape.size) == ("capsule", (0.1, 0.4, 0.0))


def test_first_shape_counts_when_a_geometry_holds_two() -> None:
    two = '<geometry><sphere radius="0.1"/><box size="1 1 1"/></geometry>'

    model = read_urdf(a_robot(a_link("a", a_visual(two))))

    assert [shape.kind for shape in model.links[0].visuals] == ["sphere"]
    assert mentions(model.report, "suspicious", "link 'a', visual, geometry", "2")


def test_each_visual_is_noted_once_when_its_mesh_is_not_here() -> None:
    model = read_urdf(a_robot(a_link("a", a_visual(MESH) * 2 + a_visual()), name_of_others()))

    missing = [entry.subject for entry in model.report if "body.stl" in entry.reason]
    assert missing == ["link 'a', visual 1", "link 'a', visual 2", "link 'b'"]


def name_of_others() -> str:
    joint = '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
    return a_link("b", a_visual(MESH)) + joint


def test_visual_is_not_drawn_when_its_size_is_0() -> None:
    dot = '<geometry><sphere radius="0"/></geometry>'

    model = read_urdf(a_robot(a_link("a", a_visual(dot) + a_visual())))

    assert len(model.links[0].visuals) == 1
    assert mentions(model.report, "suspicious", "link 'a', visual 1", "sphere", "0")


def test_mesh_may_be_mirrored_when_its_scale_is_negative() -> None:
    model = read_urdf(a_robot(a_link("a", a_visual(MESH))), has_mesh=lambda _uri: True)

    assert model.links[0].visuals[0].size == (-1.0, 1.0, 1.0)


def test_collision_mesh_is_left_out_only_when_it_may_be_missing() -> None:
    text = a_robot(a_link("a", a_collision(MESH) + a_collision(BALL)))

    with pytest.raises(ModelError) as caught:
        read_urdf(text)
    model = read_urdf(text, allow_missing=True)

    assert (caught.value.code, caught.value.slug) == (SpawnCode.MISSING_ASSETS, "mesh.missing")
    assert [shape.kind for shape in model.links[0].collisions] == ["sphere"]
    assert mentions(model.report, "suspicious", "link 'a'", "collision", "body.stl")
