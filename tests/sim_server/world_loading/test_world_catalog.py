"""The world that a server has at its start is told as it can be asked for."""

from pathlib import Path

import pytest

from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.world_loading.world_catalog import WorldCatalog, find_start_file

YARD = "<sdf version='1.6'><world name='yard'/></sdf>"


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    file = tmp_path / "a_yard.world"
    file.write_text(YARD)
    return file


def test_shipped_world_is_asked_for_by_name() -> None:
    assert find_start_file("walls") is None
    assert WorldCatalog(()).find_start_world("walls", "walls").world_resource == Resource("walls")


@pytest.mark.parametrize("again", ["a_yard.world", "a_yard"])
def test_file_of_the_start_is_asked_for_as_it_was_given_or_by_its_name(
    yard: Path, again: str
) -> None:
    atlas = WorldCatalog((), find_start_file(str(yard)))

    started = atlas.find_start_world(str(yard), "yard")

    assert (started.name, started.world_resource) == ("yard", Resource(str(yard)))
    for name in (str(yard), again):
        assert atlas.find(Resource(name)).text == YARD
    search = atlas.search()
    assert search.advance(None)
    assert "a_yard.world" in [world.world_resource.uri for world in search.worlds]


def test_world_that_a_journal_brought_back_is_told_under_its_own_name(yard: Path) -> None:
    assert WorldCatalog(()).find_start_world("empty", "walls").world_resource == Resource("walls")
    assert WorldCatalog([yard.parent]).find_start_world("empty", "yard").world_resource == Resource(
        "a_yard.world"
    )


def test_world_that_is_nowhere_any_more_is_told_by_its_name_alone(yard: Path) -> None:
    atlas = WorldCatalog((), find_start_file(str(yard)))
    yard.unlink()

    assert atlas.find_start_world(str(yard), "yard").world_resource == Resource()
    assert atlas.find_start_world("empty", "elsewhere").name == "elsewhere"
