"""AssetStore: uploads in chunks, eviction, pinned files, vertices of meshes."""

import errno
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from zensim.proto.messages.asset_messages import MAX_BUNDLE_FILES, MAX_CHUNK_BYTES, MAX_FILE_BYTES
from zensim.proto.stl import write_corners
from zensim.sim_server.errors import AssetRefused
from zensim.sim_server.parser_process.asset_store import AssetFolder, AssetStore

DATA = b"solid zensim\nendsolid\n" * 10
NAME = hashlib.sha256(DATA).hexdigest()


@pytest.fixture
def store() -> Iterator[AssetStore]:
    found = AssetStore()
    yield found
    found.close()


def put(store: AssetStore, data: bytes) -> str:
    name = hashlib.sha256(data).hexdigest()
    store.put(name, offset=0, total=len(data), data=data)
    return name


def test_store_has_a_file_when_all_chunks_are_received(store: AssetStore) -> None:
    first = store.put(NAME, offset=0, total=len(DATA), data=DATA[:50])
    second = store.put(NAME, offset=50, total=len(DATA), data=DATA[50:])

    assert (first, second) == (50, len(DATA))
    assert NAME in store
    assert store.read(NAME, 10, 20) == DATA[10:30]


def test_store_reports_the_received_bytes_of_a_partial_file(store: AssetStore) -> None:
    store.put(NAME, offset=0, total=len(DATA), data=DATA[:50])

    assert store.missing([NAME, NAME]) == [(NAME, 50)]


def test_store_accepts_a_repeated_chunk(store: AssetStore) -> None:
    store.put(NAME, offset=0, total=len(DATA), data=DATA[:50])

    assert store.put(NAME, offset=0, total=len(DATA), data=DATA[:50]) == 50
    assert store.put(NAME, offset=40, total=len(DATA), data=DATA[40:]) == len(DATA)
    assert store.put(NAME, offset=0, total=len(DATA), data=DATA[:50]) == len(DATA)


