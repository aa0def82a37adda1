"""The journal of a server: open, restore without entities that crash, and record."""

from __future__ import annotations

import logging
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec
import numpy as np

from zensim.proto.child_process import run_in_fork
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.process_limits import sync_folder
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal.batch_writer import BatchWriter, WriterThread
from zensim.sim_server.journal.journal_contents import (
    JournalContents,
    MeshRestorer,
    commit_restore,
    make_spawn_request,
    read_contents,
    restore_world,
)
from zensim.sim_server.journal.journal_records import (
    ClockRow,
    EntityChange,
    EntityRow,
    ExcludedEntityRow,
    JournaledEntity,
    JournalRecord,
    RecordedMotion,
    ResponseRow,
    WorldRow,
)
from zensim.sim_server.journal.restore_progress import RESTORE_MARK_FILE, RestoreProgress
from zensim.sim_server.journal.sqlite_store import (
    FILES,
    SqliteStore,
    open_store,
    raising_journal_errors,
)
from zensim.sim_server.journal_protocol import JournaledResponse
from zensim.sim_server.physics.engine import EngineLost
from zensim.sim_server.world.spawn_request import ValidatedSpawn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from zensim.proto.metric_families import DurationHistogram
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.physics.engine import Engine, FloatArray
    from zensim.sim_server.service_parts import ServerParts
    from zensim.sim_server.world.entity import Entity
    from zensim.sim_server.world.entity_store import EntityStore
    from zensim.sim_server.world.simulated_world import SimulatedWorld

LOG = logging.getLogger(__name__)
MOTION_PERIOD_S = 0.4
"""Period of recording states: with the time of a commit at most 0.5 s."""
MAX_MOTION_DELAY_NS = 40_000_000
"""Longest delay of a recording to a control step, whose states are read anyway."""
BOND_TIMEOUT_S = 10.0
"""Time after a restart for clients to renew their bonds."""

TRANSIENT_STATES = (State.LOADING_WORLD, State.QUITTING)
"""States that are not recorded: no server starts in them."""
DEADLINE_S = 10.0
"""Time for one attempt."""
MAX_CRASHES = 2
"""Crashes of a process after which an entity is excluded."""
ASSETS = "assets"
CRASHED_REASON = "crashed the process that restored it twice"


class RecordQueue(Protocol):
    """The writer of records, see `WriterThread`."""

    durable: int
    commits: int
    failures: int
    commit_times: DurationHistogram
    failure: tuple[int, str] | None

    @property
    def is_alive(self) -> bool:
        """Whether records are written."""

    def submit(self, record: JournalRecord) -> None:
        """Queue a record."""

    def close(self) -> bool:
        """Write the queued records and end; return whether that worked."""


class WriterEnded(RuntimeError):
    """The writer thread has ended; the server must end, too."""


