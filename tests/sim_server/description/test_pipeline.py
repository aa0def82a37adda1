"""A description and its meshes become a model."""

import pytest

from tests.sim_server.description.robots import a_cart, a_drive, a_link, a_robot, an_inertial
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.proto.messages.drive_messages import Compat
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.pipeline import is_sdf, parse_description, read_robot
from zensim.sim_server.errors import ModelError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<sdf version='1.6'/>", True),
        ("\ufeff \n<?xml version='1.0'?><!-- <robot> -->\n<sdf>", True),
        ("<sdformat/>", False),
        ("<robot name='sdf'/>", False),
        ("<!-- <sdf>", False),
        ("", False),
    ],
)
def test_root_tag_is_found_after_comments_and_instructions(text: str, expected: bool) -> None:  # noqa: FBT001
    assert is_sdf(text) == expected


def test_robots_of_both_formats_are_read() -> None:
    assert read_robot(PIONEER).name == "two_wheels"
    assert read_robot(read_builtin_model("box_bot")).name == "box_bot"


def test_text_without_a_known_root_is_refused_as_urdf() -> None:
    with pytest.raises(ModelError) as caught:
        read_robot("<html/>")

    assert caught.value.slug == "urdf.root"


COMPATS: tuple[Compat, ...] = ("fixed", "gazebo11")


@pytest.mark.parametrize("compat", COMPATS)
def test_drive_has_the_compat_of_the_spawn_request(compat: Compat) -> None:
    drive = parse_description(
        a_cart(a_drive()), assets={}, allow_missing=False, compat=compat
    ).model.drive

    assert drive is not None
    assert drive.compat == compat


def test_robot_without_a_drive_does_not_depend_on_compat() -> None:
    text = a_robot(a_link("base", an_inertial()))

    fixed, as_gazebo = (
        parse_description(text, assets={}, allow_missing=False, compat=compat).model
        for compat in COMPATS
    )

    assert fixed == as_gazebo
