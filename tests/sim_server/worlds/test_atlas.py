"""The world that a server has at its start is told as it can be asked for."""

from pathlib import Path

import pytest

from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.worlds.atlas import Atlas, start_file

YARD = "<sdf version='1.6'><world name='yard'/></sdf>"


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    file = tmp_path / "a_yard.world"
    file.write_text(YARD)
    return file


def test_shipped_world_is_asked_for_by_name() -> None:
    assert start_file("walls") is None
    assert Atlas(()).started("walls", "walls").world_resource == Resource("walls")


@pytest.mark.parametrize("again", ["a_yard.world", "a_yard"])
def test_file_of_the_start_is_asked_for_as_it_was_given_or_by_its_name(
    yard: Path, again: str
) -> None:
    atlas = Atlas((), start_file(str(yard)))

    started = atlas.started(str(yard), "yard")

    assert (started.name, started.world_resource) == ("yard", Resource(str(yard)))
    for name in (str(yard), again):
        assert atlas.find(Resource(name)).text == YARD
    search = atlas.search()
    assert search.go_on(None)
    assert "a_yard.world" in [world.world_resource.uri for world in search.worlds]


def test_world_that_a_journal_brought_back_is_told_under_its_own_name(yard: Path) -> None:
    assert Atlas(()).started("empty", "walls").world_resource == Resource("walls")
    assert Atlas([yard.parent]).started("empty", "yard").world_resource == Resource("a_yard.world")


def test_world_that_is_nowhere_any_more_is_told_by_its_name_alone(yard: Path) -> None:
    atlas = Atlas((), start_file(str(yard)))
    yard.unlink()

    assert atlas.started(str(yard), "yard").world_resource == Resource()
    assert atlas.started("empty", "elsewhere").name == "elsewhere"
