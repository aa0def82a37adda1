"""Unknown, unused and missing elements of URDF."""

import logging
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sim_server.description.robots import (
    BALL,
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    a_visual,
    an_inertial,
    find_any_file,
    link_names,
    mentions,
    report_of,
    subjects,
)
from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.proto.messages.model_messages import Frame, Model, Origin
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.model_geometry import find_ground_clearance
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
            a_reference("body", '<sensor type="imu" name="s"/>'),
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
    assert subjects(entries, "ignored") == ["gazebo 'j': <stopCfm>"]
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

    model = read_urdf(a_robot(a_link("a", inside)), find_mesh=find_any_file)

    assert [(shape.kind, shape.size, shape.mesh) for shape in model.links[0].collisions] == [
        ("box", (1.0, 2.0, 3.0), ""),
        ("sphere", (4.0, 0.0, 0.0), ""),
        ("cylinder", (5.0, 6.0, 0.0), ""),
        ("mesh", (1.0, 1.0, 1.0), "m.stl"),
        ("mesh", (1.0, 2.0, 3.0), "m.stl"),
    ]


def test_roll_pitch_yaw_are_about_fixed_axes() -> None:
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
def test_continuous_joint_needs_no_limit(kind: str) -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    last = read_urdf(a_robot(pair, a_joint("j", ("a", "b"), kind))).joints[-1]

    assert (last.name, last.kind) == ("j", "continuous")


@pytest.mark.parametrize(
    ("kind", "slug"),
    [("hinge", "urdf.joint_type"), ("revolute", "urdf.limit"), ("prismatic", "urdf.limit")],
)
def test_joint_is_refused_without_a_valid_type_and_limit(kind: str, slug: str) -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    with pytest.raises(ModelError, match="joint 'j'") as caught:
        read_urdf(a_robot(pair, a_joint("j", ("a", "b"), kind)))

    assert caught.value.slug == slug


def test_missing_visual_mesh_is_left_out_and_reported() -> None:
    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(MESH) + a_visual())))

    assert [shape.kind for shape in model.links[0].visuals] == ["sphere"]
    assert subjects(model.report, "suspicious") == ["link 'a', visual 1"]
    assert mentions(model.report, "suspicious", "'package://r/body.stl'")


def test_robot_is_refused_when_a_collision_mesh_is_missing() -> None:
    with pytest.raises(ModelError, match=r"package://r/body\.stl") as caught:
        read_urdf(a_robot(a_link("a", a_collision(MESH))))

    assert (caught.value.code, caught.value.slug) == (SpawnCode.MISSING_ASSETS, "mesh.missing")


def test_each_mesh_is_looked_up() -> None:
    asked: list[str] = []

    def find_mesh(uri: str) -> tuple[str, bytes]:
        asked.append(uri)
        return find_any_file(uri)

    model = read_urdf(a_robot(a_link("a", a_visual(MESH) + a_collision(MESH))), find_mesh=find_mesh)

    assert set(asked) == {"package://r/body.stl"}
    assert model.links[0].visuals[0].size == (2.0, 2.0, 2.0)


BOX_BOT = read_builtin_model("box_bot")
HOSTILE = ("", "nan", "inf", "-1", "0", "1e308", "base_link", "left_wheel_joint", "a" * 300, "${x}")


@pytest.fixture(scope="module")
def box_bot() -> Model:
    return read_urdf(BOX_BOT)


def test_box_bot_has_a_base_and_two_wheels_after_lumping(box_bot: Model) -> None:
    assert link_names(box_bot) == ["base_link", "left_wheel", "right_wheel"]
    assert [joint.kind for joint in box_bot.joints] == ["continuous", "continuous"]
    assert box_bot.mass_kg == pytest.approx(1.4, abs=1e-6)


def test_box_bot_has_the_inertia_of_its_file(box_bot: Model) -> None:
    base, left, _ = (link.inertial for link in box_bot.links)

    assert (base.mass_kg, base.com_in_link) == (1.0, (0.0, 0.0, -0.025))
    assert base.inertia == (1.667e-3, 0.0, 0.0, 1.667e-3, 0.0, 1.667e-3)
    assert left.inertia == (6.292e-5, 0.0, 0.0, 1.225e-4, 0.0, 6.292e-5)


