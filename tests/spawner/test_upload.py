"""Upload: nothing twice, nothing from the start that is half there."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from zensim.proto.messages.asset_messages import MAX_CHUNK_BYTES, MissingAssetsResponse
from zensim.spawner.assets import AssetFile
from zensim.spawner.client import SimClient
from zensim.spawner.upload import Outstanding, outstanding, send

if TYPE_CHECKING:
    from zensim.proto.bus import Bus


class Store(SimClient):
    """Keeps pieces as a server does; fails to answer as often as it was told to."""

    def __init__(self, *, silences: int = 0) -> None:
        super().__init__(cast("Bus", MemoryBus()))
        self.held: dict[str, bytes] = {}
        self.totals: dict[str, int] = {}
        self.pieces: list[int] = []
        self._silences = silences

    def missing_assets(self, sha256s: tuple[str, ...]) -> MissingAssetsResponse:
        missing = tuple(
            sha for sha in sha256s if len(self.held.get(sha, b"")) != self.totals.get(sha, -1)
        )
        return MissingAssetsResponse(
            missing=missing, received=tuple(len(self.held.get(sha, b"")) for sha in missing)
        )

    def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
        self.totals[sha256] = total
        held = self.held.setdefault(sha256, b"")
        if offset == len(held):
            self.held[sha256] = held + data
            self.pieces.append(len(data))
        if self._silences:
            self._silences -= 1
            raise TimeoutError("no answer")
        return len(self.held[sha256])


def a_file(folder: Path, data: bytes) -> AssetFile:
    path = folder / "a.stl"
    path.write_bytes(data)
    return AssetFile(path, hashlib.sha256(data).hexdigest(), len(data))


DATA = bytes(range(256)) * 40_000


@pytest.mark.parametrize("silences", [0, 1, 2])
def test_file_arrives_whole_in_pieces_though_answers_are_lost(
    tmp_path: Path, silences: int
) -> None:
    store, file = Store(silences=silences), a_file(tmp_path, DATA)
    gone: list[int] = []

    send(store, outstanding(store, [file])[0], gone.append)

    assert store.held[file.sha256] == DATA
    assert max(store.pieces) == MAX_CHUNK_BYTES
    assert sum(gone) == len(DATA)


def test_file_goes_on_from_what_is_there(tmp_path: Path) -> None:
    store, file = Store(), a_file(tmp_path, DATA)
    store.held[file.sha256] = DATA[:1_000_000]

    lacking = outstanding(store, [file])
    send(store, lacking[0], lambda _: None)

    assert lacking == [Outstanding(file, 1_000_000)]
    assert store.held[file.sha256] == DATA
    assert sum(store.pieces) == len(DATA) - 1_000_000


def test_file_that_is_there_is_not_sent(tmp_path: Path) -> None:
    store, file = Store(), a_file(tmp_path, DATA)
    send(store, Outstanding(file, 0), lambda _: None)

    assert outstanding(store, [file]) == []


def test_empty_file_is_sent_once(tmp_path: Path) -> None:
    store, file = Store(), a_file(tmp_path, b"")

    send(store, outstanding(store, [file])[0], lambda _: None)

    assert store.pieces == [0]


def test_sending_ends_when_nothing_arrives(tmp_path: Path) -> None:
    class Deaf(Store):
        def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
            del sha256, offset, total, data
            raise TimeoutError("no answer")

    store, file = Deaf(), a_file(tmp_path, DATA)

    with pytest.raises(TimeoutError, match="takes no more than 0 bytes"):
        send(store, Outstanding(file, 0), lambda _: None)


def test_nothing_is_asked_when_there_are_no_files() -> None:
    assert outstanding(Store(), []) == []
