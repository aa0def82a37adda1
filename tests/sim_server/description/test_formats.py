"""The root tag says whether a text is URDF or SDF."""

import pytest

from tests.sim_server.description.sdf_robots import PIONEER
from zensim.sim_server.description.formats import is_sdf, read_robot
from zensim.sim_server.description.library import model_text
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
def test_root_tag_is_found_after_what_may_come_before_it(text: str, expected: bool) -> None:  # noqa: FBT001
    assert is_sdf(text) == expected


def test_robots_of_both_formats_are_read() -> None:
    assert read_robot(PIONEER).name == "two_wheels"
    assert read_robot(model_text("box_bot")).name == "box_bot"


def test_text_of_neither_is_refused_as_urdf() -> None:
    with pytest.raises(ModelError) as caught:
        read_robot("<html/>")

    assert caught.value.slug == "urdf.root"
