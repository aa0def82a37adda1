import pytest
from lxml import etree

from tests.sim_server.description.planted_words import (
    Report,
    find_missing_rules,
    find_silent_places,
    report_robot,
    report_world,
)
from tests.sim_server.description.sample_documents import (
    INCLUDED,
    INCLUDING_WORLD,
    SDF_MODEL,
    SDF_WORLD,
    URDF,
)
from zensim.proto.messages.model_messages import ReportEntry
from zensim.sim_server.description.element_rules import ElementRule
from zensim.sim_server.description.sdf.sdf_rules import MODEL, POPULATION, WORLD
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.description.urdf.urdf_rules import (
    GAZEBO_OF_JOINT,
    GAZEBO_OF_LINK,
    GAZEBO_OF_MODEL,
    ROBOT,
)

ROBOT_FILES = ("heightmap", "image", "submesh", "empty", "plane")
"""Geometries that are left out with a word, or that robots have no use for."""


@pytest.mark.parametrize(
    ("text", "report"),
    [(URDF, report_robot), (SDF_MODEL, report_robot), (SDF_WORLD, report_world)],
    ids=["urdf", "sdf model", "sdf world"],
)
def test_unknown_tag_and_attribute_are_reported_in_each_element(text: str, report: Report) -> None:
    assert find_silent_places(text, report) == []


def test_unknown_tag_and_attribute_are_reported_in_each_include() -> None:
    def report_world_of(text: str) -> tuple[ReportEntry, ...]:
        return read_world(text, resolve=lambda _: INCLUDED).report

    def report_included(text: str) -> tuple[ReportEntry, ...]:
        return read_world(INCLUDING_WORLD, resolve=lambda _: text).report

    assert find_silent_places(INCLUDING_WORLD, report_world_of) == []
    assert find_silent_places(INCLUDED, report_included) == []


@pytest.mark.parametrize(
    ("rule", "text", "path"),
    [
        (ROBOT, URDF, "."),
        (GAZEBO_OF_MODEL, URDF, "gazebo"),
        (GAZEBO_OF_LINK, URDF, "gazebo"),
        (GAZEBO_OF_JOINT, URDF, "gazebo"),
        (MODEL, SDF_MODEL, "model"),
        (WORLD, SDF_WORLD, "world"),
        (POPULATION, SDF_WORLD, "world/population"),
    ],
)
def test_samples_have_every_element_that_is_read(rule: ElementRule, text: str, path: str) -> None:
    missing = find_missing_rules(rule, etree.fromstring(text.encode()).findall(path))

    assert [one for one in missing if one.rpartition("/")[2] not in ROBOT_FILES] == [
        *(("actor", "joint", "road") if rule is WORLD else ()),
        *(("include",) if rule is POPULATION else ()),
    ]
