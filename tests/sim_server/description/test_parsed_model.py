"""Trees of links, and checks of masses, sizes, moments and axes."""

import pytest

from tests.sim_server.description.robots import (
    BALL,
    a_collision,
    a_joint,
    a_link,
    a_robot,
    a_visual,
    an_inertial,
    link_names,
    mentions,
    report_of,
    subjects,
)
from zensim.proto.messages.model_messages import Inertial
from zensim.sim_server.description.parsed_model import MAX_LINKS, find_principal_moments
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError


def links(*names: str) -> str:
    return "".join(a_link(name, an_inertial()) for name in names)


@pytest.mark.parametrize(
    ("text", "slug", "named"),
    [
        (a_robot(), "urdf.no_links", "links"),
        (a_robot(links("a", "b")), "urdf.two_roots", "'a', 'b'"),
        (a_robot(links("a", "a")), "urdf.duplicate_link", "'a'"),
        (
            a_robot(links("a", "b", "c"), a_joint("j", ("a", "b")), a_joint("j", ("a", "c"))),
            "urdf.duplicate_joint",
            "'j'",
        ),
        (a_robot(links("a"), a_joint("j", ("z", "a"))), "urdf.unknown_parent", "'z'"),
        (a_robot(links("a"), a_joint("j", ("a", "z"))), "urdf.unknown_child", "'z'"),
        (a_robot(links("a"), a_joint("j", ("a", "a"))), "urdf.cycle", "'a'"),
        (
            a_robot(links("a", "b"), a_joint("j", ("a", "b")), a_joint("k", ("b", "a"))),
            "urdf.cycle",
            "cycle",
        ),
        (
            a_robot(links("a", "b", "c"), a_joint("j", ("b", "c")), a_joint("k", ("c", "b"))),
            "urdf.cycle",
            "'b', 'c'",
        ),
        (
            a_robot(links("a", "b", "c"), a_joint("j", ("a", "c")), a_joint("k", ("b", "c"))),
            "urdf.two_parents",
            "'c'",
        ),
    ],
)
def test_links_are_refused_when_they_form_no_tree(text: str, slug: str, named: str) -> None:
    with pytest.raises(ModelError, match=named) as caught:
        read_urdf(text)

    assert caught.value.slug == slug


def test_tree_is_refused_when_it_is_huge() -> None:
    names = [f"l{i}" for i in range(MAX_LINKS + 1)]

    with pytest.raises(ModelError) as caught:
        read_urdf(a_robot(links(*names)))

    assert caught.value.slug == "urdf.size"
    assert len(caught.value.message) < 200


def test_tree_names_only_some_links_when_many_are_roots() -> None:
    with pytest.raises(ModelError, match="'e' and 3 more") as caught:
        read_urdf(a_robot(links(*"abcdefgh")))

    assert caught.value.slug == "urdf.two_roots"


def test_links_are_in_tree_order() -> None:
    joints = (
        a_joint("to_leaf", ("middle", "leaf"), "continuous"),
        a_joint("to_other", ("root", "other"), "continuous"),
        a_joint("to_middle", ("root", "middle"), "continuous"),
    )

    model = read_urdf(a_robot(links("leaf", "other", "middle", "root"), *joints))

    assert link_names(model) == ["root", "other", "middle", "leaf"]
    assert [joint.child for joint in model.joints] == ["other", "middle", "leaf"]


def slug_of(text: str) -> str:
    with pytest.raises(ModelError) as caught:
        read_urdf(text)
    return caught.value.slug


def moments(ixx: float, iyy: float, izz: float, ixy: float = 0.0) -> str:
    return (
        f'<inertial><mass value="1"/><inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}"/>'
        "</inertial>"
    )


@pytest.mark.parametrize(
    ("inside", "slug"),
    [
        (an_inertial(mass="-1"), "urdf.mass"),
        (an_inertial(mass="1e300"), "urdf.number"),
        (a_collision('<geometry><box size="1 1 -1"/></geometry>'), "urdf.size"),
        (a_visual('<geometry><sphere radius="1e200"/></geometry>'), "urdf.number"),
        (a_visual(BALL, '<origin xyz="1e200 0 0"/>'), "urdf.number"),
    ],
)
def test_link_is_refused_when_a_value_is_invalid(inside: str, slug: str) -> None:
    assert slug_of(a_robot(a_link("a", inside))) == slug


def test_moment_rounded_below_zero_is_zero() -> None:
    text = a_robot(a_link("a", moments(-5.4e-20, -5.4e-20, 0.0)))

    assert subjects(report_of(text), "suspicious") == ["link 'a'"]


