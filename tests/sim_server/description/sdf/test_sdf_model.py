"""SDF models become the same Models as URDF ones."""

import math

import pytest

from tests.sim_server.description.robots import find_any_file, mentions, subjects
from tests.sim_server.description.sdf_robots import (
    BALL,
    INERTIAL,
    PIONEER,
    a_joint,
    a_link,
    a_model,
    a_pose,
    an_axis,
    read,
)
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Model, Origin, Shape
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.errors import ModelError

ROBOT = """<sdf version="1.7"><model name="m" xmlns:zensim="urn:zensim">
  {word}<link name="base"><inertial><mass>1</mass></inertial></link></model></sdf>"""
WORLD = """<sdf version="1.7"><world name="w" xmlns:zensim="urn:zensim"><model name="m">
  <zensim:dynamics>auto</zensim:dynamics>
  <link name="base"><inertial><mass>1</mass></inertial></link></model></world></sdf>"""


@pytest.mark.parametrize("word", ["full", "kinematic", "auto"])
def test_model_has_the_written_dynamics(word: str) -> None:
    model = read_sdf_model(ROBOT.format(word=f"<zensim:dynamics> {word} </zensim:dynamics>"))

    assert model.dynamics == word
    assert not [entry for entry in model.report if "dynamics" in entry.subject + entry.reason]


def test_model_has_no_dynamics_by_default() -> None:
    assert read_sdf_model(ROBOT.format(word="")).dynamics == ""


def test_unknown_dynamics_are_reported() -> None:
    model = read_sdf_model(ROBOT.format(word="<zensim:dynamics>fast</zensim:dynamics>"))

    assert model.dynamics == ""
    assert mentions(model.report, "suspicious", "dynamics", "'fast'", "full, kinematic, auto")


def test_model_of_a_world_has_the_written_dynamics() -> None:
    assert read_world(WORLD).models[0].model.dynamics == "auto"


TWO = a_link("a") + a_link("b")
POINT = BALL.replace("0.1", "-0.1")


def slug_of(text: str) -> str:
    with pytest.raises(ModelError) as caught:
        read_sdf_model(text)
    return caught.value.slug


def test_sdf_robot_is_read() -> None:
    model = read_sdf_model(PIONEER)

    assert [link.name for link in model.links] == ["__model__", "left", "right"]
    assert [(frame.name, frame.parent) for frame in model.frames] == [("chassis", "__model__")]
    assert model.frames[0].origin == Origin((0.0, 0.0, 0.16))
    assert model.mass_kg == pytest.approx(6.0)
    assert isinstance(model.drive, DiffDrive)
    assert model.drive.pairs[0].diameter_m == 0.22
    assert [entry for entry in model.report if entry.status == "suspicious"] == []


def test_axis_of_version_1_4_is_in_the_model_frame() -> None:
    left = read_sdf_model(PIONEER).joints[0]

    assert left.kind == "continuous"
    assert left.axis == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    assert left.origin.position == pytest.approx((0.1, 0.17, 0.11))


def test_root_link_at_the_model_origin_is_the_root() -> None:
    assert read(a_link("base")).links[0].name == "base"


def test_link_on_a_fixed_joint_is_lumped() -> None:
    model = read(TWO, a_joint("j", ("a", "b")))

    assert (len(model.links), model.mass_kg, len(model.frames)) == (1, 4.0, 1)


def test_link_fixed_to_the_world_does_not_move() -> None:
    model = read(a_link("a"), a_joint("j", ("world", "a")))

    assert (model.is_static, model.links[0].name) == (True, "world")


def test_links_of_a_static_model_are_merged() -> None:
    parts = ("<static>true</static>", TWO, a_joint("j", ("a", "b"), "revolute", an_axis("0 0 1")))

    model = read(*parts)

    assert (model.is_static, len(model.links), model.joints) == (True, 1, ())


def test_model_without_any_inertial_has_the_default_mass() -> None:
    model = read(a_link("a", inertial=""))

    assert model.mass_kg == 1.0
    assert subjects(model.report, "suspicious") == ["model"]
    assert mentions(model.report, "suspicious", "<inertial>", "1 kg")


def test_link_without_inertial_is_massless_beside_others() -> None:
    parts = (a_link("a"), a_link("b", inertial=""), a_joint("j", ("a", "b")))

    assert read(*parts).mass_kg == 2.0


def test_nested_model_is_part_of_its_parent_model() -> None:
    nested = (
        f'<model name="arm">{a_pose("1 0 0 0 0 0")}{a_link("hand", a_pose("0 1 0 0 0 0"))}</model>'
    )

    model = read(a_link("a"), nested, a_joint("j", ("a", "arm::hand")))

    assert model.frames[0].name == "arm::hand"
    assert model.frames[0].origin.position == (1.0, 1.0, 0.0)


