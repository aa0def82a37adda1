"""A stage with a journal whose disk is written at once, or fails, or waits to be told."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from tests.sim_server.fakes import RecordingOutlet, ScriptedInbox, Stage, WallTime, a_desk, a_world
from zensim.sim_server.journal.batch_writer import BatchWriter
from zensim.sim_server.journal.change_tracker import ChangeTracker
from zensim.sim_server.journal.journal_contents import JournalContents, read_contents
from zensim.sim_server.journal.journal_records import JournalRecord
from zensim.sim_server.journal.server_journal import Journal
from zensim.sim_server.journal.sqlite_store import SqliteStore, open_store
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.world.simulated_world import World

DISK_FULL = "database or disk is full"


class Disk:
    """Writes as the thread does, but when told to: `flush`."""

    def __init__(self, keeper: BatchWriter, position: int) -> None:
        self.durable = position
        self.commits = 0
        self.failure: tuple[int, str] | None = None
        self.is_alive = True
        self.is_slow = False
        self.is_full = False
        self.batches: list[list[JournalRecord]] = []
        self._keeper = keeper
        self._queue: list[JournalRecord] = []
        self._void = -1

    def submit(self, record: JournalRecord) -> None:
        self._queue.append(record)
        if not self.is_slow:
            self.flush()

    def flush(self) -> None:
        records = [record for record in self._queue if record.generation > self._void]
        self._queue = []
        if records:
            self._write(records)

    def close(self) -> bool:
        self.is_slow = False
        self.flush()
        self._keeper.close()
        return True

    def _write(self, records: Sequence[JournalRecord]) -> None:
        try:
            if self.is_full:
                raise sqlite3.OperationalError(DISK_FULL)
            self._keeper.keep(records)
        except (sqlite3.Error, OSError) as error:
            self._void = records[-1].generation
            self.failure = (self._void, str(error))
            return
        self.durable = records[-1].position
        self.commits += 1
        self.batches.append(list(records))


class Journalled:
    """A loop whose world is kept in a folder."""

    def __init__(self, folder: Path, *names: str, world: World | None = None) -> None:
        wall = WallTime()
        self.folder = folder
        self.ledger: SqliteStore = open_store(folder)
        journal = Journal(self.ledger, read_contents(self.ledger))
        world = world or a_world(*(names if journal.contents is None else ()))
        self.context = a_desk(world, wall)
        self.refused = journal.restore(world, self.context.store, wall.now_ns())
        keeper = BatchWriter(self.ledger, self.context.store.folder)
        self.disk = Disk(keeper, self.ledger.position)
        self.recorder = ChangeTracker(
            self.context,
            self.disk,
            position=self.ledger.position,
            known=journal.kept,
            wall_s=lambda: wall.now_ns() * 1e-9,
        )
        self.context.journal = self.recorder
        journal.prepare(self.context, now_s=wall.now_ns() * 1e-9)
        inbox, outlet = ScriptedInbox(), RecordingOutlet()
        loop = ServerLoop(self.context, inbox, outlet, wall)
        self.stage = Stage(wall, None, world, self.context, inbox, outlet, loop)  # type: ignore[arg-type]

    @property
    def world(self) -> World:
        return self.context.world

    def crash(self) -> None:
        """Lose everything that is not on the disk."""
        self.ledger.close()

    def close(self) -> None:
        self.recorder.close()


def contents_in(folder: Path) -> JournalContents:
    """Read what a folder holds that nobody uses."""
    ledger = open_store(folder)
    try:
        found = read_contents(ledger)
    finally:
        ledger.close()
    assert found is not None
    return found


def an_empty_store() -> AssetStore:
    return AssetStore()
