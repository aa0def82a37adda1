"""Finds what changed in the world, submits it, and undoes what could not be written."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal.journal_records import (
    ClockRow,
    EntityChange,
    JournaledEntity,
    JournalRecord,
    RecordedMotion,
    ResponseRow,
    WorldRow,
)
from zensim.sim_server.world.spawn_request import ValidatedSpawn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from zensim.sim_server.journal_protocol import JournaledResponse
    from zensim.sim_server.physics.engine import FloatArray
    from zensim.sim_server.service_parts import ServerParts

LOG = logging.getLogger(__name__)
MOTION_PERIOD_S = 0.4
"""Between two recordings of where everything is: with the time of a commit not above 0.5 s."""

MAX_MOTION_DELAY_NS = 40_000_000
"""How long a recording waits for a step that is read anyway."""
BOND_TIMEOUT_S = 10.0
"""How long the holders of bonds have to come back after a restart."""

TRANSIENT_STATES = (State.LOADING_WORLD, State.QUITTING)
"""No server begins in these."""


class RecordQueue(Protocol):
    """Where records go, see `Writer`."""

    durable: int
    commits: int
    failure: tuple[int, str] | None

    @property
    def is_alive(self) -> bool:
        """Whether anything is written at all."""

    def submit(self, record: JournalRecord) -> None:
        """Hand a record over."""

    def close(self) -> bool:
        """Write what is left and end; say whether that worked."""


class WriterEnded(RuntimeError):
    """The journal's thread has ended; the server must, too."""


