"""The <gazebo> blocks of links, joints and the robot."""

import pytest

from tests.sim_server.description.robots import (
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    an_inertial,
    link_names,
    mentions,
    report_of,
    subjects,
)
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

BODY = a_link("body", an_inertial() + a_collision())
CASTER = a_link("caster", a_collision()) + a_joint("j", ("body", "caster"))


def frictions(*parts: str) -> list[float]:
    return [shape.friction for shape in read_urdf(a_robot(*parts)).links[0].collisions]


def test_friction_stays_with_its_own_collision_when_links_merge() -> None:
    block = a_reference("caster", "<mu1>0</mu1>")

    assert frictions(BODY, CASTER, block) == [1.0, 0.0]


@pytest.mark.parametrize("tag", ["<mu1> 0.5 </mu1>", '<mu1 value="0.5"/>'])
def test_friction_is_read_when_written_as_text_or_value(tag: str) -> None:
    assert frictions(BODY, a_reference("body", tag)) == [0.5]


def test_last_friction_is_used_when_two_blocks_have_one() -> None:
    blocks = a_reference("body", "<mu1>0.5</mu1>") + a_reference("body", "<mu1>0.25</mu1>")

    assert frictions(BODY, blocks) == [0.25]


@pytest.mark.parametrize("value", ["-1", "nan", "slippery", ""])
def test_friction_is_refused_when_it_is_invalid(value: str) -> None:
    with pytest.raises(ModelError, match="'body', mu1") as caught:
        read_urdf(a_robot(BODY, a_reference("body", f"<mu1>{value}</mu1>")))

    assert caught.value.slug == "gazebo.mu1"


@pytest.mark.parametrize("tag", ["preserveFixedJoint", "disableFixedJointLumping"])
def test_fixed_joint_is_kept_when_asked_for(tag: str) -> None:
    model = read_urdf(a_robot(BODY, CASTER, a_reference("j", f"<{tag}>true</{tag}>")))

    assert link_names(model) == ["body", "caster"]
    assert model.joints[0].kind == "fixed"


def test_fixed_joint_is_lumped_when_keeping_is_switched_off() -> None:
    block = a_reference("j", "<preserveFixedJoint>false</preserveFixedJoint>")

    assert link_names(read_urdf(a_robot(BODY, CASTER, block))) == ["body"]


def test_robot_is_static_when_its_block_sets_it() -> None:
    assert read_urdf(a_robot(BODY, "<gazebo><static>true</static></gazebo>")).is_static


def test_report_lists_the_effect_of_each_gazebo_tag() -> None:
    entries = report_of(
        a_robot(
            BODY,
            CASTER,
            a_reference("body", "<mu1>1</mu1><kp>1e6</kp><mu_1>1</mu_1><zebra/>"),
            a_reference("body", "<material>Gazebo/Red</material>"),
            a_reference("body", "<material>Gazebo/Plaid</material>"),
            a_reference("body", '<sensor type="imu" name="s"><any/></sensor>'),
            a_reference("body", '<plugin name="p" filename="f"/>'),
            a_reference("j", "<stopCfm>0</stopCfm><preserveFixedJoints>1</preserveFixedJoints>"),
            a_reference("ghost", "<mu1>1</mu1>"),
            "<gazebo><self_collide>1</self_collide><zebra/></gazebo>",
        )
    )

    assert subjects(entries, "applied")[-4:] == [
        "gazebo 'body': <material>",
        "gazebo: <self_collide>",
        "gazebo 'body': <mu1>",
        "gazebo 'body': <kp>",
    ]
    assert subjects(entries, "ignored") == ["gazebo 'j': <stopCfm>", "sensor 's' on 'body'"]
    assert subjects(entries, "unknown") == [
        "gazebo 'body': <zebra>",
        "gazebo 'body': <material>",
        "gazebo: <zebra>",
    ]
    assert subjects(entries, "suspicious") == [
        "gazebo 'body': <mu_1>",
        "gazebo 'body': <plugin>",
        "gazebo 'j': <preserveFixedJoints>",
        "gazebo 'ghost'",
    ]
    assert mentions(entries, "applied", "<kp>", "1e+06 N/m")
    assert mentions(entries, "unknown", "'Gazebo/Plaid'")
    assert mentions(entries, "suspicious", "<mu_1>", "<mu1>")
    assert mentions(entries, "suspicious", "<preserveFixedJoints>", "<preserveFixedJoint>")
