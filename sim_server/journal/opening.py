"""A journal as a server finds it at its start, and what of it is better left alone."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.journal.keeping import Keeper
from zensim.sim_server.journal.ledger import FILES, Ledger, as_one_line, open_ledger, sync_folder
from zensim.sim_server.journal.probing import deadly
from zensim.sim_server.journal.recorder import Recorder
from zensim.sim_server.journal.restoring import (
    Contents,
    Shelf,
    birth_of,
    contents_of,
    restore,
    seal,
)
from zensim.sim_server.journal.rows import AsideRow
from zensim.sim_server.journal.writer import Writer
from zensim.sim_server.journal_protocol import JournaledResponse

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.sim_server.journal.records import Kept
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.reading.assets import AssetStore
    from zensim.sim_server.server_context import ServerContext
    from zensim.sim_server.world.world import World

LOG = logging.getLogger(__name__)
MARK = "restoring"
"""Is there from the beginning of a restore to its end: a server that finds it died in between."""
ANSWERS_S = 3600.0
"""How long a retry gets the answer of an earlier server."""
KILLED = "ended the process that restored it, twice"


@dataclass
class Journal:
    """An open journal, and what it held."""

    ledger: Ledger
    contents: Contents | None
    kept: tuple[Kept, ...] = ()
    _is_handed_over: bool = False

    @property
    def files(self) -> Path:
        """Where `<sha256>.stl` is for each mesh of a model."""
        return self.ledger.folder / FILES

    def leave_out_deadly(self, make_engine: Callable[[], Engine]) -> None:
        """Set aside what kills a server, if the last one died while it restored.

        Call it before anything has threads: it makes copies of this process.
        """
        if self.contents is None or not self._mark.exists():
            return
        LOG.warning("the last start died while it restored; each entity is tried apart first")
        rows = self.contents.entities
        guilty = deadly(_tries(self.contents, make_engine))
        with as_one_line(self.ledger.folder):
            seal(self.ledger, [AsideRow(entity=rows[i], reason=KILLED) for i in guilty])
        self.contents = contents_of(self.ledger)

    def restore(self, world: World, store: AssetStore, now_ns: int) -> tuple[str, ...]:
        """Make a world as it was; name who could not be made again.

        Raises:
            JournalError: The journal cannot be written.
        """
        if self.contents is None:
            return ()
        with as_one_line(self.ledger.folder):
            return self._restore(self.contents, world, store, now_ns)

    def _restore(
        self, contents: Contents, world: World, store: AssetStore, now_ns: int
    ) -> tuple[str, ...]:
        self._mark.touch()
        sync_folder(self.ledger.folder)
        restored = restore(contents, world, Shelf(self.files, store), now_ns)
        self.kept = tuple(restored.kept)
        clock = msgspec.structs.replace(contents.clock, epoch=world.epoch, steps=world.steps)
        seal(self.ledger, restored.refused, clock)
        self._mark.unlink()
        return tuple(row.entity.name for row in restored.refused)

    def prepare(self, context: ServerContext, now_s: float) -> None:
        """Give a desk what is no part of its world: answers, bonds, and what was read."""
        context.told = self._told(now_s)
        if self.contents is not None:
            context.resource = self.contents.world.resource
        for kept in self.kept:
            if kept.reading is not None:
                context.descriptions.remember(kept.reading, kept.entity.model)
            if kept.bond:
                held = context.bonded_entities.setdefault(kept.bond, [])
                held.append((kept.entity.name, kept.entity.born_ns))

    def record(self, context: ServerContext) -> Recorder:
        """Go on where the journal ended."""
        self.prepare(context, time.time())
        keeper = Keeper(self.ledger, context.store.folder)
        with as_one_line(self.ledger.folder):
            keeper.sweep()
        writer = Writer(keeper, self.ledger.position)
        writer.start()
        self._is_handed_over = True
        position = self.ledger.position
        recorder = Recorder(context, writer, position=position, known=self.kept, wall_s=time.time)
        context.journal = recorder
        return recorder

    def close(self) -> None:
        """Let go of the folder, unless a recorder has done so."""
        if not self._is_handed_over:
            self.ledger.close()

    def _told(self, now_s: float) -> tuple[JournaledResponse, ...]:
        """What was answered not too long ago."""
        answers = self.contents.answers if self.contents else ()
        oldest_s = now_s - ANSWERS_S
        return tuple(
            JournaledResponse(row.service, row.request_id, row.payload, row.encoding)
            for row in answers
            if row.at_s >= oldest_s
        )

    @property
    def _mark(self) -> Path:
        return self.ledger.folder / MARK


def open_journal(folder: str) -> Journal:
    """Open the journal of a folder, or begin one.

    Raises:
        JournalError: It cannot be used.
    """
    ledger = open_ledger(Path(folder))
    try:
        contents = contents_of(ledger)
    except BaseException:
        ledger.close()
        raise
    if ledger.lost:
        LOG.warning(
            "journal %s was cut short: its last %d changes are lost; going on from change %d",
            os.fspath(ledger.folder),
            ledger.lost,
            ledger.position,
        )
    return Journal(ledger, contents)


def _tries(contents: Contents, make_engine: Callable[[], Engine]) -> list[Callable[[], None]]:
    engines: list[Engine] = []

    def attempt(number: int) -> None:
        if not engines:
            engines.append(make_engine())
        birth = birth_of(contents, contents.entities[number], 0)
        body = engines[0].add(birth.model, birth.base)
        engines[0].rest(body, *contents.stand(contents.entities[number]))
        engines[0].step()

    return [lambda number=i: attempt(number) for i in range(len(contents.entities))]  # type: ignore[misc]
