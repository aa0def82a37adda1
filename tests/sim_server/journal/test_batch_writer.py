"""Batches of records are written in order, all or nothing, and none after a failure."""

import sqlite3
import threading
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.integration.processes import eventually
from tests.models import a_body
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.sim_server.journal.batch_writer import MAX_LOG_BYTES, BatchWriter, WriterThread
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


def make_journaled(name: str, model: Model, text: str = "<robot/>") -> JournaledEntity:
    return JournaledEntity(1, Entity(name, name, model, 0, np.zeros(13), text, born_ns=1))


def make_added(position: int, *entities: JournaledEntity) -> JournalRecord:
    changes = tuple(EntityChange(one.entity.name, None, one) for one in entities)
    return JournalRecord(0, position, changes)


def make_removed(position: int, *entities: JournaledEntity) -> JournalRecord:
    changes = tuple(EntityChange(one.entity.name, one, None) for one in entities)
    return JournalRecord(0, position, changes)


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / f"{MESH}.stl").write_bytes(b"solid")
    return folder


@pytest.fixture
def database(tmp_path: Path) -> SqliteStore:
    return open_store(tmp_path / "journal")


def test_batch_writer_copies_the_meshes_of_a_model(database: SqliteStore, meshes: Path) -> None:
    batch_writer = BatchWriter(database, str(meshes))

    batch_writer.write([make_added(1, make_journaled("a", a_meshed_model()))])

    assert (database.folder / FILES / f"{MESH}.stl").read_bytes() == b"solid"


def test_batch_writer_writes_no_row_without_its_mesh(database: SqliteStore, meshes: Path) -> None:
    batch_writer = BatchWriter(database, str(meshes))

    with pytest.raises(FileNotFoundError):
        batch_writer.write([make_added(1, make_journaled("a", a_meshed_model("cd" * 32)))])

    assert (database.rows("entity"), database.position) == ({}, 0)


def test_batch_writer_shares_models_and_texts_and_removes_unused_ones(
    database: SqliteStore, meshes: Path
) -> None:
    batch_writer = BatchWriter(database, str(meshes))
    one, two = make_journaled("a", a_meshed_model()), make_journaled("b", a_meshed_model())
    batch_writer.write([make_added(1, one, two)])
    assert (len(database.rows("model")), len(database.rows("text"))) == (1, 1)

    batch_writer.write([make_removed(2, one)])
    assert len(database.rows("model")) == 1
    batch_writer.write([make_removed(3, two)])

    assert (database.rows("model"), database.rows("text")) == ({}, {})


def test_batch_writer_counts_uses_correctly_after_a_failure(
    database: SqliteStore, meshes: Path
) -> None:
    batch_writer = BatchWriter(database, str(meshes))
    one = make_journaled("a", a_meshed_model())
    batch_writer.write([make_added(1, one)])
    with pytest.raises(FileNotFoundError):
        batch_writer.write(
            [
                make_added(2, make_journaled("b", a_meshed_model())),
                make_added(3, make_journaled("c", a_meshed_model("x"))),
            ]
        )

    batch_writer.write([make_removed(2, one)])

    assert database.rows("model") == {}


def test_batch_writer_removes_unused_files(database: SqliteStore, meshes: Path) -> None:
    batch_writer = BatchWriter(database, str(meshes))
    batch_writer.write([make_added(1, make_journaled("a", a_meshed_model()))])
    files = database.folder / FILES
    (files / f"{'ef' * 32}.stl").write_bytes(b"old")
    (files / "half.part").write_bytes(b"cut")

    batch_writer.remove_unused_files()

    assert [path.name for path in files.iterdir()] == [f"{MESH}.stl"]


def test_batch_writer_replaces_the_row_of_a_name(database: SqliteStore, meshes: Path) -> None:
    batch_writer = BatchWriter(database, str(meshes))
    batch_writer.write([make_added(1, make_journaled("a", a_meshed_model(), "<old/>"))])

    batch_writer.write([make_added(2, make_journaled("a", a_meshed_model(), "<new/>"))])

    (row,) = database.rows("entity").values()
    text = database.body("text", msgspec.msgpack.decode(row, type=EntityRow).text)
    assert text == b"<new/>"
    assert len(database.rows("text")) == 1


