"""Writer: records in order, together where they came together, and none after one that failed."""

import sqlite3
import threading
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.integration.processes import eventually
from tests.models import a_body
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.sim_server.journal.batch_writer import BatchWriter, WriterThread
from zensim.sim_server.journal.journal_records import (
    EntityChange,
    EntityRow,
    JournaledEntity,
    JournalRecord,
)
from zensim.sim_server.journal.sqlite_store import FILES, SqliteStore, open_store
from zensim.sim_server.world.entity import Entity

MESH = "ab" * 32


def a_meshed_model(mesh: str = MESH) -> Model:
    return Model("meshed", (Link("base", a_body(), (Shape("mesh", (1.0, 1.0, 1.0), mesh=mesh),)),))


def kept(name: str, model: Model, text: str = "<robot/>") -> JournaledEntity:
    return JournaledEntity(1, Entity(name, name, model, 0, np.zeros(13), text, born_ns=1))


def added(position: int, *those: JournaledEntity) -> JournalRecord:
    changes = tuple(EntityChange(one.entity.name, None, one) for one in those)
    return JournalRecord(0, position, changes)


def removed(position: int, *those: JournaledEntity) -> JournalRecord:
    changes = tuple(EntityChange(one.entity.name, one, None) for one in those)
    return JournalRecord(0, position, changes)


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / f"{MESH}.stl").write_bytes(b"solid")
    return folder


@pytest.fixture
def ledger(tmp_path: Path) -> SqliteStore:
    return open_store(tmp_path / "journal")


def test_keeper_copies_the_meshes_of_a_model(ledger: SqliteStore, meshes: Path) -> None:
    keeper = BatchWriter(ledger, str(meshes))

    keeper.keep([added(1, kept("a", a_meshed_model()))])

    assert (ledger.folder / FILES / f"{MESH}.stl").read_bytes() == b"solid"


def test_keeper_writes_no_row_whose_mesh_is_not_there(ledger: SqliteStore, meshes: Path) -> None:
    keeper = BatchWriter(ledger, str(meshes))

    with pytest.raises(OSError, match="No such file"):
        keeper.keep([added(1, kept("a", a_meshed_model("cd" * 32)))])

    assert (ledger.rows("entity"), ledger.position) == ({}, 0)


def test_keeper_shares_models_and_texts_and_drops_them_with_the_last(
    ledger: SqliteStore, meshes: Path
) -> None:
    keeper = BatchWriter(ledger, str(meshes))
    one, two = kept("a", a_meshed_model()), kept("b", a_meshed_model())
    keeper.keep([added(1, one, two)])
    assert (len(ledger.rows("model")), len(ledger.rows("text"))) == (1, 1)

    keeper.keep([removed(2, one)])
    assert len(ledger.rows("model")) == 1
    keeper.keep([removed(3, two)])

    assert (ledger.rows("model"), ledger.rows("text")) == ({}, {})


def test_keeper_that_failed_counts_as_before(ledger: SqliteStore, meshes: Path) -> None:
    keeper = BatchWriter(ledger, str(meshes))
    one = kept("a", a_meshed_model())
    keeper.keep([added(1, one)])
    with pytest.raises(OSError, match="No such file"):
        keeper.keep(
            [added(2, kept("b", a_meshed_model())), added(3, kept("c", a_meshed_model("x")))]
        )

    keeper.keep([removed(2, one)])

    assert ledger.rows("model") == {}


def test_keeper_sweeps_files_that_nobody_needs(ledger: SqliteStore, meshes: Path) -> None:
    keeper = BatchWriter(ledger, str(meshes))
    keeper.keep([added(1, kept("a", a_meshed_model()))])
    files = ledger.folder / FILES
    (files / f"{'ef' * 32}.stl").write_bytes(b"old")
    (files / "half.part").write_bytes(b"cut")

    keeper.remove_unused_files()

    assert [path.name for path in files.iterdir()] == [f"{MESH}.stl"]


def test_keeper_replaces_the_row_of_a_name(ledger: SqliteStore, meshes: Path) -> None:
    keeper = BatchWriter(ledger, str(meshes))
    keeper.keep([added(1, kept("a", a_meshed_model(), "<old/>"))])

    keeper.keep([added(2, kept("a", a_meshed_model(), "<new/>"))])

    (row,) = ledger.rows("entity").values()
    text = ledger.body("text", msgspec.msgpack.decode(row, type=EntityRow).text)
    assert text == b"<new/>"
    assert len(ledger.rows("text")) == 1


class GatedDisk:
    """Writes only when let."""

    def __init__(self) -> None:
        self.gate = threading.Semaphore(0)
        self.batches: list[list[int]] = []
        self.fault: Exception | None = None
        self.is_closed = False

    def keep(self, records: Sequence[JournalRecord]) -> None:
        assert self.gate.acquire(timeout=10.0)
        if self.fault is not None:
            raise self.fault
        self.batches.append([record.position for record in records])

    def close(self) -> None:
        self.is_closed = True


def test_writer_puts_what_came_meanwhile_into_one_batch() -> None:
    disk = GatedDisk()
    writer = WriterThread(disk, 0)
    for position in (1, 2):
        writer.submit(JournalRecord(0, position))
    writer.start()
    disk.gate.release()
    eventually(lambda: writer.durable == 2, 10.0, "the first batch")
    disk.gate.release(9)
    writer.submit(JournalRecord(0, 3))

    assert writer.close()
    assert disk.batches == [[1, 2], [3]]
    assert (writer.durable, writer.commits, disk.is_closed) == (3, 2, True)


def test_writer_says_nothing_is_durable_before_it_is() -> None:
    disk = GatedDisk()
    writer = WriterThread(disk, 5)
    writer.start()
    writer.submit(JournalRecord(0, 6))

    assert writer.durable == 5
    disk.gate.release()
    eventually(lambda: writer.durable == 6, 10.0, "the batch")
    assert writer.close()


@pytest.mark.parametrize(
    "fault", [sqlite3.OperationalError("database or disk is full"), OSError(28, "No space left")]
)
def test_writer_drops_all_of_a_generation_that_failed(fault: Exception) -> None:
    disk = GatedDisk()
    disk.fault = fault
    writer = WriterThread(disk, 0)
    writer.start()
    writer.submit(JournalRecord(0, 1))
    disk.gate.release(9)
    eventually(lambda: writer.failure, 10.0, "the failure")
    disk.fault = None
    writer.submit(JournalRecord(0, 2))
    writer.submit(JournalRecord(1, 1))

    assert writer.close()
    assert writer.failure is not None
    assert writer.failure[0] == 0
    assert disk.batches == [[1]]
    assert writer.durable == 1


def test_writer_does_not_wait_for_ever_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zensim.sim_server.journal.batch_writer.END_S", 0.05)
    disk = GatedDisk()
    writer = WriterThread(disk, 0)
    writer.start()
    writer.submit(JournalRecord(0, 1))

    assert not writer.close()
    disk.gate.release(9)
    eventually(lambda: not writer.is_alive, 10.0, "the end")