def test_joint_may_name_a_frame_that_is_attached_to_a_link() -> None:
    frame = '<frame name="tip" attached_to="b"><pose>0 0 1 0 0 0</pose></frame>'

    model = read(TWO, frame, a_joint("j", ("a", "tip"), "revolute", an_axis("0 0 1")))

    assert model.joints[0].child == "b"


def test_pose_of_a_spawned_model_is_ignored() -> None:
    model = read(a_pose("1 2 3 0 0 0"), a_link("base"))

    assert subjects(model.report, "ignored") == ["model: <pose>"]
    assert model.links[0].name == "base"


def test_sensor_is_read_with_its_link() -> None:
    model = read(
        a_link("base", '<sensor name="lidar" type="ray"><update_rate>5</update_rate></sensor>')
    )

    assert [(s.name, s.kind, s.link, s.update_rate_hz) for s in model.sensors] == [
        ("lidar", "ray", "base", 5.0)
    ]


def test_unsupported_geometry_is_left_out() -> None:
    hill = (
        '<collision name="c"><geometry><heightmap><uri>x</uri></heightmap></geometry></collision>'
    )

    model = read(a_link("base", hill))

    assert model.links[0].collisions == ()
    assert mentions(model.report, "suspicious", "<heightmap>")


def test_collision_keeps_its_place_size_and_friction() -> None:
    rough = "<surface><friction><ode><mu>0.3</mu></ode></friction></surface>"
    part = f'<collision name="c">{a_pose("1 0 0 0 0 0")}{BALL}{rough}</collision>'

    model = read(a_link("base", part))

    assert model.links[0].collisions == (
        Shape("sphere", (0.1, 0.0, 0.0), Origin((1.0, 0.0, 0.0)), friction=0.3, name="c"),
    )


AB, BA = ("a", "b"), ("b", "a")


def a_deep_model(depth: int) -> str:
    return '<model name="n">' * depth + a_link("x") + "</model>" * depth