class GatedSink:
    """Writes a batch each time the gate is released."""

    def __init__(self) -> None:
        self.gate = threading.Semaphore(0)
        self.batches: list[list[int]] = []
        self.error: Exception | None = None
        self.find_durable: Callable[[], int] = lambda: 0
        self.merged_at: list[int] = []
        self.is_closed = False

    def write(self, records: Sequence[JournalRecord]) -> None:
        assert self.gate.acquire(timeout=10.0)
        if self.error is not None:
            raise self.error
        self.batches.append([record.position for record in records])

    def merge_log_if_due(self) -> None:
        self.merged_at.append(self.find_durable())

    def close(self) -> None:
        self.is_closed = True


def test_writer_writes_queued_records_in_one_batch() -> None:
    sink = GatedSink()
    writer = WriterThread(sink, 0)
    for position in (1, 2):
        writer.submit(JournalRecord(0, position))
    writer.start()
    sink.gate.release()
    eventually(lambda: writer.durable == 2, 10.0, "the first batch")
    sink.gate.release(9)
    writer.submit(JournalRecord(0, 3))

    assert writer.close()
    assert sink.batches == [[1, 2], [3]]
    assert (writer.durable, writer.commits, sink.is_closed) == (3, 2, True)


def test_writer_reports_records_as_durable_after_writing() -> None:
    sink = GatedSink()
    writer = WriterThread(sink, 5)
    writer.start()
    writer.submit(JournalRecord(0, 6))

    assert writer.durable == 5
    sink.gate.release()
    eventually(lambda: writer.durable == 6, 10.0, "the batch")
    assert writer.close()


def test_writer_merges_the_log_when_the_records_are_durable() -> None:
    sink = GatedSink()
    writer = WriterThread(sink, 0)
    sink.find_durable = lambda: writer.durable
    writer.start()
    writer.submit(JournalRecord(0, 1))
    sink.gate.release()

    assert writer.close()
    assert sink.merged_at == [1]


def test_log_stays_short_while_small_rows_are_written_and_removed(
    database: SqliteStore, meshes: Path
) -> None:
    batch_writer = BatchWriter(database, str(meshes))
    model = Model("m", (Link("base", a_body()),))
    sizes = []

    for position in range(1, 601):
        make = make_added if position % 2 else make_removed
        entity = make_journaled(f"r{(position + 1) // 2}", model, "<short/>")
        batch_writer.write([make(position, entity)])
        batch_writer.merge_log_if_due()
        sizes.append(database.log_bytes)

    assert max(sizes) < MAX_LOG_BYTES + (1 << 20)
    assert any(after < before for before, after in pairwise(sizes))


@pytest.mark.parametrize(
    "error", [sqlite3.OperationalError("database or disk is full"), OSError(28, "No space left")]
)
def test_writer_drops_the_generation_that_failed(error: Exception) -> None:
    sink = GatedSink()
    sink.error = error
    writer = WriterThread(sink, 0)
    writer.start()
    writer.submit(JournalRecord(0, 1))
    sink.gate.release(9)
    eventually(lambda: writer.failure, 10.0, "the failure")
    sink.error = None
    writer.submit(JournalRecord(0, 2))
    writer.submit(JournalRecord(1, 1))

    assert writer.close()
    assert writer.failure is not None
    assert writer.failure[0] == 0
    assert sink.batches == [[1]]
    assert writer.durable == 1


def test_writer_waits_for_the_sink_for_a_limited_time_when_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("zensim.sim_server.journal.batch_writer.END_S", 0.05)
    sink = GatedSink()
    writer = WriterThread(sink, 0)
    writer.start()
    writer.submit(JournalRecord(0, 1))

    assert not writer.close()
    sink.gate.release(9)
    eventually(lambda: not writer.is_alive, 10.0, "the end")