def test_negative_moments_are_left_out() -> None:
    model = read_urdf(a_robot(a_link("a", an_inertial(diagonal="-1"))))

    assert model.links[0].inertial == Inertial(1.0)
    assert subjects(model.report, "suspicious") == ["link 'a'"]


def test_joint_is_refused_when_its_axis_is_zero() -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    slug = slug_of(a_robot(pair, a_joint("j", ("a", "b"), "continuous", '<axis xyz="0 0 0"/>')))

    assert slug == "urdf.axis"


def test_negative_damping_and_friction_are_left_out() -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())
    inside = '<dynamics damping="-1" friction="-0.1"/>'

    model = read_urdf(a_robot(pair, a_joint("j", ("a", "b"), "continuous", inside)))

    assert (model.joints[0].damping, model.joints[0].friction) == (0.0, 0.0)
    assert subjects(model.report, "suspicious") == ["joint 'j'"]


@pytest.mark.parametrize(
    ("inertia", "principal"),
    [
        ((1.0, 0.0, 0.0, 3.0, 0.0, 2.0), (1.0, 2.0, 3.0)),
        ((2.0, 1.0, 0.0, 2.0, 0.0, 5.0), (1.0, 3.0, 5.0)),
        ((1.0, 0.0, 0.0, 1.0, 0.0, 1.0), (1.0, 1.0, 1.0)),
        ((0.0, 1.0, 1.0, 0.0, 1.0, 0.0), (-1.0, -1.0, 2.0)),
    ],
)
def test_principal_moments_are_the_eigenvalues(
    inertia: tuple[float, float, float, float, float, float], principal: tuple[float, float, float]
) -> None:
    assert find_principal_moments(inertia) == pytest.approx(principal, abs=1e-9)


def test_axis_of_a_joint_is_normalized() -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())

    model = read_urdf(a_robot(pair, a_joint("j", ("a", "b"), "continuous", '<axis xyz="0 3 -4"/>')))

    assert model.joints[0].axis == pytest.approx((0.0, 0.6, -0.8))


def test_fixed_joint_may_have_a_zero_axis() -> None:
    pair = a_link("a", an_inertial()) + a_link("b")

    model = read_urdf(a_robot(pair, a_joint("j", ("a", "b"), "fixed", '<axis xyz="0 0 0"/>')))

    assert len(model.links) == 1


@pytest.mark.parametrize(
    ("inertial", "noted"),
    [
        (moments(1, 1, 2), 0),
        (moments(1, 1, 2.0005), 0),
        (moments(1, 1, 3), 1),
        (moments(1, 1, 1, ixy=2), 1),
        (moments(0, 0, 0), 1),
        (moments(1, 0, 1), 0),
    ],
)
def test_impossible_moments_are_reported(inertial: str, noted: int) -> None:
    assert len(subjects(report_of(a_robot(a_link("a", inertial))), "suspicious")) == noted


@pytest.mark.parametrize(
    ("written", "used"),
    [
        ((1.0, 1.0, 3.0), (4.0 / 3.0, 4.0 / 3.0, 8.0 / 3.0)),
        ((1.0, 1.0, -1.0), (1.0, 1.0, 0.0)),
        ((-1.0, -1.0, -1.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 2.0), (2.0 / 3.0, 2.0 / 3.0, 4.0 / 3.0)),
    ],
)
def test_impossible_moments_become_the_nearest_of_a_body(
    written: tuple[float, float, float], used: tuple[float, float, float]
) -> None:
    model = read_urdf(a_robot(a_link("a", moments(*written))))

    ixx, ixy, ixz, iyy, iyz, izz = model.links[0].inertial.inertia
    assert (ixx, iyy, izz) == pytest.approx(used, abs=1e-9)
    assert (ixy, ixz, iyz) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_massless_moving_links_are_reported() -> None:
    text = a_robot(a_link("a"), a_link("b"), a_joint("j", ("a", "b"), "continuous"))

    assert subjects(report_of(text), "suspicious") == ["robot", "link 'b'"]


def test_reversed_limits_are_reported() -> None:
    pair = a_link("a", an_inertial()) + a_link("b", an_inertial())
    limit = '<limit lower="1" upper="-1" effort="1" velocity="1"/>'

    entries = report_of(a_robot(pair, a_joint("j", ("a", "b"), "revolute", limit)))

    assert mentions(entries, "suspicious", "joint 'j'", "lower 1", "upper -1")