@pytest.mark.parametrize(
    ("text", "slug"),
    [
        ("<sdf version='1.9'/>", "sdf.model"),
        ("<sdf version='1.9'><world name='w'/></sdf>", "sdf.model"),
        (a_model(a_link("a"))[:-6] + a_model(a_link("a"))[19:], "sdf.model"),
        (a_model(), "sdf.no_links"),
        (a_model(a_link("a"), attributes=""), "sdf.name"),
        (a_model(a_link("")), "sdf.name"),
        (a_model(a_link("world")), "sdf.name"),
        (a_model(a_link("__x__")), "sdf.name"),
        (a_model(a_link("a"), attributes='name="m" canonical_link="b"'), "sdf.canonical_link"),
        (a_model(a_link("a"), a_link("a")), "sdf.duplicate_link"),
        (a_model(TWO), "sdf.two_roots"),
        (a_model(TWO, a_joint("j", ("a", "b")), a_joint("j", ("a", "b"))), "sdf.duplicate_joint"),
        (
            a_model(TWO, *(a_joint(n, e) for n, e in zip("jkl", (AB, BA, AB), strict=True))),
            "sdf.two_parents",
        ),
        (a_model(TWO, a_joint("j", ("a", "b")), a_joint("k", ("b", "a"))), "sdf.cycle"),
        (a_model(TWO, a_joint("j", ("a", "c"))), "sdf.unknown_child"),
        (a_model(TWO, a_joint("j", ("a", "world"))), "sdf.unknown_child"),
        (a_model(TWO, a_joint("j", ("c", "b"))), "sdf.unknown_parent"),
        (a_model(TWO, a_joint("j", ("a", "b"), "screw")), "sdf.joint_type"),
        (a_model(TWO, a_joint("j", ("a", "b"), "gearbox")), "sdf.joint_type"),
        (a_model(TWO, a_joint("j", ("a", "b"), "revolute", an_axis("0 0 0"))), "sdf.axis"),
        (a_model(TWO, a_joint("j", ("a", "b"), "revolute", an_axis("0 0 nan"))), "sdf.number"),
        (a_model(a_link("a", a_pose("0 0 nan 0 0 0"))), "sdf.pose"),
        (a_model(a_link("a", a_pose("0 0 0"))), "sdf.pose"),
        (a_model(a_link("a", a_pose("1e300 0 0 0 0 0"))), "sdf.pose"),
        (a_model(a_link("a", a_pose("0 0 0 0 0 0", 'relative_to="x"'))), "sdf.unknown_frame"),
        (a_model(a_link("a", a_pose("0 0 0 0 0 0", 'relative_to="a"'))), "sdf.pose_cycle"),
        (a_model("<static>maybe</static>", a_link("a")), "sdf.flag"),
        (a_model(a_link("a", inertial=INERTIAL.replace("2", "-2"))), "sdf.mass"),
        (a_model(a_link("a", inertial=INERTIAL.replace("2", "inf"))), "sdf.number"),
        (a_model(a_link("a", inertial=INERTIAL.replace("2", "1e99"))), "sdf.number"),
        (a_model(a_link("a", f'<collision name="c">{POINT}</collision>')), "sdf.size"),
        (a_model(a_link("a", '<collision name="c"/>')), "sdf.geometry"),
        (a_model(*(a_link(f"l{i}") for i in range(501))), "sdf.size"),
        (a_model(a_deep_model(20)), "sdf.nesting"),
        (a_model(a_link("a"), *(f'<frame name="f{i}"/>' for i in range(5001))), "sdf.size"),
        (a_model("<include><uri>model://../../etc/passwd</uri></include>"), "sdf.include"),
        (a_model("<include><uri>file:///etc/passwd</uri></include>"), "sdf.include"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><sdf/>', "xml.doctype"),
        ("<sdf><model>", "xml.syntax"),
    ],
)  # fmt: skip
def test_bad_model_is_refused_by_name(text: str, slug: str) -> None:
    assert slug_of(text) == slug


def test_missing_collision_mesh_is_refused_unless_allowed() -> None:
    mesh = "<geometry><mesh><uri>model://m/a.stl</uri></mesh></geometry>"
    text = a_model(a_link("a", f'<collision name="c">{mesh}</collision>'))

    assert slug_of(text) == "mesh.missing"
    assert read_sdf_model(text, allow_missing=True).links[0].collisions == ()
    assert (
        read_sdf_model(text, find_mesh=find_any_file).links[0].collisions[0].mesh
        == "model://m/a.stl"
    )


def test_missing_visual_mesh_is_reported_once() -> None:
    mesh = "<geometry><mesh><uri>model://m/a.stl</uri></mesh></geometry>"

    model = read(a_link("a", f'<visual name="v">{mesh}</visual>'))

    assert len(subjects(model.report, "suspicious")) == 1


def test_single_model_of_a_world_is_read() -> None:
    model = a_model(a_link("a"))
    inside = "<gravity>0 0 -1</gravity>" + model[model.index("<model") : -len("</sdf>")]

    found = read_sdf_model(f'<sdf version="1.9"><world name="w">{inside}</world></sdf>')

    assert [link.name for link in found.links] == ["a"]
    assert len(subjects(found.report, "suspicious")) == 1
    assert slug_of(f'<sdf version="1.9"><world name="w">{inside * 2}</world></sdf>') == "sdf.model"


def test_unsupported_joint_has_its_result_code() -> None:
    with pytest.raises(ModelError) as caught:
        read_sdf_model(a_model(TWO, a_joint("j", ("a", "b"), "screw")))

    assert caught.value.code == SpawnCode.UNSUPPORTED_FORMAT


def test_same_text_gives_the_same_model() -> None:
    first: Model = read_sdf_model(PIONEER)

    assert first == read_sdf_model(PIONEER)


@pytest.mark.parametrize(
    ("text", "attributes"),
    [
        ("0 0 0 0 0 0", 'relative_to="mast"'),
        ("1 0 2 0 0 90", 'degrees="true"'),
        ("1 0 2 0 0 1 1", 'rotation_format="quat_xyzw"'),
    ],
)
def test_pose_of_a_sensor_may_have_attributes(text: str, attributes: str) -> None:
    sensor = f'<sensor name="s" type="imu">{a_pose(text, attributes)}</sensor>'
    mast = f'<frame name="mast">{a_pose(f"1 0 2 0 0 {math.pi / 2}")}</frame>'

    (imu,) = read(a_link("base", sensor), mast).sensors

    assert imu.origin.position == pytest.approx((1.0, 0.0, 2.0))
    assert imu.origin.orientation == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))


def test_second_shape_of_a_geometry_is_reported() -> None:
    sphere = "<sphere><radius>1</radius></sphere>"
    geometry = f'<collision name="c"><geometry>{sphere * 2}</geometry></collision>'

    report = read(a_link("base", geometry)).report

    assert any("geometry" in one for one in subjects(report, "suspicious"))


def test_placement_frame_of_a_spawned_model_is_reported() -> None:
    text = a_model(a_link("base"), attributes='name="m" placement_frame="base"')

    assert subjects(read_sdf_model(text).report, "ignored") == ["model: attribute placement_frame"]