class ChangeTracker:
    """Keeps the journal of one world."""

    def __init__(
        self,
        parts: ServerParts,
        log: RecordQueue,
        *,
        position: int,
        known: Iterable[JournaledEntity] = (),
        earlier_responses: tuple[JournaledResponse, ...] = (),
        wall_s: Callable[[], float],
    ) -> None:
        self.position = position
        """Of the newest record."""
        self.earlier_responses = earlier_responses
        self._parts = parts
        self._log = log
        self._wall_s = wall_s
        self._generation = 0
        self._known = {kept.entity.name: kept for kept in known}
        self._next_ordinal = max((kept.ordinal for kept in self._known.values()), default=0) + 1
        self._outstanding: deque[JournalRecord] = deque()
        self._seen: tuple[object, ...] = ()
        self._world: WorldRow | None = None
        self._clock: ClockRow | None = None
        self._motion: RecordedMotion | None = None
        self._motion_seen: tuple[int, ...] = ()
        self._motion_due_ns = 0
        self._is_failing = False
        self._commits = 0
        self._bonds_due_ns = parts.pacing.now_ns() + round(BOND_TIMEOUT_S * NANOSECONDS)

    @property
    def durable(self) -> int:
        """What is on the disk."""
        return self._log.durable

    @property
    def is_failing(self) -> bool:
        """Whether the disk refused the last record, and has taken none since."""
        if self._is_failing and self._log.commits > self._commits:
            self._is_failing = False
            LOG.warning("journal written again world=%s", self._parts.world.name)
        return self._is_failing

    def note(
        self,
        answer: JournaledResponse | None = None,
        forgotten: tuple[tuple[str, bytes], ...] = (),
        *,
        is_asked: bool = False,
    ) -> int:
        """See `Durable.note`."""
        if not is_asked and self._fingerprint() == self._seen:
            return self.position
        changes, former = self._changes(), self._motion
        world, clock = self._new_world(), self._new_clock()
        has_moved = self._places() != self._motion_seen
        if changes or world or clock or answer or forgotten or (is_asked and has_moved):
            self._submit(
                JournalRecord(
                    self._generation,
                    self.position + 1,
                    changes,
                    world,
                    clock,
                    self._take_motion() if has_moved else None,
                    self._answer_row(answer),
                    forgotten,
                    is_asked,
                    former,
                )
            )
        return self.position

    def poll(self) -> str:
        """See `Durable.poll`; says where all are, too, when that is due.

        Raises:
            WriterEnded: Nothing is written any more.
        """
        if not self._log.is_alive:
            raise WriterEnded("the journal's thread has ended")
        reason = self._failure()
        self._drop_durable()
        self._end_lost_bonds()
        self.note()
        if self._is_motion_due():
            self._record_motion()
        return reason

    def retry(self) -> int:
        """Write something at once, to see whether the disk works again; return the attempt."""
        self._submit(JournalRecord(self._generation, self.position, motion=self._take_motion()))
        return self._generation

    def is_decided(self, attempt: int) -> bool:
        """Whether it is known how an attempt went."""
        return not self.is_failing or self._generation > attempt

    def close(self) -> bool:
        """Write everything down and end; say whether that worked."""
        self.note()
        self._record_motion()
        return self._log.close()

    def _answer_row(self, answer: JournaledResponse | None) -> ResponseRow | None:
        if answer is None:
            return None
        return ResponseRow(
            # Positions only go up on the disk, and a record has one answer at most.
            number=self.position + 1,
            service=answer.service,
            request_id=answer.request_id,
            payload=answer.payload,
            encoding=answer.encoding,
            at_s=self._wall_s(),
        )

    def _submit(self, record: JournalRecord) -> None:
        if record.position > self.position:
            self._outstanding.append(record)
            self.position = record.position
        self._log.submit(record)

    def _end_lost_bonds(self) -> None:
        """End what hung on bonds whose holders did not come back after a restart."""
        if not self._bonds_due_ns or self._parts.pacing.now_ns() < self._bonds_due_ns:
            return
        self._bonds_due_ns = 0
        for bond in self._parts.bonds.entities.keys() - self._parts.bonds.alive:
            self._parts.bonds.end(bond)

    def _drop_durable(self) -> None:
        durable = self._log.durable
        while self._outstanding and self._outstanding[0].position <= durable:
            self._outstanding.popleft()

    def _fingerprint(self) -> tuple[object, ...]:
        """What cannot stay the same when something has changed; costs nothing."""
        world = self._parts.world
        factor = self._parts.pacing.target_real_time_factor
        return (
            world.entities.roster_number,
            world.clock.epoch,
            world.clock.state,
            factor,
            id(self._parts.current_world.model),
        )

    def _places(self) -> tuple[int, ...]:
        world = self._parts.world
        return (world.placement_count, world.clock.epoch)

    def _changes(self) -> tuple[EntityChange, ...]:
        self._seen = self._fingerprint()
        present = {entity.name: entity for entity in self._parts.world.entities}
        changes = [
            EntityChange(name, kept, None)
            for name, kept in self._known.items()
            if name not in present
        ]
        for name, entity in present.items():
            before = self._known.get(name)
            if before is not None and before.entity is entity:
                continue
            after = JournaledEntity(
                self._ordinal_of(before, entity.born_ns),
                entity,
                self._bond_of(name),
                self._parts.descriptions.provider.find_parse_key(entity.model),
            )
            if before is None or not before.has_same_row(after):
                changes.append(EntityChange(name, before, after))
            self._known[name] = after
        for change in changes:
            if change.after is None:
                del self._known[change.name]
        return tuple(changes)

    def _ordinal_of(self, before: JournaledEntity | None, born_ns: int) -> int:
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

    def _new_world(self) -> WorldRow | None:
        world, current = self._parts.world, self._parts.current_world
        if self._world is not None and self._world.source is current.model:
            return None
        self._world = WorldRow(
            name=world.name,
            source=current.model,
            step_hz=NANOSECONDS / world.clock.step_ns,
            seed=current.seed,
            resource=current.resource,
        )
        return self._world

    def _new_clock(self) -> ClockRow | None:
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
        """Whether to record: best at a step that agents are told of, as reading costs the most."""
        late_ns = self._parts.pacing.now_ns() - self._motion_due_ns
        return late_ns >= (0 if self._parts.world.is_control_step else MAX_MOTION_DELAY_NS)

    def _record_motion(self) -> None:
        self._motion_due_ns = self._parts.pacing.now_ns() + round(MOTION_PERIOD_S * NANOSECONDS)
        if self._is_failing:
            self._seen = ()  # what stands although it could not be kept is handed over again
            self.note()
        world, last = self._parts.world, self._motion
        is_old = last is None or (last.epoch, last.steps) != (world.clock.epoch, world.clock.steps)
        is_old = is_old or last is None or last.names != world.entities.index.names
        if is_old or self._places() != self._motion_seen or self._is_failing:
            self._submit(JournalRecord(self._generation, self.position, motion=self._take_motion()))

    def _take_motion(self) -> RecordedMotion:
        world = self._parts.world
        roster, reading = world.entities.index, world.states()
        self._motion_seen = self._places()
        self._motion = RecordedMotion(
            world.clock.epoch, world.clock.steps, roster.names, roster.joint_count, reading
        )
        return self._motion

    def _failure(self) -> str:
        failure = self._log.failure
        if failure is None or failure[0] < self._generation:
            return ""
        if not self._is_failing:
            LOG.warning("journal not written reason=%s", failure[1])
        self._generation += 1
        self._is_failing = True
        self._commits = self._log.commits
        self._drop_durable()
        while self._outstanding:
            self._take_back(self._outstanding.pop())
        self.position = self._log.durable
        self._motion_seen = ()
        self._seen = self._fingerprint()
        return failure[1]

    def _take_back(self, record: JournalRecord) -> None:
        """Undo what was asked for; what came by itself, times and worlds stand and are kept later.

        A change that stands is found anew, as it is forgotten that it was handed over.
        """
        self._world = None if record.world is not None else self._world
        self._clock = None if record.clock is not None else self._clock
        for change in reversed(record.changes):
            self._known.pop(change.name, None)
            if change.before is not None:
                self._known[change.name] = change.before
            if record.is_asked and record.world is None:
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
            self._put_back(before, former)

    def _put_back(self, kept: JournaledEntity, former: RecordedMotion | None) -> None:
        entity, world = kept.entity, self._parts.world
        try:
            again = world.spawn(
                ValidatedSpawn(
                    *(entity.name, entity.namespace, entity.model, entity.initial),
                    description=entity.description,
                    born_ns=entity.born_ns,
                    belongs_to_world=entity.belongs_to_world,
                    info=entity.info,
                )
            )
        except SimError as error:
            LOG.warning("entity %s could not be put back: %s", entity.name, error)
            return
        self._known[entity.name] = replace(kept, entity=again)
        if (stand := find_recorded_state(former, entity.name)) is not None:
            world.place(entity.name, *stand)


def find_recorded_state(
    motion: RecordedMotion | None, name: str
) -> tuple[FloatArray, FloatArray] | None:
    """Find the state row (13,) and joint positions of an entity in a motion."""
    if motion is None or name not in motion.names:
        return None
    row = motion.names.index(name)
    start = int(np.sum(motion.joint_counts[:row]))
    joints = slice(start, start + int(motion.joint_counts[row]))
    return motion.reading.base[row].copy(), motion.reading.joint_positions[joints].copy()
