"""Only regular files are read, and a file system that does not answer is refused."""

import os
import threading
from pathlib import Path

import pytest

from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.world_loading import file_work
from zensim.sim_server.world_loading.file_work import FilesStalled, FileWork, read_regular_file
from zensim.sim_server.world_loading.world_catalog import WorldCatalog
from zensim.sim_server.world_loading.world_resources import make_file_reader, make_model_resolver

TIMEOUT_S = 10.0


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A named pipe without a writer: to open it to read waits for ever."""
    os.mkfifo(tmp_path / "pipe.sdf")
    return tmp_path / "pipe.sdf"


def test_pipe_is_no_file(pipe: Path) -> None:
    assert read_regular_file(pipe, 100) is None
    assert make_model_resolver([pipe.parent])("model://pipe.sdf") is None
    assert make_file_reader([pipe.parent])("model://pipe.sdf") is None


def test_pipe_is_neither_listed_nor_loaded_as_a_world(pipe: Path) -> None:
    catalog = WorldCatalog([pipe.parent])

    search = catalog.search()
    search.advance(None)

    assert "pipe.sdf" not in [world.world_resource.uri for world in search.worlds]
    with pytest.raises(RequestRefused):
        catalog.find(Resource("pipe.sdf"))


def test_device_is_no_file() -> None:
    assert read_regular_file(Path("/dev/zero"), 100) is None


def test_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")

    assert read_regular_file(tmp_path / "a", 5) == b"12345"
    assert read_regular_file(tmp_path / "a", 4) is None
    assert read_regular_file(tmp_path / "none", 5) is None


def test_work_returns_or_raises_what_the_function_does() -> None:
    good, bad = FileWork(lambda _: 7), FileWork(lambda _: int("seven"))

    for work in (good, bad):
        while not work.is_over():
            pass

    assert good.outcome() == 7
    with pytest.raises(ValueError, match="seven"):
        bad.outcome()


def test_work_that_waits_for_a_file_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_work, "STALL_TIMEOUT_S", 0.01)
    answers = threading.Event()
    work = FileWork(lambda _: answers.wait(TIMEOUT_S))

    while not work.is_over():
        pass

    with pytest.raises(FilesStalled) as refused:
        work.outcome()
    assert refused.value.slug == "world.stalled"
    answers.set()
