"""Poses, flags and names of SDF."""

import math

import pytest
from lxml import etree

from zensim.proto.messages.model_messages import Origin
from zensim.sim_server.description.sdf.sdf_values import read_flag, read_name, read_pose
from zensim.sim_server.errors import ModelError


def an_element(text: str) -> etree._Element:
    return etree.fromstring(text.encode(), etree.XMLParser())


def pose(text: str, attributes: str = "") -> Origin:
    return read_pose(an_element(f"<link><pose {attributes}>{text}</pose></link>"), "here").origin


def test_pose_is_identity_when_it_is_missing_or_empty() -> None:
    assert read_pose(an_element("<link/>"), "here").origin == Origin()
    assert pose(" \n ") == Origin()


def test_rotation_is_in_radians_degrees_or_a_quaternion() -> None:
    half = math.sqrt(0.5)

    for turned in (
        pose(f"1 2 3 0 0 {math.pi / 2}"),
        pose("1 2 3 0 0 90", 'degrees="true"'),
        pose("1 2 3 0 0 5 5", 'rotation_format="quat_xyzw"'),
    ):
        assert turned.position == (1.0, 2.0, 3.0)
        assert turned.orientation == pytest.approx((0.0, 0.0, half, half))


@pytest.mark.parametrize("attribute", ["relative_to", "frame"])
def test_pose_has_the_written_frame(attribute: str) -> None:
    element = an_element(f'<link><pose {attribute}=" base ">0 0 0 0 0 0</pose></link>')

    assert read_pose(element, "here").frame == "base"


@pytest.mark.parametrize(
    ("text", "attributes"),
    [
        ("1 2 3", ""),
        ("1 2 3 4 5 6 7", ""),
        ("0 0 0 0 0 0 0", 'rotation_format="quat_xyzw"'),
        ("0 0 0 0 0 0", 'rotation_format="quaternion"'),
        ("0 0 inf 0 0 0", ""),
        ("1e10 0 0 0 0 0", ""),
        ("a b c d e f", ""),
    ],
)
def test_pose_is_refused_when_it_is_invalid(text: str, attributes: str) -> None:
    with pytest.raises(ModelError) as caught:
        pose(text, attributes)

    assert caught.value.slug == "sdf.pose"


@pytest.mark.parametrize(
    ("text", "expected"), [("true", True), ("1", True), ("False", False), ("0", False), ("", False)]
)
def test_flag_is_true_or_false(text: str, expected: bool) -> None:  # noqa: FBT001
    element = an_element(f"<model><static>{text}</static></model>")

    assert read_flag(element, "static", default=True, where="here") == expected


@pytest.mark.parametrize("name", ["", " ", "world", "__model__", "x" * 257, "a\u200b"])
def test_invalid_name_is_refused(name: str) -> None:
    element = etree.Element("link", {"name": name})

    with pytest.raises(ModelError) as caught:
        read_name(element, "here")

    assert caught.value.slug == "sdf.name"