def test_box_bot_has_friction_on_wheels_and_none_on_casters(box_bot: Model) -> None:
    base, left, right = (link.collisions for link in box_bot.links)

    assert [shape.friction for shape in base] == [1.0, 0.0, 0.0]
    assert [(shape.kind, shape.friction) for shape in (*left, *right)] == [("sphere", 1.0)] * 2


def test_box_bot_stands_on_its_wheels_when_spawned_at_6_cm(box_bot: Model) -> None:
    base = box_bot.links[0]
    casters = [s.origin.position[2] - s.size[0] for s in base.collisions if s.kind == "sphere"]

    assert find_ground_clearance(box_bot) == pytest.approx(-0.06)
    assert casters == pytest.approx([-0.0595, -0.0595])


def test_box_bot_has_its_left_joint_on_the_left(box_bot: Model) -> None:
    places = {joint.name: joint.origin.position for joint in box_bot.joints}
    drive = box_bot.drive

    assert isinstance(drive, DiffDrive)
    assert drive.pairs == (WheelPair("left_wheel_joint", "right_wheel_joint", 0.11, 0.07),)
    assert places["left_wheel_joint"] == (0.0, 0.055, -0.025)
    assert (drive.max_torque_nm, drive.max_acceleration) == (0.1, 5.0)
    assert (drive.odometry_frame, drive.robot_base_frame) == ("odom", "base_footprint")
    assert drive.publish_odom
    assert drive.publish_odom_tf
    assert drive.publish_wheel_tf


def test_box_bot_keeps_merged_links_as_frames(box_bot: Model) -> None:
    assert Frame("base_footprint", "base_link", Origin((0.0, 0.0, -0.06))) in box_bot.frames
    assert [frame.name for frame in box_bot.frames] == [
        "base_footprint",
        "chassis",
        "rgb_cam_link",
        "rgb_cam_frame",
        "front_caster",
        "back_caster",
    ]


def test_box_bot_has_a_colour_on_every_visual(box_bot: Model) -> None:
    colours = [shape.rgba for link in box_bot.links for shape in link.visuals]

    assert None not in colours
    assert len(set(colours)) >= 5


def test_parser_neither_prints_nor_logs(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG):
        read_urdf(BOX_BOT)

    assert capfd.readouterr() == ("", "")
    assert caplog.records == []


def test_reading_the_same_text_twice_gives_equal_models() -> None:
    assert read_urdf(BOX_BOT) == read_urdf(BOX_BOT)


def test_negative_limits_of_a_joint_are_none() -> None:
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="-1.0" velocity="-1.0"/>'

    (joint,) = read_urdf(
        a_robot(a_link("a"), a_link("b"), a_joint("j", ("a", "b"), "revolute", limit))
    ).joints

    assert (joint.effort, joint.velocity) == (0.0, 0.0)


def test_xacro_macro_is_refused() -> None:
    text = (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:macro name="m"/><link name="a"/></robot>'
    )

    with pytest.raises(ModelError, match="run xacro") as caught:
        read_urdf(text)

    assert caught.value.slug == "urdf.xacro"


@pytest.mark.parametrize(
    "link",
    [
        '<link name="${prefix}a"/>',
        '<link name="a"><visual><origin xyz="0 0 $(arg height)"/></visual></link>',
        '<xacro:macro name="m"/><link name="a"/>',
    ],
)
def test_xacro_is_refused_when_an_expression_is_left(link: str) -> None:
    with pytest.raises(ModelError) as caught:
        read_urdf(f'<robot name="r">{link}</robot>')

    assert caught.value.slug == "urdf.xacro"


def test_expanded_xacro_is_read_when_only_its_namespace_is_left() -> None:
    text = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/></robot>'

    assert link_names(read_urdf(text)) == ["a"]


def read_or_refusal(text: str) -> Model | ModelError:
    try:
        return read_urdf(text)
    except ModelError as refusal:
        return refusal


