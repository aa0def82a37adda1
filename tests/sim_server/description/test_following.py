"""A <mimic> is followed when it can be, and noted when it cannot."""

import pytest

from tests.sim_server.description.robots import a_joint, a_link, a_robot, an_inertial, reasons
from zensim.proto.messages.model_messages import Mimic
from zensim.sim_server.description.urdf import read_urdf

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def a_gripper(*inside: str, kinds: tuple[str, ...] = ("revolute",) * 3) -> str:
    """A palm with three fingers `f0` to `f2`, moved by `j0` to `j2`."""
    fingers = "".join(
        a_link(f"f{i}", an_inertial()) + a_joint(f"j{i}", ("palm", f"f{i}"), kind, LIMIT + extra)
        for i, (extra, kind) in enumerate(zip((*inside, "", "", "")[:3], kinds, strict=True))
    )
    return a_robot(a_link("palm", an_inertial()), fingers)


def test_mimic_is_kept_with_its_numbers_when_it_can_be_followed() -> None:
    mimic = '<mimic joint="j0" multiplier="-2" offset="0.1"/>'

    model = read_urdf(a_gripper("", mimic, '<mimic joint="j1"/>'))

    assert [joint.mimic for joint in model.joints] == [
        None,
        Mimic("j0", -2.0, 0.1),
        Mimic("j1", 1.0, 0.0),
    ]
    assert "joint 'j1': <mimic>: follows 'j0'" in reasons(model.report, "applied")


@pytest.mark.parametrize(
    ("inside", "kinds", "fault"),
    [
        (("", '<mimic joint="nobody"/>'), ("revolute",) * 3, "'nobody' does not exist"),
        (("", '<mimic joint="j2"/>'), ("revolute", "revolute", "fixed"), "'j2' does not exist"),
        (("", '<mimic joint="j1"/>'), ("revolute",) * 3, "'j1' would follow itself"),
        (
            ('<mimic joint="j1"/>', '<mimic joint="j0"/>'),
            ("revolute",) * 3,
            "'j0' would follow itself",
        ),
        (("", '<mimic joint="j0" multiplier="0"/>'), ("revolute",) * 3, "multiplier is 0"),
        (("", '<mimic joint="j0"/>'), ("planar", "revolute", "revolute"), "'j0' is planar"),
        (('<mimic joint="j1"/>',), ("floating", "revolute", "revolute"), "a floating joint"),
    ],
)
def test_mimic_is_noted_when_it_cannot_be_followed(
    inside: tuple[str, ...], kinds: tuple[str, ...], fault: str
) -> None:
    model = read_urdf(a_gripper(*inside, kinds=kinds))

    assert any(fault in line for line in reasons(model.report, "suspicious"))
    assert [joint.mimic for joint in model.joints if joint.mimic] == []
