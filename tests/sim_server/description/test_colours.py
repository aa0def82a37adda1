"""Visuals have the colour that the file gives them."""

import pytest

from tests.sim_server.description.robots import (
    BALL,
    a_link,
    a_reference,
    a_robot,
    a_visual,
    an_inertial,
    reasons,
)
from zensim.proto.messages.model_messages import Quat
from zensim.sim_server.description.colours import GAZEBO_COLOURS, gazebo_colour
from zensim.sim_server.description.urdf import read_urdf

RED = '<material name="red"><color rgba="1 0 0 1"/></material>'
USE_RED = '<material name="red"/>'


def colours(*parts: str) -> list[Quat | None]:
    model = read_urdf(a_robot(*parts))
    return [shape.rgba for link in model.links for shape in link.visuals]


def test_visual_has_its_own_colour_when_given_inline() -> None:
    assert colours(a_link("a", a_visual(BALL, RED))) == [(1.0, 0.0, 0.0, 1.0)]


def test_visual_has_a_named_colour_when_the_robot_defines_it_later() -> None:
    assert colours(a_link("a", a_visual(BALL, USE_RED)), RED) == [(1.0, 0.0, 0.0, 1.0)]


def test_visual_has_a_named_colour_when_another_visual_defines_it() -> None:
    inside = a_visual(BALL, USE_RED) + a_visual(BALL, RED)

    assert colours(a_link("a", inside)) == [(1.0, 0.0, 0.0, 1.0)] * 2


def test_visual_is_white_when_its_colour_is_empty() -> None:
    material = '<material name="m"><color/></material>'

    assert colours(a_link("a", a_visual(BALL, material))) == [(1.0, 1.0, 1.0, 1.0)]


def test_visual_has_no_colour_when_none_is_given() -> None:
    assert colours(a_link("a", a_visual())) == [None]


def test_material_is_noted_when_nobody_defines_it() -> None:
    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(BALL, USE_RED))))

    assert model.links[0].visuals[0].rgba is None
    assert reasons(model.report, "suspicious") == [
        "material 'red': no <material> of this name has a colour"
    ]


def test_texture_is_noted_as_not_drawn_when_it_stands_for_a_colour() -> None:
    material = '<material name="m"><texture filename="t.png"/></material>'

    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(BALL, material))))

    assert [entry.status for entry in model.report] == ["ignored"]


def test_colour_is_cut_and_noted_when_it_counts_to_255() -> None:
    material = '<material name="m"><color rgba="255 0 -1 1"/></material>'

    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(BALL, material))))

    assert model.links[0].visuals[0].rgba == (1.0, 0.0, 0.0, 1.0)
    assert len(reasons(model.report, "suspicious")) == 1


def test_gazebo_material_wins_over_the_urdf_material() -> None:
    block = a_reference("a", "<material>Gazebo/Blue</material>")

    assert colours(a_link("a", a_visual(BALL, RED)), block) == [(0.0, 0.0, 1.0, 1.0)]


@pytest.mark.parametrize("name", ["Gazebo/Green", " Gazebo/Green\n", "Green"])
def test_gazebo_colour_is_found_with_and_without_its_prefix(name: str) -> None:
    assert gazebo_colour(name) == (0.0, 1.0, 0.0, 1.0)


def test_gazebo_colours_lie_between_0_and_1() -> None:
    assert all(0.0 <= part <= 1.0 for rgba in GAZEBO_COLOURS.values() for part in rgba)
    assert gazebo_colour("Gazebo/Plaid") is None
