"""Writes batches of records to the database, each in one transaction, in a thread."""

from __future__ import annotations

import os
import shutil
import sqlite3
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Protocol

import msgspec

from zensim.proto.messages.model_messages import Model
from zensim.proto.metric_families import DurationHistogram
from zensim.proto.process_limits import sync_folder
from zensim.sim_server.journal.journal_records import (
    ENCODER,
    EntityRow,
    ExcludedEntityRow,
    ParseOptions,
    encode_model,
    hash_body,
    make_response_key,
)
from zensim.sim_server.journal.sqlite_store import FILES
from zensim.sim_server.parser_process.description_cache import list_assets

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.sim_server.journal.journal_records import (
        EntityChange,
        JournaledEntity,
        JournalRecord,
    )
    from zensim.sim_server.journal.sqlite_store import SqliteStore

MOTION_KIND, CLOCK_KIND, WORLD_KIND = "motion", "clock", "world"
"""Kinds with a single row; its key is empty."""
MAX_CACHED_MODEL_HASHES = 256
CHECKPOINT_PERIOD_S = 60.0
MAX_LOG_BYTES = 4 << 20
"""Bytes in the log of the database from which it is merged before the period is over."""


class BatchWriter:
    """Writes batches of records to the database and files of meshes beside it."""

    def __init__(self, database: SqliteStore, meshes: str) -> None:
        self._database = database
        self._meshes = Path(meshes)
        self._files = database.folder / FILES
        self._uses: Counter[tuple[str, str]] = Counter()
        self._hashes: dict[int, tuple[Model, str]] = {}
        self._with_files: set[str] = set()
        """Hashes of models whose files are known to exist."""
        self._checkpoint_s = time.monotonic()
        self._count_uses()

    def write(self, records: Sequence[JournalRecord]) -> None:
        """Write a batch durably, all or nothing.

        Raises:
            sqlite3.Error: The database cannot be written.
            OSError: A file cannot be written.
        """
        try:
            self._database.begin()
            for record in records:
                self._apply(record)
            motions = [record.motion for record in records if record.motion is not None]
            if motions:
                self._put(MOTION_KIND, motions[-1].row())
            self._database.commit(records[-1].position)
        except BaseException:
            self._database.rollback()
            self._with_files.clear()
            self._count_uses()
            raise

    def merge_log_if_due(self) -> None:
        """Copy the log into the database file, so that it does not grow without end."""
        is_late = time.monotonic() - self._checkpoint_s >= CHECKPOINT_PERIOD_S
        if not is_late and self._database.log_bytes < MAX_LOG_BYTES:
            return
        self._checkpoint_s = time.monotonic()
        with suppress(sqlite3.Error):  # the changes are durable in the log
            self._database.checkpoint()

    def remove_unused_files(self) -> None:
        """Remove files that no stored model needs."""
        needed: set[str] = set()
        for body in self._database.rows("model").values():
            needed |= list_assets(msgspec.msgpack.decode(body, type=Model))
        for file in self._files.iterdir():
            if file.stem not in needed or file.suffix != ".stl":
                file.unlink()

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _apply(self, record: JournalRecord) -> None:
        for change in record.changes:
            self._apply_change(change)
        if record.world is not None:
            self._put(WORLD_KIND, record.world)
        if record.clock is not None:
            self._put(CLOCK_KIND, record.clock)
        if (response := record.response) is not None:
            self._put("answer", response, make_response_key(response.service, response.request_id))
        for service, request_id in record.expired:
            self._database.remove("answer", make_response_key(service, request_id))

    def _put(self, kind: str, row: msgspec.Struct, key: str = "") -> None:
        self._database.put(kind, key, ENCODER.encode(row))

    def _apply_change(self, change: EntityChange) -> None:
        row = self._make_row(change.after) if change.after else None
        # Each statement waits for the interpreter's lock, which the loop holds; most names are new.
        is_known = ("entity", change.name) in self._database
        before = self._database.body("entity", change.name) if is_known else None
        if before is not None:
            self._count_use(msgspec.msgpack.decode(before, type=EntityRow), -1)
            self._database.remove("entity", change.name)
        if row is not None:
            self._count_use(row, 1)
            self._put("entity", row, row.name)
        for row_key in [row_key for row_key, uses in self._uses.items() if uses <= 0]:
            del self._uses[row_key]
            self._database.remove(*row_key)

    def _count_use(self, row: EntityRow, count: int) -> None:
        self._uses["model", row.model] += count
        self._uses["text", row.text] += count

    def _make_row(self, journaled: JournaledEntity) -> EntityRow:
        entity = journaled.entity
        text = entity.description.encode()
        name = hash_body(text)
        if ("text", name) not in self._database:
            self._database.put("text", name, text)
        return EntityRow(
            ordinal=journaled.ordinal,
            name=entity.name,
            namespace=entity.namespace,
            model=self._put_model(entity.model),
            text=name,
            initial=entity.initial.tobytes(),
            belongs_to_world=entity.belongs_to_world,
            bond=journaled.bond,
            info=entity.info,
            read_as=ParseOptions(*journaled.parse_key[1:])
            if journaled.parse_key is not None
            else None,
        )

    def _put_model(self, model: Model) -> str:
        name = self._hash_model(model)
        if name not in self._with_files:
            self._copy_meshes(model)
            self._with_files.add(name)
        if ("model", name) not in self._database:
            self._database.put("model", name, encode_model(model))
        return name

    def _hash_model(self, model: Model) -> str:
        """Hash a model; models are shared by most spawns, so hashes are cached."""
        if (cached := self._hashes.get(id(model))) is not None:
            return cached[1]
        if len(self._hashes) >= MAX_CACHED_MODEL_HASHES:
            self._hashes.clear()
        name = hash_body(encode_model(model))
        self._hashes[id(model)] = (model, name)
        return name

    def _copy_meshes(self, model: Model) -> None:
        missing = [name for name in list_assets(model) if not self._path(name).exists()]
        for name in missing:
            part = self._files / f"{name}.part"
            copy_synced(self._meshes / f"{name}.stl", part)
            part.rename(self._path(name))
        if missing:
            sync_folder(self._files)

    def _path(self, name: str) -> Path:
        return self._files / f"{name}.stl"

    def _count_uses(self) -> None:
        self._uses.clear()
        for body in self._database.rows("entity").values():
            self._count_use(msgspec.msgpack.decode(body, type=EntityRow), 1)
        for body in self._database.rows("aside").values():
            self._count_use(msgspec.msgpack.decode(body, type=ExcludedEntityRow).entity, 1)


