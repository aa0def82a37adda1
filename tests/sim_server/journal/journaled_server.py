"""A server with a journal on a simulated disk, which is fast, slow or full."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from tests.sim_server.fakes import (
    RecordingPublisher,
    ScriptedInbox,
    ServerFixture,
    WallTime,
    a_world,
    make_parts,
)
from zensim.proto.metric_families import DurationHistogram
from zensim.sim_server.journal.batch_writer import BatchWriter
from zensim.sim_server.journal.journal_contents import JournalContents, read_contents
from zensim.sim_server.journal.journal_records import JournalRecord
from zensim.sim_server.journal.server_journal import ChangeTracker, Journal
from zensim.sim_server.journal.sqlite_store import SqliteStore, open_store
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.world.simulated_world import SimulatedWorld

DISK_FULL = "database or disk is full"


class Disk:
    """Writes records like `WriterThread`, at once or, if slow, at `flush`."""

    def __init__(self, batch_writer: BatchWriter, position: int) -> None:
        self.durable = position
        self.commits = self.failures = 0
        self.commit_times = DurationHistogram()
        self.failure: tuple[int, str] | None = None
        self.is_alive = True
        self.is_slow = False
        self.is_full = False
        self.batches: list[list[JournalRecord]] = []
        self._batch_writer = batch_writer
        self._queue: list[JournalRecord] = []
        self._failed_generation = -1

    def submit(self, record: JournalRecord) -> None:
        self._queue.append(record)
        if not self.is_slow:
            self.flush()

    def flush(self) -> None:
        records = [record for record in self._queue if record.generation > self._failed_generation]
        self._queue = []
        if records:
            self._write(records)

    def close(self) -> bool:
        self.is_slow = False
        self.flush()
        self._batch_writer.close()
        return True

    def _write(self, records: Sequence[JournalRecord]) -> None:
        try:
            if self.is_full:
                raise sqlite3.OperationalError(DISK_FULL)
            self._batch_writer.write(records)
        except (sqlite3.Error, OSError) as error:
            self._failed_generation = records[-1].generation
            self.failure = (self._failed_generation, str(error))
            return
        self.durable = records[-1].position
        self.commits += 1
        self.batches.append(list(records))


class JournaledServer:
    """A server loop that journals its world in a folder."""

    def __init__(
        self, folder: Path, *names: str, world: SimulatedWorld | None = None, now_s: float = 5.0
    ) -> None:
        wall = WallTime(round(now_s * 1e9))
        self.folder = folder
        self.database: SqliteStore = open_store(folder)
        journal = Journal(self.database, read_contents(self.database))
        world = world or a_world(*(names if journal.contents is None else ()))
        self.parts = make_parts(world, wall)
        self.refused = journal.restore(world, self.parts.store, wall.now_ns())
        batch_writer = BatchWriter(self.database, self.parts.store.folder)
        self.disk = Disk(batch_writer, self.database.position)
        self.tracker = ChangeTracker(
            self.parts,
            self.disk,
            position=self.database.position,
            known=journal.restored,
            earlier_responses=journal.earlier_responses(),
        )
        journal.prepare(self.parts)
        inbox, publisher = ScriptedInbox(), RecordingPublisher()
        loop = ServerLoop(self.parts, inbox, publisher, wall, self.tracker)
        self.server = ServerFixture(wall, None, world, self.parts, inbox, publisher, loop)  # type: ignore[arg-type]

    @property
    def world(self) -> SimulatedWorld:
        return self.parts.world

    def crash(self) -> None:
        """Lose everything that is not durable."""
        self.database.close()

    def close(self) -> None:
        self.tracker.close()


def read_journal(folder: Path) -> JournalContents:
    """Read the journal of a folder that no server uses."""
    database = open_store(folder)
    try:
        found = read_contents(database)
    finally:
        database.close()
    assert found is not None
    return found
