"""Colours and surface tags: values, limits and report entries."""

import pytest

from tests.sim_server.description.robots import (
    BALL,
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    a_visual,
    an_inertial,
    mentions,
    subjects,
)
from zensim.proto.messages.model_messages import (
    Contact,
    Decay,
    Inertial,
    Link,
    Origin,
    Quat,
    Shape,
    Texture,
)
from zensim.sim_server.description.joint_reduction import lump_fixed_joints
from zensim.sim_server.description.link_surfaces import (
    GAZEBO_COLOURS,
    RIGID_STIFFNESS,
    SurfaceParameters,
    SurfaceTagReader,
    clamp_contact,
    find_gazebo_colour,
    to_decay_rate,
)
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

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


def test_undefined_material_is_reported() -> None:
    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(BALL, USE_RED))))

    assert model.links[0].visuals[0].rgba is None
    assert subjects(model.report, "suspicious") == ["material 'red'"]


@pytest.mark.parametrize("where", ["visual", "robot"])
def test_texture_of_a_material_is_read(where: str) -> None:
    material = '<material name="m"><texture filename="t.png"/></material>'
    visual = a_visual(BALL, material if where == "visual" else '<material name="m"/>')
    link = a_link("a", an_inertial() + visual)

    model = read_urdf(a_robot(link + (material if where == "robot" else "")))

    assert model.links[0].visuals[0].texture == Texture("t.png")
    assert model.report == ()


def test_colour_is_clamped_when_it_is_out_of_range() -> None:
    material = '<material name="m"><color rgba="255 0 -1 1"/></material>'

    model = read_urdf(a_robot(a_link("a", an_inertial() + a_visual(BALL, material))))

    assert model.links[0].visuals[0].rgba == (1.0, 0.0, 0.0, 1.0)
    assert len(subjects(model.report, "suspicious")) == 1


def test_gazebo_material_overrides_the_urdf_material() -> None:
    block = a_reference("a", "<material>Gazebo/Blue</material>")

    assert colours(a_link("a", a_visual(BALL, RED)), block) == [(0.0, 0.0, 1.0, 1.0)]


@pytest.mark.parametrize("name", ["Gazebo/Green", " Gazebo/Green\n", "Green"])
def test_gazebo_colour_is_found_with_and_without_its_prefix(name: str) -> None:
    assert find_gazebo_colour(name) == (0.0, 1.0, 0.0, 1.0)


def test_gazebo_colours_lie_between_0_and_1() -> None:
    assert all(0.0 <= part <= 1.0 for rgba in GAZEBO_COLOURS.values() for part in rgba)
    assert find_gazebo_colour("Gazebo/Plaid") is None


def read(**texts: str) -> tuple[SurfaceParameters, ParseReport]:
    report = ParseReport()
    return SurfaceTagReader(texts, subject="s", slug="gazebo.mu1", report=report).read(), report


def test_surface_is_the_default_without_tags() -> None:
    surface, report = read()

    assert surface == SurfaceParameters()
    assert report.entries() == ()


@pytest.mark.parametrize(
    ("kp", "kd", "contact"),
    [
        ("1e5", None, Contact(1e5, 1.0)),
        ("1e5", "50", Contact(1e5, 50.0)),
        ("1000", "1000", Contact(1e3, 1e3)),
        ("1000", "1e9", Contact(1e3, 1e3)),
        ("1e12", "1", Contact()),
        ("1e12", None, Contact()),
        ("1e27", "1e27", Contact(RIGID_STIFFNESS, RIGID_STIFFNESS)),
        ("0", "5", Contact()),
        (None, "5", Contact()),
        ("stiff", "5", Contact()),
        ("-5", None, Contact()),
    ],
)
def test_contact_has_the_written_stiffness_within_limits(
    kp: str | None, kd: str | None, contact: Contact
) -> None:
    written = {tag: text for tag, text in (("kp", kp), ("kd", kd)) if text is not None}

    assert read(**written)[0].contact == contact


def test_clamped_contact_keeps_its_time_constant() -> None:
    assert clamp_contact(1e27, 1e25) == pytest.approx((RIGID_STIFFNESS, 0.01 * RIGID_STIFFNESS))


@pytest.mark.parametrize(
    ("texts", "status", "tag", "value"),
    [
        ({"kp": "1e27"}, "suspicious", "kp", "1e+09"),
        ({"kp": "0"}, "suspicious", "kp", "0"),
        ({"kd": "1"}, "ignored", "kd", "<kp>"),
        ({"kp": "x"}, "suspicious", "kp", "'x'"),
        ({"kp": "-1"}, "suspicious", "kp", "-1"),
        ({"mu2": "1"}, "applied", "mu2", ""),
        ({"mu1": "1", "mu2": "0.5"}, "applied", "mu2", "0.75"),
        ({"fdir1": "1 0 0"}, "ignored", "fdir1", "<mu2>"),
        ({"gravity": "maybe"}, "suspicious", "gravity", "'maybe'"),
        ({"gravity": "0"}, "applied", "gravity", "without"),
        ({"turnGravityOff": "false"}, "applied", "turnGravityOff", ""),
        ({"selfCollide": "1"}, "applied", "selfCollide", ""),
        ({"dampingFactor": "0.01"}, "applied", "dampingFactor", "1 %"),
        ({"minDepth": "0.001"}, "ignored", "minDepth", ""),
        ({"maxVel": "0.1"}, "ignored", "maxVel", ""),
    ],
)
def test_report_lists_the_effect_of_a_tag(
    texts: dict[str, str], status: str, tag: str, value: str
) -> None:
    assert mentions(read(**texts)[1].entries(), status, f"s: <{tag}>: ", value)