def assert_model_or_refusal(text: str) -> None:
    model = read_or_refusal(text)
    if isinstance(model, ModelError):
        assert model.message
        assert "\n" not in model.message
        return
    numbers = [n for link in model.links for n in (*link.inertial.inertia, link.inertial.mass_kg)]
    assert all(map(math.isfinite, numbers))


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_truncated_file_is_read_or_refused(data: st.DataObject) -> None:
    tags = [i for i, character in enumerate(BOX_BOT) if character == "<"]
    start, end = sorted(data.draw(st.tuples(st.sampled_from(tags), st.sampled_from(tags))))

    assert_model_or_refusal(BOX_BOT[:start] + BOX_BOT[end:])


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_hostile_value_is_read_or_refused(data: st.DataObject) -> None:
    quoted = BOX_BOT.split('"')
    place = data.draw(st.integers(0, len(quoted) // 2 - 1)) * 2 + 1
    quoted[place] = data.draw(st.sampled_from(HOSTILE) | st.text(max_size=5))

    assert_model_or_refusal('"'.join(quoted))


@settings(deadline=None, max_examples=50)
@given(st.text(alphabet='<>/="& robotlinkjointgazebo!-?[]', max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    assert_model_or_refusal(text)


MIRRORED_MESH = '<geometry><mesh filename="package://r/body.stl" scale="-1 1 1"/></geometry>'


def test_capsule_is_read_when_a_link_has_one() -> None:
    capsule = '<geometry><capsule radius="0.1" length="0.4"/></geometry>'

    (shape,) = read_urdf(a_robot(a_link("a", a_collision(capsule)))).links[0].collisions

    assert (shape.kind, shape.size) == ("capsule", (0.1, 0.4, 0.0))


def test_first_shape_is_used_when_a_geometry_has_two() -> None:
    two = '<geometry><sphere radius="0.1"/><box size="1 1 1"/></geometry>'

    model = read_urdf(a_robot(a_link("a", a_visual(two))))

    assert [shape.kind for shape in model.links[0].visuals] == ["sphere"]
    assert mentions(model.report, "suspicious", "link 'a', visual, geometry", "2")


def test_each_visual_is_reported_once_when_its_mesh_is_missing() -> None:
    model = read_urdf(
        a_robot(a_link("a", a_visual(MIRRORED_MESH) * 2 + a_visual()), name_of_others())
    )

    missing = [entry.subject for entry in model.report if "body.stl" in entry.reason]
    assert missing == ["link 'a', visual 1", "link 'a', visual 2", "link 'b', visual"]


def name_of_others() -> str:
    joint = '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
    return a_link("b", a_visual(MIRRORED_MESH)) + joint


def test_visual_is_not_drawn_when_its_size_is_0() -> None:
    dot = '<geometry><sphere radius="0"/></geometry>'

    model = read_urdf(a_robot(a_link("a", a_visual(dot) + a_visual())))

    assert len(model.links[0].visuals) == 1
    assert mentions(model.report, "suspicious", "link 'a', visual 1", "sphere", "0")


def test_mesh_may_be_mirrored_when_its_scale_is_negative() -> None:
    model = read_urdf(a_robot(a_link("a", a_visual(MIRRORED_MESH))), find_mesh=find_any_file)

    assert model.links[0].visuals[0].size == (-1.0, 1.0, 1.0)


def test_missing_collision_mesh_is_left_out_only_when_allowed() -> None:
    text = a_robot(a_link("a", a_collision(MIRRORED_MESH) + a_collision(BALL)))

    with pytest.raises(ModelError) as caught:
        read_urdf(text)
    model = read_urdf(text, allow_missing=True)

    assert (caught.value.code, caught.value.slug) == (SpawnCode.MISSING_ASSETS, "mesh.missing")
    assert [shape.kind for shape in model.links[0].collisions] == ["sphere"]
    assert mentions(model.report, "suspicious", "link 'a'", "collision", "body.stl")


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
        (a_robot(a_link("a", "<inertial><mass/></inertial>")), "urdf.value"),
        (a_robot(a_link("a", "<collision/>")), "urdf.geometry"),
        (a_robot(a_link("a", a_collision("<geometry/>"))), "urdf.geometry"),
        (a_robot(a_link("a", a_collision("<geometry><torus/></geometry>"))), "urdf.geometry"),
        (a_robot(a_link("a", a_collision("<geometry><box/></geometry>"))), "urdf.size"),
        (a_robot(a_link("a", a_collision("<geometry><mesh/></geometry>"))), "urdf.filename"),
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
        a_collision('<geometry><mesh filename="m.stl" scale="1 1"/></geometry>'),
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
        "robot: <zebra>",
    ]
    assert subjects(entries, "ignored") == [
        "joint 'j': <joint_properties>",
        "joint 'j', axis: attribute rpy",
    ]
    assert mentions(entries, "suspicious", "robot: <lnk>", "<link>")


def test_elements_without_effect_are_reported() -> None:
    joint = a_joint("j", ("a", "b"), "continuous", '<calibration rising="0"/>')

    entries = report_of(a_robot(PAIR, joint, '<sensor name="s"><any x="y"/></sensor>'))

    assert [entry.subject for entry in entries if entry.status == "ignored"] == [
        "joint 'j': <calibration>",
        "robot: <sensor>",
    ]


def test_first_tag_is_used_when_it_is_repeated() -> None:
    second = '<inertia ixx="9" iyy="9" izz="9"/></inertial>'
    link = a_link("a", an_inertial().replace("</inertial>", second))

    model = read_urdf(a_robot(link))

    assert model.links[0].inertial.inertia[0] == 0.1
    assert subjects(model.report, "suspicious") == ["link 'a', inertial, inertia"]


SPRING = "<springStiffness>30</springStiffness><springReference>-0.5</springReference>"


def sprung(block: str, kind: str = "continuous") -> Model:
    limit = '<limit lower="0" upper="1" effort="1" velocity="1"/>'
    arm = a_link("arm", an_inertial()) + a_joint("j", ("body", "arm"), kind, limit)
    return read_urdf(a_robot(BODY, arm, a_reference("j", block)))


@pytest.mark.parametrize("kind", ["continuous", "revolute", "prismatic"])
def test_spring_of_a_joint_is_read(kind: str) -> None:
    model = sprung(SPRING, kind)

    assert [(j.spring_stiffness, j.spring_reference) for j in model.joints] == [(30.0, -0.5)]
    assert mentions(model.report, "applied", "gazebo 'j': <springStiffness>")


@pytest.mark.parametrize(
    ("block", "status"),
    [
        ("<springReference>1</springReference>", "ignored"),
        ("<springStiffness>0</springStiffness>", "ignored"),
        ("<springStiffness>-3</springStiffness>", "suspicious"),
        ("<springStiffness>stiff</springStiffness>", "suspicious"),
        ("<springStiffness>1e200</springStiffness>", "suspicious"),
    ],
)
def test_spring_without_a_usable_stiffness_is_left_out(block: str, status: str) -> None:
    model = sprung(block)

    assert model.joints[0].spring_stiffness == 0.0
    assert mentions(model.report, status, "gazebo 'j': <springStiffness>")


def test_spring_of_a_fixed_joint_is_left_out() -> None:
    model = sprung(SPRING, "fixed")

    assert mentions(model.report, "ignored", "gazebo 'j': <springStiffness>")


def test_implicit_spring_damper_has_no_effect_of_its_own() -> None:
    model = sprung("<implicitSpringDamper>1</implicitSpringDamper>")

    assert mentions(model.report, "ignored", "gazebo 'j': <implicitSpringDamper>")


UNSEEN = [
    a_visual('<geometry><box size="0 0 0"/></geometry>'),
    a_visual('<geometry><cylinder radius="1" length="0"/></geometry>'),
    a_visual('<geometry><box size="-1 1 1"/></geometry>'),
    a_visual('<geometry><mesh filename="m.stl" scale="1 0 1"/></geometry>'),
    a_visual('<geometry><mesh filename="m.stl" scale="1 1"/></geometry>'),
    a_visual("<geometry><torus/></geometry>"),
    a_visual("<geometry><mesh/></geometry>"),
    a_visual("<geometry/>"),
    a_visual(BALL, '<origin xyz="0 0"/>'),
    "<visual/>",
]


@pytest.mark.parametrize("visual", UNSEEN)
def test_visual_with_a_fault_is_left_out(visual: str) -> None:
    model = read_urdf(a_robot(a_link("a", an_inertial() + visual)), find_mesh=find_any_file)

    assert model.links[0].visuals == ()
    assert mentions(model.report, "suspicious", "link 'a', visual")


@pytest.mark.parametrize(
    "geometry",
    [
        '<box size="0 0 0"/>',
        '<sphere radius="0"/>',
        '<cylinder radius="0.2" length="0.0"/>',
        '<ellipsoid radii="0 1 1"/>',
        '<mesh filename="m.stl" scale="1 0 1"/>',
    ],
)
def test_collision_without_extent_is_left_out(geometry: str) -> None:
    sonar = a_link("sonar", an_inertial() + a_collision(f"<geometry>{geometry}</geometry>"))

    model = read_urdf(a_robot(sonar), find_mesh=find_any_file)

    assert model.links[0].collisions == ()
    assert mentions(model.report, "suspicious", "link 'sonar', collision")


@pytest.mark.parametrize(("scale", "size"), [("2 3 4 1", (2.0, 3.0, 4.0)), ("", (1.0, 1.0, 1.0))])
def test_unusual_scale_of_a_mesh_is_read_with_a_warning(
    scale: str, size: tuple[float, float, float]
) -> None:
    mesh = f'<geometry><mesh filename="m.stl" scale="{scale}"/></geometry>'

    model = read_urdf(a_robot(a_link("a", a_visual(mesh))), find_mesh=find_any_file)

    assert model.links[0].visuals[0].size == size
    assert mentions(model.report, "suspicious", "link 'a', visual", "scale")


def test_colour_with_a_fault_leaves_its_visual() -> None:
    material = '<material name="m"><color rgba="1 1"/></material>'

    model = read_urdf(a_robot(a_link("a", a_visual(BALL, material))))

    assert [shape.rgba for shape in model.links[0].visuals] == [None]
    assert mentions(model.report, "suspicious", "link 'a', visual, material")


@pytest.mark.parametrize(
    "inside", ['<calibration rising="up"/>', '<safety_controller k_velocity=""/>']
)
def test_numbers_that_nothing_reads_are_not_checked(inside: str) -> None:
    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "continuous", inside)))

    assert len(model.joints) == 1


