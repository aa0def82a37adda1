"""The writer thread, and how a batch of records is written to the store in one transaction."""

from __future__ import annotations

import os
import shutil
import sqlite3
import threading
from collections import Counter
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Protocol

import msgspec

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.journal.journal_records import (
    ENCODER,
    EntityRow,
    ExcludedEntityRow,
    ParseOptions,
    encode_model,
    hash_body,
    make_response_key,
)
from zensim.sim_server.journal.sqlite_store import FILES, sync_folder
from zensim.sim_server.parser_process.description_cache import list_meshes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.sim_server.journal.journal_records import (
        EntityChange,
        JournaledEntity,
        JournalRecord,
    )
    from zensim.sim_server.journal.sqlite_store import SqliteStore

MOTION_KIND, CLOCK_KIND, WORLD_KIND = "motion", "clock", "world"
"""Rows of which there is one; their key is empty."""
MAX_CACHED_MODEL_HASHES = 256


class BatchWriter:
    """Writes records into a ledger, a batch at a time."""

    def __init__(self, ledger: SqliteStore, meshes: str) -> None:
        self._ledger = ledger
        self._meshes = Path(meshes)
        self._files = ledger.folder / FILES
        self._uses: Counter[tuple[str, str]] = Counter()
        self._known: dict[int, tuple[Model, str]] = {}
        self._count_uses()

    def keep(self, records: Sequence[JournalRecord]) -> None:
        """Put a batch on the disk, all or nothing.

        Raises:
            sqlite3.Error: It is not there.
            OSError: A file of it is not there.
        """
        try:
            self._ledger.begin()
            for record in records:
                self._apply(record)
            motions = [record.motion for record in records if record.motion is not None]
            if motions:
                self._put(MOTION_KIND, motions[-1].row())
            self._ledger.commit(records[-1].position)
        except BaseException:
            self._ledger.rollback()
            self._count_uses()
            raise

    def remove_unused_files(self) -> None:
        """Remove files that no model of the ledger needs."""
        needed: set[str] = set()
        for body in self._ledger.rows("model").values():
            needed |= list_meshes(msgspec.msgpack.decode(body, type=Model))
        for file in self._files.iterdir():
            if file.stem not in needed or file.suffix != ".stl":
                file.unlink()

    def close(self) -> None:
        """Close the ledger."""
        self._ledger.close()

    def _apply(self, record: JournalRecord) -> None:
        for change in record.changes:
            self._change(change)
        if record.world is not None:
            self._put(WORLD_KIND, record.world)
        if record.clock is not None:
            self._put(CLOCK_KIND, record.clock)
        if (answer := record.answer) is not None:
            self._put("answer", answer, make_response_key(answer.service, answer.request_id))
        for service, request_id in record.forgotten:
            self._ledger.remove("answer", make_response_key(service, request_id))

    def _put(self, kind: str, row: msgspec.Struct, key: str = "") -> None:
        self._ledger.put(kind, key, ENCODER.encode(row))

    def _change(self, change: EntityChange) -> None:
        row = self._row(change.after) if change.after else None
        if (before := self._ledger.body("entity", change.name)) is not None:
            self._use(msgspec.msgpack.decode(before, type=EntityRow), -1)
            self._ledger.remove("entity", change.name)
        if row is not None:
            self._use(row, 1)
            self._put("entity", row, row.name)
        for place in [place for place, count in self._uses.items() if count <= 0]:
            del self._uses[place]
            self._ledger.remove(*place)

    def _use(self, row: EntityRow, count: int) -> None:
        self._uses["model", row.model] += count
        self._uses["text", row.text] += count

    def _row(self, kept: JournaledEntity) -> EntityRow:
        entity = kept.entity
        text = entity.description.encode()
        name = hash_body(text)
        if ("text", name) not in self._ledger:
            self._ledger.put("text", name, text)
        return EntityRow(
            ordinal=kept.ordinal,
            name=entity.name,
            namespace=entity.namespace,
            model=self._keep_model(entity.model),
            text=name,
            initial=entity.initial.tobytes(),
            belongs_to_world=entity.belongs_to_world,
            bond=kept.bond,
            info=entity.info,
            read_as=ParseOptions(*kept.reading[1:]) if kept.reading is not None else None,
        )

    def _keep_model(self, model: Model) -> str:
        name = self._name_of(model)
        if ("model", name) not in self._ledger:
            self._keep_files(model)
            self._ledger.put("model", name, encode_model(model))
        return name

    def _name_of(self, model: Model) -> str:
        """Name a model by its content; most spawns share theirs with others."""
        if (known := self._known.get(id(model))) is not None:
            return known[1]
        if len(self._known) >= MAX_CACHED_MODEL_HASHES:
            self._known.clear()
        name = hash_body(encode_model(model))
        self._known[id(model)] = (model, name)
        return name

    def _keep_files(self, model: Model) -> None:
        missing = [name for name in list_meshes(model) if not self._path(name).exists()]
        for name in missing:
            part = self._files / f"{name}.part"
            shutil.copyfile(self._meshes / f"{name}.stl", part)
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.rename(self._path(name))
        if missing:
            sync_folder(self._files)

    def _path(self, name: str) -> Path:
        return self._files / f"{name}.stl"

    def _count_uses(self) -> None:
        self._uses.clear()
        for body in self._ledger.rows("entity").values():
            self._use(msgspec.msgpack.decode(body, type=EntityRow), 1)
        for body in self._ledger.rows("aside").values():
            self._use(msgspec.msgpack.decode(body, type=ExcludedEntityRow).entity, 1)


END_S = 1.5
"""How long a server that ends waits for the disk."""


class RecordSink(Protocol):
    """Where records end up."""

    def keep(self, records: Sequence[JournalRecord]) -> None:
        """Put a batch on the disk, all or nothing."""

    def close(self) -> None:
        """Let go of it."""


class WriterThread:
    """Takes records from the loop; says up to which position they are on the disk."""

    def __init__(self, disk: RecordSink, position: int) -> None:
        self.durable = position
        """Everything up to here is on the disk."""
        self.commits = 0
        self.failure: tuple[int, str] | None = None
        """Generation of the records that could not be written, and why."""
        self._disk = disk
        self._void = -1
        self._queue: SimpleQueue[JournalRecord | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs; if it does not, nothing is written any more."""
        return self._thread.is_alive()

    def submit(self, record: JournalRecord) -> None:
        """Hand a record over."""
        self._queue.put(record)

    def close(self) -> bool:
        """Write what is left and end; say whether the thread did within `END_S`."""
        self._queue.put(None)
        self._thread.join(END_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        is_over = False
        while not is_over:
            batch = self._batch()
            is_over = batch[-1] is None
            records = [r for r in batch if r is not None and r.generation > self._void]
            if records:
                self._write(records)
        self._disk.close()

    def _batch(self) -> list[JournalRecord | None]:
        batch = [self._queue.get()]
        # Only this thread takes, so what is there stays there.
        while batch[-1] is not None and not self._queue.empty():
            batch.append(self._queue.get())
        return batch

    def _write(self, records: list[JournalRecord]) -> None:
        try:
            self._disk.keep(records)
        except (sqlite3.Error, OSError) as error:
            self._void = records[-1].generation
            self.failure = (self._void, _format_reason(error))
            return
        self.durable = records[-1].position
        self.commits += 1


def _format_reason(error: Exception) -> str:
    text = (error.strerror if isinstance(error, OSError) else "") or str(error)
    return " ".join(text.split())[:200]