def test_friction_has_a_direction_only_when_mu1_and_mu2_differ() -> None:
    surface, _ = read(mu1="1", mu2="0.5", fdir1="0 0 2")

    assert (surface.friction, surface.contact.friction_across) == (1.0, 0.5)
    assert surface.contact.direction == (0.0, 0.0, 1.0)
    assert read(mu1="1", mu2="1", fdir1="0 0 2")[0].contact == Contact()
    assert read(mu1="1", mu2="0.5", fdir1="0 0 0")[0].friction == 0.75


@pytest.mark.parametrize("tag", ["kp", "mu2", "fdir1", "gravity", "selfCollide", "dampingFactor"])
def test_robot_is_read_when_a_surface_tag_is_invalid(tag: str) -> None:
    body = a_link("body", an_inertial() + a_collision())

    model = read_urdf(a_robot(body, a_reference("body", f"<{tag}>nonsense</{tag}>")))

    assert model.links[0].collisions[0].contact == Contact()
    assert len(subjects(model.report, "suspicious")) == 1


def test_friction_direction_rotates_with_collision_and_link() -> None:
    quarter = '<origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>'
    parts = (
        a_link("body", an_inertial()),
        a_link("foot", a_collision(origin=quarter)),
        a_joint("j", ("body", "foot"), inside=quarter),
        a_reference("foot", "<mu1>1</mu1><mu2>0</mu2><fdir1>1 0 0</fdir1>"),
    )

    (shape,) = read_urdf(a_robot(*parts)).links[0].collisions

    assert shape.contact.direction == pytest.approx((-1.0, 0.0, 0.0))


def test_merged_link_combines_gravity_decay_and_self_collision() -> None:
    light = Inertial(1.0, (1.0, 0.0, 0.0))
    links = (
        Link("body", Inertial(3.0)),
        Link("tip", light, weightless=light, decay=Decay(8.0, 4.0), self_collides=True),
    )
    parts = (
        a_link("body", an_inertial()),
        a_link("tip", an_inertial()),
        a_joint("j", ("body", "tip"), inside='<origin xyz="0 0 1"/>'),
    )
    joints = read_urdf(
        a_robot(*parts, a_reference("j", "<preserveFixedJoint>true</preserveFixedJoint>"))
    ).joints

    (merged,) = lump_fixed_joints(links, joints, frozenset()).links

    assert (merged.weightless.mass_kg, merged.weightless.com_in_link) == (1.0, (1.0, 0.0, 1.0))
    assert merged.decay == Decay(2.0, 1.0)
    assert merged.self_collides


def test_decay_rate_is_finite() -> None:
    assert to_decay_rate(0.0) == 0.0
    assert 1e4 < to_decay_rate(1.0) == to_decay_rate(5.0) < 1e5
    assert SurfaceParameters().apply_to_shape(Shape("box", origin=Origin())) == Shape("box")


@pytest.mark.parametrize(
    ("texts", "restitution", "threshold"),
    [
        ({"restitution_coefficient": "0.8", "threshold": "0.1"}, 0.8, 0.1),
        ({"restitution_coefficient": "0.8"}, 0.8, 0.0),
        ({"restitution_coefficient": "0.8", "threshold": "100000"}, 0.0, 0.0),
        ({"restitution_coefficient": "3"}, 1.0, 0.0),
        ({"restitution_coefficient": "0"}, 0.0, 0.0),
        ({"restitution_coefficient": "-1"}, None, 0.0),
        ({"threshold": "1"}, None, 0.0),
    ],
)
def test_restitution_is_read_with_its_threshold(
    texts: dict[str, str], restitution: float | None, threshold: float
) -> None:
    contact = read(**texts)[0].contact

    assert (contact.restitution, contact.bounce_threshold) == (restitution, threshold)


def test_surface_of_a_collision_block_of_urdf_is_that_of_sdf() -> None:
    bounce = (
        "<bounce><restitution_coefficient>0.5</restitution_coefficient>"
        "<threshold>0.2</threshold></bounce>"
    )
    friction = "<friction><ode><mu>0.3</mu></ode></friction>"
    surface = f"<surface>{bounce}{friction}</surface>"
    block = f"<collision>{surface}<max_contacts>3</max_contacts></collision>"

    model = read_urdf(a_robot(a_link("a", an_inertial() + a_collision()), a_reference("a", block)))

    shape = model.links[0].collisions[0]
    assert (shape.friction, shape.contact.restitution, shape.contact.bounce_threshold) == (
        0.3,
        0.5,
        0.2,
    )
    assert "gazebo 'a', collision: <max_contacts>" in subjects(model.report, "ignored")