@pytest.mark.parametrize("inside", ['<limit lower="" upper=""/>', '<dynamics damping=""/>'])
def test_empty_number_is_the_default(inside: str) -> None:
    model = read_urdf(a_robot(PAIR, a_joint("j", ("a", "b"), "continuous", inside)))

    assert model.joints[0].damping == 0.0
    assert mentions(model.report, "suspicious", "joint 'j'", "empty")


def test_mass_without_inertia_is_read() -> None:
    model = read_urdf(a_robot(a_link("a", '<inertial><mass value="2"/></inertial>')))

    assert model.mass_kg == 2.0
    assert mentions(model.report, "suspicious", "link 'a'", "inertia")


VISUAL_BLOCK = "<visual><material>{}</material></visual>"


@pytest.mark.parametrize(
    ("inside", "colour"),
    [
        ("<script><name>Gazebo/Green</name></script>", (0.0, 1.0, 0.0, 1.0)),
        ("<diffuse>0.1 0.2 0.3 1</diffuse>", (0.1, 0.2, 0.3, 1.0)),
        ("<ambient>0.5 0.5 0.5 1</ambient>", (0.5, 0.5, 0.5, 1.0)),
        ("<specular>1 1 1 1</specular>", None),
        ("<diffuse>red</diffuse>", None),
    ],
)
def test_visual_of_a_gazebo_block_colours_its_link(
    inside: str, colour: tuple[float, float, float, float] | None
) -> None:
    block = a_reference("a", VISUAL_BLOCK.format(inside))

    model = read_urdf(a_robot(a_link("a", a_visual()), block))

    assert model.links[0].visuals[0].rgba == colour


def test_material_of_a_gazebo_block_overrides_its_visual() -> None:
    green = VISUAL_BLOCK.format("<script><name>Gazebo/Green</name></script>")
    block = a_reference("a", f"{green}<material>Gazebo/Red</material>")

    model = read_urdf(a_robot(a_link("a", a_visual()), block))

    assert model.links[0].visuals[0].rgba == (1.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "tag", ["laserRetro", "projector", "light", "canonicalBody", "controller:diff", "geom:box"]
)
def test_known_gazebo_tags_without_effect_are_ignored(tag: str) -> None:
    entries = report_of(a_robot(BODY, a_reference("body", f"<{tag}/>")))

    assert subjects(entries, "unknown") == []
    assert len(subjects(entries, "ignored")) == 1
