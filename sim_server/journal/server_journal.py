"""The journal of a server: open, restore without entities that crash, and record."""

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
"""Exists during a restore: a server that finds it crashed while restoring."""
RESPONSE_LIFETIME_S = 3600.0
"""Time for which a repeated request gets the response of an earlier server."""
CRASHED_REASON = "crashed the process that restored it twice"


@dataclass
class Journal:
    """An open journal and its contents."""

    database: SqliteStore
    contents: JournalContents | None
    restored: tuple[JournaledEntity, ...] = ()
    _is_owned_by_tracker: bool = False

    @property
    def files(self) -> Path:
        """Folder of the meshes, named `<sha256>.stl`."""
        return self.database.folder / FILES

    def exclude_crashing(self, make_engine: Callable[[], Engine]) -> None:
        """Exclude entities that crash a process, if the last server crashed while restoring.

        Call it before any thread is started: it forks this process.
        """
        if self.contents is None or not self._mark.exists():
            return
        LOG.warning("the last start crashed while restoring; each entity is tested in a fork first")
        rows = self.contents.entities
        crashing = find_crashing(_make_restore_attempts(self.contents, make_engine))
        with raising_journal_errors(self.database.folder):
            commit_restore(
                self.database,
                [ExcludedEntityRow(entity=rows[i], reason=CRASHED_REASON) for i in crashing],
            )
        self.contents = read_contents(self.database)

    def restore(self, world: World, store: AssetStore, now_ns: int) -> tuple[str, ...]:
        """Restore the entities, states and clock of a world; return the names of refused entities.

        Raises:
            JournalError: The journal cannot be written.
        """
        if self.contents is None:
            return ()
        with raising_journal_errors(self.database.folder):
            return self._restore(self.contents, world, store, now_ns)

    def _restore(
        self, contents: JournalContents, world: World, store: AssetStore, now_ns: int
    ) -> tuple[str, ...]:
        self._mark.touch()
        sync_folder(self.database.folder)
        result = restore_world(contents, world, MeshRestorer(self.files, store), now_ns)
        self.restored = tuple(result.restored)
        clock = msgspec.structs.replace(
            contents.clock, epoch=world.clock.epoch, steps=world.clock.steps
        )
        commit_restore(self.database, result.refused, clock)
        self._mark.unlink()
        return tuple(row.entity.name for row in result.refused)

    def prepare(self, parts: ServerParts) -> None:
        """Restore what is not in the world: resource, bonds, parsed descriptions."""
        if self.contents is not None:
            parts.current_world.resource = self.contents.world.resource
        for one in self.restored:
            if one.parse_key is not None:
                parts.descriptions.provider.remember(one.parse_key, one.entity.model)
            if one.bond:
                parts.bonds.add(one.bond, one.entity)

    def record(self, parts: ServerParts) -> ChangeTracker:
        """Start recording changes after the last position."""
        self.prepare(parts)
        batch_writer = BatchWriter(self.database, parts.store.folder)
        with raising_journal_errors(self.database.folder):
            batch_writer.remove_unused_files()
        writer = WriterThread(batch_writer, self.database.position)
        writer.start()
        self._is_owned_by_tracker = True
        position = self.database.position
        return ChangeTracker(
            parts,
            writer,
            position=position,
            known=self.restored,
            earlier_responses=self.recent_responses(time.time()),
            wall_s=time.time,
        )

    def close(self) -> None:
        """Close the database, unless a change tracker owns it."""
        if not self._is_owned_by_tracker:
            self.database.close()

    def recent_responses(self, now_s: float) -> tuple[JournaledResponse, ...]:
        """List the responses that have not expired."""
        responses = self.contents.responses if self.contents else ()
        oldest_s = now_s - RESPONSE_LIFETIME_S
        return tuple(
            JournaledResponse(row.service, row.request_id, row.payload, row.encoding)
            for row in responses
            if row.at_s >= oldest_s
        )

    @property
    def _mark(self) -> Path:
        return self.database.folder / RESTORE_MARK_FILE


def open_journal(folder: str) -> Journal:
    """Open or create the journal of a folder.

    Raises:
        JournalError: It cannot be used.
    """
    database = open_store(Path(folder))
    try:
        contents = read_contents(database)
    except BaseException:
        database.close()
        raise
    if database.lost:
        LOG.warning(
            "journal %s was truncated: its last %d changes are lost; continuing after change %d",
            database.folder,
            database.lost,
            database.position,
        )
    return Journal(database, contents)


def _make_restore_attempts(
    contents: JournalContents, make_engine: Callable[[], Engine]
) -> list[Callable[[], None]]:
    engines: list[Engine] = []

    def attempt(index: int) -> None:
        if not engines:
            engines.append(make_engine())
        spawn = make_spawn_request(contents, contents.entities[index], 0)
        body = engines[0].add(spawn.model, spawn.base)
        engines[0].set_at_rest(body, *contents.last_state(contents.entities[index]))
        engines[0].step()

    return [lambda index=i: attempt(index) for i in range(len(contents.entities))]  # type: ignore[misc]