class ChangeTracker:
    """Records the changes of one world."""

    def __init__(
        self,
        parts: ServerParts,
        writer: RecordQueue,
        *,
        position: int,
        known: Iterable[JournaledEntity] = (),
        earlier_responses: tuple[JournaledResponse, ...] = (),
    ) -> None:
        self.position = position
        """Position of the newest record."""
        self.earlier_responses = earlier_responses
        self._parts = parts
        self._writer = writer
        self._generation = 0
        self._known = {one.entity.name: one for one in known}
        self._followed: EntityStore | None = None
        """Store whose changes are known; None = compare all entities with those known."""
        self._next_ordinal = max((one.ordinal for one in self._known.values()), default=0) + 1
        self._outstanding: deque[JournalRecord] = deque()
        self._seen: tuple[object, ...] = ()
        self._world: WorldRow | None = None
        self._clock: ClockRow | None = None
        self._motion: RecordedMotion | None = None
        self._motion_seen: tuple[int, ...] = ()
        self._deleted: set[str] = set()
        self._motion_due_ns = 0
        self._is_failing = False
        self._commits = 0
        self._bonds_due_ns = parts.pacing.now_ns() + round(BOND_TIMEOUT_S * NANOSECONDS)

    @property
    def commit_times(self) -> DurationHistogram:
        """Wall times of commits."""
        return self._writer.commit_times

    @property
    def failures(self) -> int:
        """Number of commits that failed."""
        return self._writer.failures

    @property
    def durable(self) -> int:
        """The last durable position."""
        return self._writer.durable

    @property
    def is_failing(self) -> bool:
        """Whether the last record could not be written, and none was written since."""
        if self._is_failing and self._writer.commits > self._commits:
            self._is_failing = False
            LOG.warning("journal written again world=%s", self._parts.world.name)
        return self._is_failing

    def record(
        self,
        response: JournaledResponse | None = None,
        expired: tuple[tuple[str, bytes], ...] = (),
        *,
        is_requested: bool = False,
    ) -> int:
        """See `ChangeJournal.record`."""
        if not is_requested and self._fingerprint() == self._seen:
            return self.position
        changes, former = self._find_changes(), self._motion
        world, clock = self._find_new_world(), self._find_new_clock()
        has_moved = self._motion_fingerprint() != self._motion_seen or self._is_name_reused(changes)
        if changes or world or clock or response or expired or (is_requested and has_moved):
            self._submit(
                JournalRecord(
                    self._generation,
                    self.position + 1,
                    changes,
                    world,
                    clock,
                    self._take_motion() if has_moved else None,
                    self._make_response_row(response),
                    expired,
                    is_requested,
                    former,
                )
            )
        return self.position

    def poll(self) -> str:
        """See `ChangeJournal.poll`; records states, too, when they are due.

        Raises:
            WriterEnded: The writer thread has ended.
        """
        if not self._writer.is_alive:
            raise WriterEnded("the writer thread of the journal has ended")
        reason = self._handle_failure()
        self._drop_durable()
        self._end_lost_bonds()
        self.record()
        if self._is_motion_due():
            self._record_motion()
        return reason

    def retry(self) -> int:
        """Write a record now, to test the disk; return the number of the attempt."""
        self._submit(JournalRecord(self._generation, self.position, motion=self._take_motion()))
        return self._generation

    def is_decided(self, attempt: int) -> bool:
        """Whether the result of an attempt is known."""
        return not self.is_failing or self._generation > attempt

    def close(self) -> bool:
        """Write all changes and end; return whether that worked."""
        self.record()
        self._record_motion()
        return self._writer.close()

    def _make_response_row(self, response: JournaledResponse | None) -> ResponseRow | None:
        if response is None:
            return None
        return ResponseRow(
            # Durable positions only increase, and a record has at most one response.
            number=self.position + 1,
            service=response.service,
            request_id=response.request_id,
            payload=response.payload,
            encoding=response.encoding,
        )

    def _submit(self, record: JournalRecord) -> None:
        if record.position > self.position:
            self._outstanding.append(record)
            self.position = record.position
        self._writer.submit(record)

    def _end_lost_bonds(self) -> None:
        """Delete the entities of bonds that were not renewed after a restart."""
        if not self._bonds_due_ns or self._parts.pacing.now_ns() < self._bonds_due_ns:
            return
        self._bonds_due_ns = 0
        for bond in self._parts.bonds.entities.keys() - self._parts.bonds.alive:
            self._parts.bonds.end(bond)

    def _drop_durable(self) -> None:
        durable = self._writer.durable
        while self._outstanding and self._outstanding[0].position <= durable:
            self._outstanding.popleft()

    def _fingerprint(self) -> tuple[object, ...]:
        """Cheap values that differ when something has changed."""
        world = self._parts.world
        factor = self._parts.pacing.target_real_time_factor
        return (
            world.entities.roster_number,
            world.clock.epoch,
            world.clock.state,
            factor,
            id(self._parts.current_world.model),
        )

    def _motion_fingerprint(self) -> tuple[int, ...]:
        world = self._parts.world
        return (world.placement_count, world.clock.epoch)

    def _find_changes(self) -> tuple[EntityChange, ...]:
        self._seen = self._fingerprint()
        known, present = self._known, self._parts.world.entities.by_name
        before, after = self._list_changed()
        changes = [
            EntityChange(name, known[name], None)
            for name in before
            if name in known and name not in present
        ]
        found = (self._find_change(present[name]) for name in after if name in present)
        changes += [change for change in found if change is not None]
        for change in changes:
            if change.after is None:
                del known[change.name]
        return tuple(changes)

    def _list_changed(self) -> tuple[Iterable[str], Iterable[str]]:
        """List entities that may have gone, and those that may have come or been replaced."""
        entities = self._parts.world.entities
        names = entities.take_changed()
        if names is None or entities is not self._followed:
            self._followed = entities
            return tuple(self._known), tuple(entities.by_name)
        return names, names

    def _find_change(self, entity: Entity) -> EntityChange | None:
        name = entity.name
        before = self._known.get(name)
        if before is not None and before.entity is entity:
            return None
        after = JournaledEntity(
            self._find_ordinal(before, entity.born_ns),
            entity,
            self._bond_of(name),
            self._parts.descriptions.provider.find_parse_key(entity.model),
        )
        self._known[name] = after
        is_same = before is not None and before.has_same_row(after)
        return None if is_same else EntityChange(name, before, after)

    def _is_name_reused(self, changes: tuple[EntityChange, ...]) -> bool:
        """Whether the last states, found by name, have an entity that was there before."""
        spawned = {change.name for change in changes if change.is_spawn}
        replaced = {change.name for change in changes if change.is_spawn and change.before}
        is_reused = bool(replaced or spawned & self._deleted)
        self._deleted |= {change.name for change in changes if change.after is None}
        return is_reused

    def _find_ordinal(self, before: JournaledEntity | None, born_ns: int) -> int:
        if before is not None and before.entity.born_ns == born_ns:
            return before.ordinal
        self._next_ordinal += 1
        return self._next_ordinal - 1

    def _bond_of(self, name: str) -> str:
        born_ns = self._parts.world.entities.find(name).born_ns
        for bond, held in self._parts.bonds.entities.items():
            if (name, born_ns) in held:
                return bond
        return ""

    def _find_new_world(self) -> WorldRow | None:
        world, current = self._parts.world, self._parts.current_world
        if self._world is not None and self._world.source is current.model:
            return None
        self._world = WorldRow(
            name=world.name,
            source=current.model,
            step_rate_hz=NANOSECONDS / world.clock.step_ns,
            seed=current.seed,
            resource=current.resource,
        )
        return self._world

    def _find_new_clock(self) -> ClockRow | None:
        world, last = self._parts.world, self._clock
        factor = self._parts.pacing.target_real_time_factor
        state = int(world.clock.state)
        if last is not None and world.clock.state in TRANSIENT_STATES:
            state = last.state
        now = (world.clock.epoch, state, factor)
        if last is not None and (last.epoch, last.state, last.real_time_factor) == now:
            return None
        self._clock = ClockRow(
            epoch=world.clock.epoch, steps=world.clock.steps, state=state, real_time_factor=factor
        )
        return self._clock

    def _is_motion_due(self) -> bool:
        """Whether to record states: preferably at a control step, when they are read anyway."""
        late_ns = self._parts.pacing.now_ns() - self._motion_due_ns
        return late_ns >= (0 if self._parts.world.is_control_step else MAX_MOTION_DELAY_NS)

    def _record_motion(self) -> None:
        self._motion_due_ns = self._parts.pacing.now_ns() + round(MOTION_PERIOD_S * NANOSECONDS)
        if self._is_failing:
            self._seen = ()  # changes that could not be written are submitted again
            self.record()
        world, last = self._parts.world, self._motion
        is_old = last is None or (last.epoch, last.steps) != (world.clock.epoch, world.clock.steps)
        is_old = is_old or last is None or last.names != world.entities.index.names
        if is_old or self._motion_fingerprint() != self._motion_seen or self._is_failing:
            self._submit(JournalRecord(self._generation, self.position, motion=self._take_motion()))

    def _take_motion(self) -> RecordedMotion:
        world = self._parts.world
        roster, reading = world.entities.index, world.states()
        self._motion_seen = self._motion_fingerprint()
        self._deleted.clear()
        self._motion = RecordedMotion(
            world.clock.epoch, world.clock.steps, roster.names, roster.joint_count, reading
        )
        return self._motion

    def _handle_failure(self) -> str:
        failure = self._writer.failure
        if failure is None or failure[0] < self._generation:
            return ""
        if not self._is_failing:
            LOG.warning("journal not written reason=%s", failure[1])
        self._generation += 1
        self._is_failing = True
        self._followed = None
        self._commits = self._writer.commits
        self._drop_durable()
        while self._outstanding:
            self._revert(self._outstanding.pop())
        self.position = self._writer.durable
        self._take_motion()  # the last one may lack entities that are back
        self._motion_seen = ()
        self._seen = self._fingerprint()
        return failure[1]

    def _revert(self, record: JournalRecord) -> None:
        """Undo the changes of a request; other changes, times and worlds are submitted again."""
        self._world = None if record.world is not None else self._world
        self._clock = None if record.clock is not None else self._clock
        for change in reversed(record.changes):
            self._known.pop(change.name, None)
            if change.before is not None:
                self._known[change.name] = change.before
            if record.is_requested and record.world is None:
                self._undo(change, record.former)

    def _undo(self, change: EntityChange, former: RecordedMotion | None) -> None:
        name, world, before, after = change.name, self._parts.world, change.before, change.after
        is_there = name in world.entities
        if before is not None and after is not None and before.ordinal == after.ordinal:
            if is_there:
                world.set_info(name, before.entity.info)
            return
        if after is not None and is_there:
            world.delete(name)
        if before is not None:
            self._respawn(before, former)

    def _respawn(self, journaled: JournaledEntity, former: RecordedMotion | None) -> None:
        entity, world = journaled.entity, self._parts.world
        try:
            respawned = world.spawn(
                ValidatedSpawn(
                    *(entity.name, entity.namespace, entity.model, entity.initial),
                    description=entity.description,
                    born_ns=entity.born_ns,
                    belongs_to_world=entity.belongs_to_world,
                    info=entity.info,
                )
            )
        except SimError as error:
            LOG.warning("entity not restored name=%s reason=%s", entity.name, error)
            return
        self._known[entity.name] = replace(journaled, entity=respawned)
        if (state := find_recorded_state(former, entity.name)) is not None:
            world.place(entity.name, *state)