@pytest.mark.parametrize(
    ("name", "offset", "total", "data", "slug"),
    [
        ("../../etc/passwd", 0, 4, b"data", "bundle.name"),
        (NAME.upper(), 0, 4, b"data", "bundle.name"),
        (NAME, 0, 0, b"", "bundle.size"),
        (NAME, 0, MAX_FILE_BYTES + 1, b"data", "bundle.size"),
        (NAME, 0, MAX_FILE_BYTES, bytes(MAX_CHUNK_BYTES + 1), "bundle.chunk"),
        (NAME, 0, 3, b"data", "bundle.total"),
        (NAME, 9, 100, b"data", "bundle.offset"),
        (NAME, 0, 4, b"data", "bundle.sha256"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_store_refuses_a_chunk(
    store: AssetStore, *, name: str, offset: int, total: int, data: bytes, slug: str
) -> None:
    with pytest.raises(AssetRefused) as refused:
        store.put(name, offset=offset, total=total, data=data)

    assert refused.value.slug == slug
    assert name not in store


def test_store_accepts_a_file_again_after_a_wrong_digest(store: AssetStore) -> None:
    with pytest.raises(AssetRefused):
        store.put(NAME, offset=0, total=len(DATA), data=bytes(len(DATA)))

    assert put(store, DATA) == NAME
    assert NAME in store


def test_store_evicts_the_least_recently_used_file() -> None:
    store = AssetStore(budget_bytes=10)
    old, middle, new = (put(store, data) for data in (b"aaaa", b"bbbb", b"cccc"))

    assert [name in store for name in (old, middle, new)] == [False, True, True]
    store.close()


def test_store_never_evicts_pinned_files() -> None:
    store = AssetStore(budget_bytes=10)
    pinned = put(store, b"pppp")
    store.pin(pinned, b"pppp")

    recent = [put(store, data) for data in (b"aaaa", b"bbbb", b"cccc")][1:]

    assert [name in store for name in (pinned, *recent)] == [True, True, True]
    assert (put(store, b"pppp"), store.missing([pinned])) == (pinned, [])
    assert store.read(pinned, 1, 9) == b"ppp"
    store.close()


def test_vertices_of_a_mesh_are_distinct_and_cached(store: AssetStore) -> None:
    square = np.array([[[0, 0, 1], [2, 0, 1], [2, 2, 1]], [[0, 0, 1], [2, 2, 1], [0, 2, 1]]])
    name = put(store, write_corners(square))

    found = store.vertices(name)

    assert sorted(found.tolist()) == [[0, 0, 1], [0, 2, 1], [2, 0, 1], [2, 2, 1]]
    assert store.vertices(name) is found


def test_store_refuses_to_list_too_many_files(store: AssetStore) -> None:
    with pytest.raises(AssetRefused) as refused:
        store.missing(f"{i:064x}" for i in range(MAX_BUNDLE_FILES + 1))

    assert refused.value.slug == "bundle.files"


def test_store_refuses_to_read_an_unknown_file(store: AssetStore) -> None:
    with pytest.raises(AssetRefused) as refused:
        store.read(NAME, 0, 1)

    assert refused.value.slug == "bundle.unknown"


def test_store_refuses_an_offset_after_the_end(store: AssetStore) -> None:
    put(store, DATA)

    with pytest.raises(AssetRefused) as refused:
        store.read(NAME, len(DATA) + 1, 1)

    assert refused.value.slug == "bundle.offset"


def test_store_removes_its_folder_when_closed() -> None:
    store = AssetStore()
    put(store, DATA)

    store.close()

    assert not Path(store.folder).exists()


def test_store_refuses_a_file_when_the_disk_is_full_and_takes_it_later(
    store: AssetStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(AssetFolder, "_write", fail)
        for write in (
            put,
            lambda at, data: at.add(NAME, data),
            lambda at, data: at.pin(NAME, data),
        ):
            with pytest.raises(AssetRefused) as refused:
                write(store, DATA)
            assert refused.value.slug == "bundle.disk"

    assert store.missing([NAME]) == [(NAME, 0)]
    assert put(store, DATA) == NAME
    assert store.read(NAME, 0, -1) == DATA


def test_store_goes_on_when_its_folder_is_removed(store: AssetStore) -> None:
    put(store, DATA)
    shutil.rmtree(store.folder)

    with pytest.raises(AssetRefused) as refused:
        store.read(NAME, 0, -1)

    assert refused.value.slug == "bundle.disk"
    assert store.missing([NAME]) == [(NAME, 0)]
    assert put(store, DATA) == NAME
    assert Path(store.folder, f"{NAME}.stl").read_bytes() == DATA


def test_store_goes_on_when_its_folder_is_replaced(store: AssetStore) -> None:
    shutil.rmtree(store.folder)
    Path(store.folder).mkdir()

    put(store, DATA)

    assert Path(store.folder, f"{NAME}.stl").read_bytes() == DATA


def test_store_forgets_a_file_that_was_removed(store: AssetStore) -> None:
    put(store, DATA)
    Path(store.folder, f"{NAME}.stl").unlink()

    with pytest.raises(AssetRefused) as refused:
        store.read(NAME, 0, 1)

    assert refused.value.slug == "bundle.disk"
    assert NAME not in store


def test_store_in_a_given_folder_begins_empty(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "left.stl").write_bytes(b"left")

    store = AssetStore(folder=tmp_path / "assets")

    assert list(Path(store.folder).iterdir()) == []
    store.close()
    assert not (tmp_path / "assets").exists()


def test_temporary_folders_of_ended_servers_are_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    first = AssetStore()
    held, parent = Path(first.folder), Path(first.folder).parent
    left, new = parent / "left", parent / "new"
    for path in (left, new):
        path.mkdir()
    for path in (left, held):
        os.utime(path, (0.0, 0.0))

    second = AssetStore()

    assert set(parent.iterdir()) == {held, new, Path(second.folder)}
    for store in (first, second):
        store.close()


def test_folder_of_a_dropped_store_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    store = AssetStore()
    folder = Path(store.folder)

    del store

    assert not folder.exists()


def test_fork_leaves_the_folder_of_its_parent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    store = AssetStore()
    folder, process_id = Path(store.folder), os.getpid()
    monkeypatch.setattr(os, "getpid", lambda: process_id + 1)

    store.close()

    assert folder.exists()


def test_store_leaves_a_folder_that_took_its_place(tmp_path: Path) -> None:
    first = AssetStore(folder=tmp_path / "assets")
    second = AssetStore(folder=tmp_path / "assets")

    first.close()

    assert Path(second.folder).is_dir()
    second.close()
    assert not (tmp_path / "assets").exists()
