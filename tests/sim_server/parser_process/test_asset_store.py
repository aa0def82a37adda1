"""The asset store: files by content, piece by piece, and nothing that is not named by content."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from zensim.proto.messages.asset_messages import MAX_BUNDLE_FILES, MAX_CHUNK_BYTES, MAX_FILE_BYTES
from zensim.proto.stl import write_corners
from zensim.sim_server.errors import AssetRefused
from zensim.sim_server.parser_process.asset_store import AssetStore

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


def test_store_has_a_file_when_all_pieces_came(store: AssetStore) -> None:
    first = store.put(NAME, offset=0, total=len(DATA), data=DATA[:50])
    second = store.put(NAME, offset=50, total=len(DATA), data=DATA[50:])

    assert (first, second) == (50, len(DATA))
    assert NAME in store
    assert store.read(NAME, 10, 20) == DATA[10:30]


def test_store_says_where_to_go_on_when_a_file_is_unfinished(store: AssetStore) -> None:
    store.put(NAME, offset=0, total=len(DATA), data=DATA[:50])

    assert store.missing([NAME, NAME]) == [(NAME, 50)]


def test_store_takes_a_piece_again_without_harm(store: AssetStore) -> None:
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
def test_store_refuses_a_piece(
    store: AssetStore,
    *,
    name: str,
    offset: int,
    total: int,
    data: bytes,
    slug: str,
) -> None:
    with pytest.raises(AssetRefused, match=rf"^{slug}: "):
        store.put(name, offset=offset, total=total, data=data)

    assert name not in store


def test_store_starts_anew_when_the_bytes_were_wrong(store: AssetStore) -> None:
    with pytest.raises(AssetRefused, match="send it again from 0"):
        store.put(NAME, offset=0, total=len(DATA), data=bytes(len(DATA)))

    assert put(store, DATA) == NAME
    assert NAME in store


def test_store_forgets_what_was_not_used_for_longest() -> None:
    store = AssetStore(budget_bytes=10)
    old, kept, new = (put(store, data) for data in (b"aaaa", b"bbbb", b"cccc"))

    assert [name in store for name in (old, kept, new)] == [False, True, True]
    store.close()


def test_store_keeps_what_is_pinned_beside_its_budget() -> None:
    store = AssetStore(budget_bytes=10)
    pinned = put(store, b"pppp")
    store.pin(pinned, b"pppp")

    kept = [put(store, data) for data in (b"aaaa", b"bbbb", b"cccc")][1:]

    assert [name in store for name in (pinned, *kept)] == [True, True, True]
    assert (put(store, b"pppp"), store.missing([pinned])) == (pinned, [])
    assert store.read(pinned, 1, 9) == b"ppp"
    store.close()


def test_store_tells_each_corner_of_a_mesh_once(store: AssetStore) -> None:
    square = np.array([[[0, 0, 1], [2, 0, 1], [2, 2, 1]], [[0, 0, 1], [2, 2, 1], [0, 2, 1]]])
    name = put(store, write_corners(square))

    found = store.vertices(name)

    assert sorted(found.tolist()) == [[0, 0, 1], [0, 2, 1], [2, 0, 1], [2, 2, 1]]
    assert store.vertices(name) is found


def test_store_refuses_to_look_for_more_files_than_a_bundle_has(store: AssetStore) -> None:
    with pytest.raises(AssetRefused, match=r"^bundle\.files: "):
        store.missing(f"{i:064x}" for i in range(MAX_BUNDLE_FILES + 1))


def test_store_says_so_when_a_file_is_not_here(store: AssetStore) -> None:
    with pytest.raises(AssetRefused, match=r"^bundle\.unknown: "):
        store.read(NAME, 0, 1)


def test_store_refuses_an_offset_behind_the_end(store: AssetStore) -> None:
    put(store, DATA)

    with pytest.raises(AssetRefused, match=r"^bundle\.offset: "):
        store.read(NAME, len(DATA) + 1, 1)


def test_store_leaves_nothing_behind_when_closed() -> None:
    store = AssetStore()
    put(store, DATA)

    store.close()

    assert not Path(store.folder).exists()
