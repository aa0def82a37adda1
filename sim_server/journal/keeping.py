"""What a record does to the ledger: models, texts and files are kept once for all their users."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.journal.ledger import FILES, sync_folder
from zensim.sim_server.journal.rows import (
    ENCODER,
    AsideRow,
    EntityRow,
    ReadAs,
    answer_key,
    body_of,
    sha256_of,
)
from zensim.sim_server.reading.descriptions import meshes_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.sim_server.journal.ledger import Ledger
    from zensim.sim_server.journal.records import Change, Kept, Record

MOTION, CLOCK, WORLD = "motion", "clock", "world"
"""Rows of which there is one; their key is empty."""
KNOWN_MODELS = 256


class Keeper:
    """Writes records into a ledger, a batch at a time."""

    def __init__(self, ledger: Ledger, meshes: str) -> None:
        self._ledger = ledger
        self._meshes = Path(meshes)
        self._files = ledger.folder / FILES
        self._uses: Counter[tuple[str, str]] = Counter()
        self._known: dict[int, tuple[Model, str]] = {}
        self._count_uses()

    def keep(self, records: Sequence[Record]) -> None:
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
                self._put(MOTION, motions[-1].row())
            self._ledger.commit(records[-1].position)
        except BaseException:
            self._ledger.rollback()
            self._count_uses()
            raise

    def sweep(self) -> None:
        """Remove files that no model of the ledger needs."""
        needed: set[str] = set()
        for body in self._ledger.rows("model").values():
            needed |= meshes_of(msgspec.msgpack.decode(body, type=Model))
        for file in self._files.iterdir():
            if file.stem not in needed or file.suffix != ".stl":
                file.unlink()

    def close(self) -> None:
        """Close the ledger."""
        self._ledger.close()

    def _apply(self, record: Record) -> None:
        for change in record.changes:
            self._change(change)
        if record.world is not None:
            self._put(WORLD, record.world)
        if record.clock is not None:
            self._put(CLOCK, record.clock)
        if (answer := record.answer) is not None:
            self._put("answer", answer, answer_key(answer.service, answer.request_id))
        for service, request_id in record.forgotten:
            self._ledger.remove("answer", answer_key(service, request_id))

    def _put(self, kind: str, row: msgspec.Struct, key: str = "") -> None:
        self._ledger.put(kind, key, ENCODER.encode(row))

    def _change(self, change: Change) -> None:
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

    def _row(self, kept: Kept) -> EntityRow:
        entity = kept.entity
        text = entity.description.encode()
        name = sha256_of(text)
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
            read_as=ReadAs(*kept.reading[1:]) if kept.reading is not None else None,
        )

    def _keep_model(self, model: Model) -> str:
        name = self._name_of(model)
        if ("model", name) not in self._ledger:
            self._keep_files(model)
            self._ledger.put("model", name, body_of(model))
        return name

    def _name_of(self, model: Model) -> str:
        """Name a model by its content; most spawns share theirs with others."""
        if (known := self._known.get(id(model))) is not None:
            return known[1]
        if len(self._known) >= KNOWN_MODELS:
            self._known.clear()
        name = sha256_of(body_of(model))
        self._known[id(model)] = (model, name)
        return name

    def _keep_files(self, model: Model) -> None:
        missing = [name for name in meshes_of(model) if not self._path(name).exists()]
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
            self._use(msgspec.msgpack.decode(body, type=AsideRow).entity, 1)
