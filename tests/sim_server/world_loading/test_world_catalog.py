"""Worlds are found by name and file, and the initial world is described."""

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


def test_builtin_world_is_described_by_its_name() -> None:
    assert find_start_file("walls") is None
    assert WorldCatalog(()).find_start_world("walls", "walls").world_resource == Resource("walls")


@pytest.mark.parametrize("name", ["a_yard.world", "a_yard"])
def test_start_file_is_found_by_path_and_by_name(yard: Path, name: str) -> None:
    catalog = WorldCatalog((), find_start_file(str(yard)))

    started = catalog.find_start_world(str(yard), "yard")

    assert (started.name, started.world_resource) == ("yard", Resource(str(yard)))
    for uri in (str(yard), name):
        assert catalog.find(Resource(uri)).text == YARD
    search = catalog.search()
    assert search.advance(None)
    assert "a_yard.world" in [world.world_resource.uri for world in search.worlds]


def test_world_restored_from_a_journal_is_described_by_its_own_name(yard: Path) -> None:
    assert WorldCatalog(()).find_start_world("empty", "walls").world_resource == Resource("walls")
    assert WorldCatalog([yard.parent]).find_start_world("empty", "yard").world_resource == Resource(
        "a_yard.world"
    )


def test_world_whose_file_was_deleted_is_described_by_its_name_alone(yard: Path) -> None:
    catalog = WorldCatalog((), find_start_file(str(yard)))
    yard.unlink()

    assert catalog.find_start_world(str(yard), "yard").world_resource == Resource()
    assert catalog.find_start_world("empty", "elsewhere").name == "elsewhere"


def test_folder_that_does_not_exist_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    WorldCatalog([tmp_path, tmp_path / "nope"])

    assert [one.getMessage() for one in caplog.records] == [
        f"`model_path`: there is no folder '{tmp_path / 'nope'}'"
    ]
