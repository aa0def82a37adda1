"""Which models a recording has for the entities of a snapshot."""

from collections.abc import Mapping
from pathlib import Path

import msgspec
import pytest

from tests.deploy.recorded_worlds import write_world
from tests.spawner.page.builders import make_models_by_name, make_robot, make_wall
from zensim.deploy.recorded_models import MAX_FILES, RecordedModels, list_rosters
from zensim.proto.messages.model_messages import Model
from zensim.recording.file_index import AttachmentPlace
from zensim.recording.mcap_records import MalformedRecord
from zensim.recording.recording_reader import RecordingReader

ROBOT, WALL = make_robot(), make_wall()


def make_files(rosters: Mapping[int, Mapping[str, Model]]) -> dict[str, bytes]:
    return {
        str(roster): msgspec.json.encode(make_models_by_name(entities, roster))
        for roster, entities in rosters.items()
    }


def open_models(path: Path, rosters: Mapping[int, Mapping[str, Model]]) -> RecordedModels:
    """Write a recording with these models by roster, and open it."""
    write_world(path / "a.mcap", has_models=False, models=make_files(rosters))
    return RecordedModels(RecordingReader(path / "a.mcap"))


def find(models: RecordedModels, roster: int, *names: str, run: int = 0) -> dict[str, Model]:
    """Find the models of entities by name."""
    found = models.find(run, roster, names)
    return {one.entity: found.models[one.model] for one in found.entities if one.entity in names}


@pytest.mark.parametrize(
    ("roster", "model"), [(1, ROBOT), (2, ROBOT), (4, WALL), (5, WALL), (9, WALL)]
)
def test_a_name_that_is_spawned_again_has_its_new_model(
    tmp_path: Path, roster: int, model: Model
) -> None:
    # It is deleted at 3, and spawned again at 4; others are deleted at 2 and 5.
    models = open_models(tmp_path, {1: {"a": ROBOT, "b": ROBOT}, 4: {"a": WALL, "b": ROBOT}})

    assert find(models, roster, "a") == {"a": model}


def test_an_entity_that_came_just_before_a_file_is_that_of_the_file(tmp_path: Path) -> None:
    models = open_models(tmp_path, {1: {"a": ROBOT}, 5: {"a": WALL, "b": WALL, "c": ROBOT}})

    assert find(models, 3, "a", "b", "c") == {"a": ROBOT, "b": WALL, "c": ROBOT}


def test_before_the_first_file_the_first_one_counts(tmp_path: Path) -> None:
    assert find(open_models(tmp_path, {5: {"a": WALL}}), 2, "a") == {"a": WALL}


def test_each_run_has_the_models_of_its_own_server(tmp_path: Path) -> None:
    # The second file begins with the attachments of the first one.
    first, second = make_files({4: {"a": ROBOT}, 9: {"a": ROBOT}}), make_files({2: {"a": WALL}})
    write_world(tmp_path / "r_0.mcap", has_models=False, models=first)
    write_world(tmp_path / "r_1.mcap", has_models=False, models=first | second, begin_s=0.0)
    models = RecordedModels(RecordingReader(tmp_path))

    assert find(models, 9, "a", run=0) == {"a": ROBOT}
    assert find(models, 9, "a", run=1) == {"a": WALL}


def test_a_run_without_models_has_those_of_the_recording(tmp_path: Path) -> None:
    write_world(tmp_path / "r_0.mcap", has_models=False, models=make_files({4: {"a": ROBOT}}))
    write_world(tmp_path / "r_1.mcap", has_models=False, begin_s=0.0)

    assert find(RecordedModels(RecordingReader(tmp_path)), 1, "a", run=1) == {"a": ROBOT}


def test_files_that_are_malformed_or_missing_are_skipped(tmp_path: Path) -> None:
    deep = b'{"more":' + b"[" * 100_000
    files = {"0": deep, "1": b"{", "2": b'{"entities": 3}', "3": b"\xff"}
    files |= make_files({7: {"a": ROBOT}})
    write_world(tmp_path / "a.mcap", has_models=False, models=files)
    models = RecordedModels(RecordingReader(tmp_path / "a.mcap"))
    assert find(models, 3, "a") == {"a": ROBOT}

    (tmp_path / "a.mcap").unlink()

    assert find(models, 3, "a") == {"a": ROBOT}  # of what was read
    with pytest.raises(MalformedRecord):
        RecordedModels.find(_open_and_remove(tmp_path), 0, 3, ("a",))


def _open_and_remove(folder: Path) -> RecordedModels:
    models = open_models(folder, {1: {"a": ROBOT}})
    (folder / "a.mcap").unlink()
    return models


def test_of_many_files_few_are_read_for_a_snapshot(tmp_path: Path) -> None:
    models = open_models(tmp_path, {number: {f"r{number}": ROBOT} for number in range(100)})

    found = models.find(0, 50, ("unknown",))

    assert len(found.models) <= MAX_FILES
    assert find(models, 50, "r50", "r51") == {"r50": ROBOT, "r51": ROBOT}


def test_rosters_are_those_of_each_server() -> None:
    names = ["models/1.json", "models/4.json", "world.sdf", "models/x.json", "models/2.json"]
    places = [AttachmentPlace(0, 9, name, "", 9) for name in [*names, "models/" + "9" * 5000]]
    large = AttachmentPlace(0, 1 << 30, "models/7.json", "", 9)

    assert list_rosters([*places, large]) == [[1, 4], [2]]
    assert list_rosters([]) == []