def copy_synced(source: Path, target: Path) -> None:
    """Copy a file durably, but for the entry of its folder."""
    shutil.copyfile(source, target)
    with target.open("rb") as file:
        os.fsync(file.fileno())


END_S = 1.5
"""Time that a server waits for the disk when it ends."""


class RecordSink(Protocol):
    """Destination of records."""

    def write(self, records: Sequence[JournalRecord]) -> None:
        """Write a batch durably, all or nothing."""

    def merge_log_if_due(self) -> None:
        """Do what may take long; the records are durable."""

    def close(self) -> None:
        """Release the destination."""


class WriterThread:
    """Writes the records that the loop submits, and reports the last durable position."""

    def __init__(self, sink: RecordSink, position: int) -> None:
        self.durable = position
        """Position up to which all records are durable."""
        self.commits = self.failures = 0
        self.commit_times = DurationHistogram()
        self.failure: tuple[int, str] | None = None
        """Generation of the last records that could not be written, and the reason."""
        self._sink = sink
        self._failed_generation = -1
        self._queue: SimpleQueue[JournalRecord | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs; otherwise nothing is written any more."""
        return self._thread.is_alive()

    def submit(self, record: JournalRecord) -> None:
        """Queue a record."""
        self._queue.put(record)

    def close(self) -> bool:
        """Write the queued records and end the thread; return whether it ended within `END_S`."""
        self._queue.put(None)
        self._thread.join(END_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        is_last = False
        while not is_last:
            batch = self._batch()
            is_last = batch[-1] is None
            records = [r for r in batch if r is not None and r.generation > self._failed_generation]
            if records:
                self._write(records)
        self._sink.close()

    def _batch(self) -> list[JournalRecord | None]:
        batch = [self._queue.get()]
        # Only this thread removes records, so the queue cannot become empty in between.
        while batch[-1] is not None and not self._queue.empty():
            batch.append(self._queue.get())
        return batch

    def _write(self, records: list[JournalRecord]) -> None:
        began_ns = time.monotonic_ns()
        try:
            self._sink.write(records)
        except (sqlite3.Error, OSError) as error:
            self.failures += 1
            self._failed_generation = records[-1].generation
            self.failure = (self._failed_generation, _format_reason(error))
            return
        self.durable = records[-1].position
        self.commits += 1
        self.commit_times.add(time.monotonic_ns() - began_ns)
        # Last, as the replies to these records do not wait for it.
        self._sink.merge_log_if_due()


def _format_reason(error: Exception) -> str:
    text = (error.strerror if isinstance(error, OSError) else "") or str(error)
    return " ".join(text.split())[:200]
