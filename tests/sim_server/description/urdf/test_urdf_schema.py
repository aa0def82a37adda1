"""Unknown, unused and missing elements of URDF."""

import pytest

from tests.sim_server.description.robots import (
    BALL,
    a_collision,
    a_joint,
    a_link,
    a_robot,
    a_visual,
    an_inertial,
    mentions,
    report_of,
    subjects,
)
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

PAIR = a_link("a", an_inertial()) + a_link("b", an_inertial())


def slug_of(text: str) -> str:
    with pytest.raises(ModelError) as caught:
        read_urdf(text)
    assert "\n" not in caught.value.message
    return caught.value.slug


@pytest.mark.parametrize(
    ("text", "slug"),
    [
        ("<robot/>", "urdf.name"),
        (a_robot("<link/>"), "urdf.name"),
        (a_robot('<link name="  "/>'), "urdf.name"),
        (a_robot(a_link("a"), "<joint/>"), "urdf.name"),
        (a_robot(PAIR, '<joint name="j"/>'), "urdf.type"),
        (a_robot(PAIR, '<joint name="j" type="fixed"><child link="b"/></joint>'), "urdf.parent"),
        (a_robot(PAIR, '<joint name="j" type="fixed"><parent link="a"/></joint>'), "urdf.child"),
        (a_robot(PAIR, '<joint name="j" type="fixed"><parent/><child/></joint>'), "urdf.link"),
        (a_robot(a_link("a", "<inertial/>")), "urdf.mass"),
        (a_robot(a_link("a", '<inertial><mass value="1"/></inertial>')), "urdf.inertia"),
        (a_robot(a_link("a", "<inertial><mass/></inertial>")), "urdf.value"),
        (a_robot(a_link("a", "<collision/>")), "urdf.geometry"),
        (a_robot(a_link("a", a_collision("<geometry/>"))), "urdf.geometry"),
        (a_robot(a_link("a", a_visual("<geometry><cone/></geometry>"))), "urdf.geometry"),
        (a_robot(a_link("a", a_visual("<geometry><box/></geometry>"))), "urdf.size"),
        (a_robot(a_link("a", a_visual("<geometry><mesh/></geometry>"))), "urdf.filename"),
        (a_robot("<material/>"), "urdf.name"),
    ],
)
def test_schema_refuses_a_missing_element(text: str, slug: str) -> None:
    assert slug_of(text) == slug


@pytest.mark.parametrize(
    "inside",
    [
        an_inertial(mass="nan"),
        an_inertial(mass="1 2"),
        an_inertial(diagonal="1,0"),
        a_collision('<geometry><box size="1 1"/></geometry>'),
        a_collision('<geometry><sphere radius="inf"/></geometry>'),
        a_collision(BALL, '<origin xyz="0 0"/>'),
        a_collision(BALL, '<origin rpy="0 0 nan"/>'),
        a_visual(BALL, '<material name="m"><color rgba="1 1"/></material>'),
        a_visual('<geometry><mesh filename="m.stl" scale="1 1"/></geometry>'),
    ],
)
def test_schema_refuses_a_link_with_an_invalid_number(inside: str) -> None:
    assert slug_of(a_robot(a_link("a", inside))) == "urdf.number"


@pytest.mark.parametrize(
    "inside",
    [
        '<limit lower="x"/>',
        '<dynamics damping="nan"/>',
        '<axis xyz="1 0"/>',
        '<mimic joint="k" multiplier="two"/>',
        '<calibration rising="up"/>',
        '<safety_controller k_velocity=""/>',
    ],
)
def test_schema_refuses_a_joint_with_an_invalid_number(inside: str) -> None:
    joint = a_joint("j", ("a", "b"), "continuous", inside)

    assert slug_of(a_robot(PAIR, joint)) == "urdf.number"


@pytest.mark.parametrize("name", ["n" * 257, "a&#10;b", "a&#9;b"])
def test_schema_refuses_a_long_or_unprintable_name(name: str) -> None:
    assert slug_of(a_robot(f'<link name="{name}"/>')) == "urdf.text"


def test_unknown_elements_are_reported() -> None:
    link = a_link("a", "<pose>0 0 0</pose>" + a_visual(BALL, "<collision/>"))
    joint = a_joint(
        "j", ("a", "b"), "continuous", '<joint_properties damping="1"/><axis xyz="0 1 0" rpy="0"/>'
    )

    entries = report_of(a_robot(link, a_link("b", an_inertial()), joint, "<lnk/>", "<zebra/>"))

    assert subjects(entries, "unknown") == [
        "link 'a': <pose>",
        "link 'a', visual: <collision>",
        "joint 'j': <joint_properties>",
        "joint 'j', axis: attribute rpy",
        "robot: <zebra>",
    ]
    assert mentions(entries, "suspicious", "robot: <lnk>", "<link>")


def test_elements_without_effect_are_reported() -> None:
    joint = a_joint("j", ("a", "b"), "continuous", '<calibration rising="0"/>')

    entries = report_of(a_robot(PAIR, joint, '<transmission name="t"><any x="y"/></transmission>'))

    assert [entry.subject for entry in entries if entry.status == "ignored"] == [
        "joint 'j', calibration",
        "transmission 't'",
    ]


def test_first_tag_is_used_when_it_is_repeated() -> None:
    second = '<inertia ixx="9" iyy="9" izz="9"/></inertial>'
    link = a_link("a", an_inertial().replace("</inertial>", second))

    model = read_urdf(a_robot(link))

    assert model.links[0].inertial.inertia[0] == 0.1
    assert subjects(model.report, "suspicious") == ["link 'a', inertial, inertia"]
