"""The journal as a server opens it, and isolation of entities that crash a restore."""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.child_process import run_in_fork
from zensim.sim_server.journal.batch_writer import BatchWriter, WriterThread
from zensim.sim_server.journal.change_tracker import ChangeTracker
from zensim.sim_server.journal.journal_contents import (
    JournalContents,
    MeshRestorer,
    commit_restore,
    make_spawn_request,
    read_contents,
    restore_world,
)
from zensim.sim_server.journal.journal_records import ExcludedEntityRow
from zensim.sim_server.journal.sqlite_store import (
    FILES,
    SqliteStore,
    open_store,
    raising_journal_errors,
    sync_folder,
)
from zensim.sim_server.journal_protocol import JournaledResponse

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.sim_server.journal.journal_records import JournaledEntity
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.service_parts import ServerParts
    from zensim.sim_server.world.simulated_world import World

DEADLINE_S = 10.0
"""For one attempt."""
MAX_CRASHES = 2
"""Crashes of a process after which an entity is excluded."""


def find_crashing(attempts: Sequence[Callable[[], None]]) -> list[int]:
    """Run attempts in order, in copies of this process; return the indices of those that crash it.

    An attempt that raises is harmless. One that ends its process is repeated in the next copy,
    without those that crashed twice already.
    """
    crashes: dict[int, int] = {}
    while (
        index := _find_first_crash(attempts, [i for i in crashes if crashes[i] >= MAX_CRASHES])
    ) is not None:
        crashes[index] = crashes.get(index, 0) + 1
    return [index for index, count in crashes.items() if count >= MAX_CRASHES]


def _find_first_crash(attempts: Sequence[Callable[[], None]], excluded: list[int]) -> int | None:
    included = [index for index in range(len(attempts)) if index not in excluded]
    if not included:
        return None

    def run(report: Callable[[int], None]) -> None:
        for index in included:
            report(index)
            # The restore that follows reports exceptions.
            with suppress(Exception):
                attempts[index]()

    last, status = run_in_fork(run, DEADLINE_S)
    return last if status else None


LOG = logging.getLogger(__name__)
RESTORE_MARK_FILE = "restoring"
"""Is there from the beginning of a restore to its end: a server that finds it died in between."""
RESPONSE_LIFETIME_S = 3600.0
"""How long a retry gets the answer of an earlier server."""
CRASHED_REASON = "ended the process that restored it, twice"


@dataclass
class Journal:
    """An open journal, and what it held."""

    ledger: SqliteStore
    contents: JournalContents | None
    kept: tuple[JournaledEntity, ...] = ()
    _is_owned_by_tracker: bool = False

    @property
    def files(self) -> Path:
        """Where `<sha256>.stl` is for each mesh of a model."""
        return self.ledger.folder / FILES

    def exclude_crashing(self, make_engine: Callable[[], Engine]) -> None:
        """Set aside what kills a server, if the last one died while it restored.

        Call it before anything has threads: it makes copies of this process.
        """
        if self.contents is None or not self._mark.exists():
            return
        LOG.warning("the last start died while it restored; each entity is tried apart first")
        rows = self.contents.entities
        guilty = find_crashing(_make_restore_attempts(self.contents, make_engine))
        with raising_journal_errors(self.ledger.folder):
            commit_restore(
                self.ledger,
                [ExcludedEntityRow(entity=rows[i], reason=CRASHED_REASON) for i in guilty],
            )
        self.contents = read_contents(self.ledger)

    def restore(self, world: World, store: AssetStore, now_ns: int) -> tuple[str, ...]:
        """Make a world as it was; name who could not be made again.

        Raises:
            JournalError: The journal cannot be written.
        """
        if self.contents is None:
            return ()
        with raising_journal_errors(self.ledger.folder):
            return self._restore(self.contents, world, store, now_ns)

    def _restore(
        self, contents: JournalContents, world: World, store: AssetStore, now_ns: int
    ) -> tuple[str, ...]:
        self._mark.touch()
        sync_folder(self.ledger.folder)
        restored = restore_world(contents, world, MeshRestorer(self.files, store), now_ns)
        self.kept = tuple(restored.kept)
        clock = msgspec.structs.replace(
            contents.clock, epoch=world.clock.epoch, steps=world.clock.steps
        )
        commit_restore(self.ledger, restored.refused, clock)
        self._mark.unlink()
        return tuple(row.entity.name for row in restored.refused)

    def prepare(self, parts: ServerParts) -> None:
        """Restore the parts that are not in the world: resource, bonds, parsed descriptions."""
        if self.contents is not None:
            parts.current_world.resource = self.contents.world.resource
        for kept in self.kept:
            if kept.reading is not None:
                parts.descriptions.provider.remember(kept.reading, kept.entity.model)
            if kept.bond:
                parts.bonds.add(kept.bond, kept.entity)

    def record(self, parts: ServerParts) -> ChangeTracker:
        """Go on where the journal ended."""
        self.prepare(parts)
        keeper = BatchWriter(self.ledger, parts.store.folder)
        with raising_journal_errors(self.ledger.folder):
            keeper.remove_unused_files()
        writer = WriterThread(keeper, self.ledger.position)
        writer.start()
        self._is_owned_by_tracker = True
        position = self.ledger.position
        return ChangeTracker(
            parts,
            writer,
            position=position,
            known=self.kept,
            earlier_responses=self.recent_responses(time.time()),
            wall_s=time.time,
        )

    def close(self) -> None:
        """Let go of the folder, unless a recorder has done so."""
        if not self._is_owned_by_tracker:
            self.ledger.close()

    def recent_responses(self, now_s: float) -> tuple[JournaledResponse, ...]:
        """What was answered not too long ago."""
        answers = self.contents.answers if self.contents else ()
        oldest_s = now_s - RESPONSE_LIFETIME_S
        return tuple(
            JournaledResponse(row.service, row.request_id, row.payload, row.encoding)
            for row in answers
            if row.at_s >= oldest_s
        )

    @property
    def _mark(self) -> Path:
        return self.ledger.folder / RESTORE_MARK_FILE


def open_journal(folder: str) -> Journal:
    """Open the journal of a folder, or begin one.

    Raises:
        JournalError: It cannot be used.
    """
    ledger = open_store(Path(folder))
    try:
        contents = read_contents(ledger)
    except BaseException:
        ledger.close()
        raise
    if ledger.lost:
        LOG.warning(
            "journal %s was cut short: its last %d changes are lost; going on from change %d",
            ledger.folder,
            ledger.lost,
            ledger.position,
        )
    return Journal(ledger, contents)


def _make_restore_attempts(
    contents: JournalContents, make_engine: Callable[[], Engine]
) -> list[Callable[[], None]]:
    engines: list[Engine] = []

    def attempt(number: int) -> None:
        if not engines:
            engines.append(make_engine())
        birth = make_spawn_request(contents, contents.entities[number], 0)
        body = engines[0].add(birth.model, birth.base)
        engines[0].set_at_rest(body, *contents.stand(contents.entities[number]))
        engines[0].step()

    return [lambda number=i: attempt(number) for i in range(len(contents.entities))]  # type: ignore[misc]