def find_recorded_state(
    motion: RecordedMotion | None, name: str
) -> tuple[FloatArray, FloatArray] | None:
    """Find the state row (13,) and joint positions of an entity in recorded states."""
    if motion is None or name not in motion.names:
        return None
    row = motion.names.index(name)
    start = int(np.sum(motion.joint_counts[:row]))
    joints = slice(start, start + int(motion.joint_counts[row]))
    return motion.states.base[row].copy(), motion.states.joint_positions[joints].copy()


def ends_process(attempts: Sequence[Callable[[], None]]) -> bool:
    """Whether attempts, run in order in a copy of this process, end it."""
    return _find_first_crash(attempts, []) is not None


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


@dataclass
class Journal:
    """An open journal and its contents."""

    database: SqliteStore
    contents: JournalContents | None
    restored: tuple[JournaledEntity, ...] = ()
    progress: RestoreProgress = field(default_factory=RestoreProgress)
    _is_owned_by_tracker: bool = False

    @property
    def files(self) -> Path:
        """Folder of the meshes, named `<sha256>.stl`."""
        return self.database.folder / FILES

    @property
    def assets(self) -> Path:
        """Folder of the files of a running server; the lock of the journal protects it."""
        return self.database.folder / ASSETS

    def exclude_crashing(self, make_engine: Callable[[], Engine]) -> None:
        """Exclude entities that crash a process, if the last server crashed while restoring.

        Call it before any thread is started: it forks this process.
        """
        if self.contents is None or not self._mark.exists():
            return
        LOG.warning(
            "the last start crashed while restoring; its entities are tested in a fork first"
        )
        rows, trial = self.contents.entities, RestoreTrial(self.contents, make_engine)
        adding = [partial(trial.add, row) for row in rows]
        # One step for all first: one after each entity takes the square of the time.
        if not ends_process([*adding, trial.step]):
            return
        crashing = find_crashing([partial(trial.add_and_step, row) for row in rows])
        with raising_journal_errors(self.database.folder):
            commit_restore(
                self.database,
                [ExcludedEntityRow(entity=rows[i], reason=CRASHED_REASON) for i in crashing],
            )
        self.contents = read_contents(self.database)

    def restore(self, world: SimulatedWorld, store: AssetStore, now_ns: int) -> tuple[str, ...]:
        """Restore the entities, states and clock of a world; return the names of refused entities.

        Raises:
            JournalError: The journal cannot be written.
        """
        if self.contents is None:
            return ()
        with raising_journal_errors(self.database.folder):
            return self._restore(self.contents, world, store, now_ns)

    def _restore(
        self, contents: JournalContents, world: SimulatedWorld, store: AssetStore, now_ns: int
    ) -> tuple[str, ...]:
        self._mark.touch()
        is_crash = False
        try:
            sync_folder(self.database.folder)
            meshes = MeshRestorer(self.files, store)
            result = restore_world(contents, world, meshes, now_ns, self.progress)
            self.restored = tuple(result.restored)
            clock = msgspec.structs.replace(
                contents.clock, epoch=world.clock.epoch, steps=world.clock.steps
            )
            commit_restore(self.database, result.refused, clock)
        except EngineLost:
            is_crash = True  # of a process of the engine
            raise
        finally:
            # Another exception, as of a full disk, is none: no entity need be tested alone.
            if not is_crash:
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
            earlier_responses=self.earlier_responses(),
        )

    def close(self) -> None:
        """Close the database, unless a change tracker owns it."""
        if not self._is_owned_by_tracker:
            self.database.close()

    def earlier_responses(self) -> tuple[JournaledResponse, ...]:
        """List the responses of earlier servers, oldest first; their number limits them."""
        responses = self.contents.responses if self.contents else ()
        return tuple(
            JournaledResponse(row.service, row.request_id, row.payload, row.encoding)
            for row in responses
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
    if database.loss:
        LOG.warning("journal %s", database.loss)
    return Journal(database, contents)


class RestoreTrial:
    """Restores entities alone, in the engine of a copy of this process."""

    def __init__(self, contents: JournalContents, make_engine: Callable[[], Engine]) -> None:
        self._contents = contents
        self._make_engine = make_engine

    def add(self, row: EntityRow) -> None:
        """Make the body of an entity in its last state."""
        spawn = make_spawn_request(self._contents, row, 0)
        body = self._engine.add(spawn.model, spawn.base)
        self._engine.set_at_rest(body, *self._contents.last_state(row))

    def step(self) -> None:
        """Make a step."""
        self._engine.step()

    def add_and_step(self, row: EntityRow) -> None:
        """Make the body of an entity, and a step with those made before."""
        self.add(row)
        self.step()

    @cached_property
    def _engine(self) -> Engine:
        return self._make_engine()
