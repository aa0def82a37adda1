"""Tags of surfaces: what each comes to, and what the report says of it."""

import pytest

from tests.sim_server.description.robots import (
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    an_inertial,
    reasons,
)
from zensim.proto.messages.model_messages import Contact, Decay, Inertial, Link, Origin, Shape
from zensim.sim_server.description.lumping import lump
from zensim.sim_server.description.report import Report
from zensim.sim_server.description.surface import RIGID, Surface, SurfaceTags, decay_rate, in_bounds
from zensim.sim_server.description.urdf import read_urdf


def read(**texts: str) -> tuple[Surface, Report]:
    report = Report()
    return SurfaceTags(texts, subject="s", slug="gazebo.mu1", report=report).read(), report


def test_nothing_is_asked_for_when_nothing_is_written() -> None:
    surface, report = read()

    assert surface == Surface()
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
        ("1e27", "1e27", Contact(RIGID, RIGID)),
        ("0", "5", Contact()),
        (None, "5", Contact()),
        ("stiff", "5", Contact()),
        ("-5", None, Contact()),
    ],
)
def test_contact_gives_as_it_says_within_bounds(
    kp: str | None, kd: str | None, contact: Contact
) -> None:
    written = {tag: text for tag, text in (("kp", kp), ("kd", kd)) if text is not None}

    assert read(**written)[0].contact == contact


def test_bounds_keep_how_long_a_contact_takes() -> None:
    assert in_bounds(1e27, 1e25) == pytest.approx((RIGID, 0.01 * RIGID))


@pytest.mark.parametrize(
    ("texts", "status", "said"),
    [
        ({"kp": "1e27"}, "suspicious", "s: <kp>: 1e27 is stiffer than anything; taken as 1e+09"),
        ({"kp": "0"}, "suspicious", "s: <kp>: 0 would hold nothing up; rigid"),
        ({"kd": "1"}, "ignored", "s: <kd>: needs a <kp>; without it contacts are rigid"),
        ({"kp": "x"}, "suspicious", "s: <kp>: 'x' is no number; not used"),
        ({"kp": "-1"}, "suspicious", "s: <kp>: -1 is negative; not used"),
        ({"mu2": "1"}, "applied", "s: <mu2>: "),
        (
            {"mu1": "1", "mu2": "0.5"},
            "applied",
            "s: <mu2>: there is no <fdir1>: 0.75 every way, the mean of mu1 and mu2",
        ),
        ({"fdir1": "1 0 0"}, "ignored", "s: <fdir1>: needs a <mu1> and a <mu2> that differ"),
        ({"gravity": "maybe"}, "suspicious", "s: <gravity>: 'maybe' is neither true nor false"),
        ({"gravity": "0"}, "applied", "s: <gravity>: gravity does not pull it"),
        ({"turnGravityOff": "false"}, "applied", "s: <turnGravityOff>: "),
        ({"selfCollide": "1"}, "applied", "s: <selfCollide>: "),
        (
            {"dampingFactor": "0.01"},
            "applied",
            "s: <dampingFactor>: velocities lose 1 % in a millisecond",
        ),
        (
            {"minDepth": "0.001"},
            "ignored",
            "s: <minDepth>: what has sunk in is pushed out from depth 0 on",
        ),
        (
            {"maxVel": "0.1"},
            "ignored",
            "s: <maxVel>: what has sunk in is pushed out by a fifth of its depth each step, "
            "at any speed",
        ),
    ],
)
def test_report_says_what_became_of_a_tag(texts: dict[str, str], status: str, said: str) -> None:
    assert said in reasons(read(**texts)[1].entries(), status)


def test_friction_has_a_direction_only_where_it_differs() -> None:
    surface, _ = read(mu1="1", mu2="0.5", fdir1="0 0 2")

    assert (surface.friction, surface.contact.friction_across) == (1.0, 0.5)
    assert surface.contact.direction == (0.0, 0.0, 1.0)
    assert read(mu1="1", mu2="1", fdir1="0 0 2")[0].contact == Contact()
    assert read(mu1="1", mu2="0.5", fdir1="0 0 0")[0].friction == 0.75


@pytest.mark.parametrize("tag", ["kp", "mu2", "fdir1", "gravity", "selfCollide", "dampingFactor"])
def test_robot_is_read_whatever_a_tag_holds(tag: str) -> None:
    body = a_link("body", an_inertial() + a_collision())

    model = read_urdf(a_robot(body, a_reference("body", f"<{tag}>nonsense</{tag}>")))

    assert model.links[0].collisions[0].contact == Contact()
    assert len(reasons(model.report, "suspicious")) == 1


def test_direction_turns_with_its_collision_and_with_its_link() -> None:
    quarter = '<origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>'
    parts = (
        a_link("body", an_inertial()),
        a_link("foot", a_collision(origin=quarter)),
        a_joint("j", ("body", "foot"), inside=quarter),
        a_reference("foot", "<mu1>1</mu1><mu2>0</mu2><fdir1>1 0 0</fdir1>"),
    )

    (shape,) = read_urdf(a_robot(*parts)).links[0].collisions

    assert shape.contact.direction == pytest.approx((-1.0, 0.0, 0.0))


def test_merged_links_weigh_slow_down_and_touch_as_their_parts_do() -> None:
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

    (merged,) = lump(links, joints, frozenset()).links

    assert (merged.weightless.mass_kg, merged.weightless.com_in_link) == (1.0, (1.0, 0.0, 1.0))
    assert merged.decay == Decay(2.0, 1.0)
    assert merged.self_collides


def test_share_of_everything_is_lost_at_a_finite_rate() -> None:
    assert decay_rate(0.0) == 0.0
    assert 1e4 < decay_rate(1.0) == decay_rate(5.0) < 1e5
    assert Surface().on(Shape("box", origin=Origin())) == Shape("box")
