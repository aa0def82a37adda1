"""A world made again from what its journal holds."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import State
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal.keeping import CLOCK, MOTION, WORLD
from zensim.sim_server.journal.ledger import JournalError, Ledger
from zensim.sim_server.journal.records import Kept
from zensim.sim_server.journal.rows import (
    ENCODER,
    AnswerRow,
    AsideRow,
    ClockRow,
    EntityRow,
    MotionRow,
    WorldRow,
)
from zensim.sim_server.reading.descriptions import Reading, meshes_of
from zensim.sim_server.world.birth import Birth

if TYPE_CHECKING:
    from pathlib import Path

    from zensim.sim_server.physics.engine import FloatArray
    from zensim.sim_server.reading.assets import AssetStore
    from zensim.sim_server.world.world import World

LOG = logging.getLogger(__name__)
Row = TypeVar("Row", bound=msgspec.Struct)


@dataclass(frozen=True)
class Contents:
    """Everything that a journal holds, read."""

    world: WorldRow
    clock: ClockRow
    entities: tuple[EntityRow, ...]
    """In the order of making."""
    models: dict[str, Model]
    texts: dict[str, str]
    answers: tuple[AnswerRow, ...]
    """Oldest first."""
    aside: tuple[AsideRow, ...]
    motion: MotionRow | None = None
    _places: dict[str, tuple[FloatArray, FloatArray]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        if self.motion is not None:
            self._places.update(_places(self.motion))

    @property
    def steps(self) -> int:
        """How far time had come."""
        motion = self.motion
        is_newer = motion is not None and motion.epoch == self.clock.epoch
        return max(self.clock.steps, motion.steps) if motion and is_newer else self.clock.steps

    def stand(self, row: EntityRow) -> tuple[FloatArray, FloatArray]:
        """Find the state row (13,) and the joint positions that an entity had last."""
        if (found := self._places.get(row.name)) is not None:
            return found
        joints = len(self.models[row.model].joints)
        return np.frombuffer(row.initial, dtype="<f8").copy(), np.zeros(joints)


def contents_of(ledger: Ledger) -> Contents | None:
    """Read what a journal holds; None when nothing was written to it yet.

    Raises:
        JournalError: It holds what cannot be.
    """
    try:
        return _contents(ledger)
    except (msgspec.MsgspecError, UnicodeDecodeError, KeyError, ValueError) as error:
        text = " ".join(str(error).split())[:200]
        raise JournalError(
            f"{ledger.folder} holds what cannot be read: {text}; use the zensim that wrote it, "
            "or another folder"
        ) from error


def _contents(ledger: Ledger) -> Contents | None:
    world = _only(ledger, WORLD, WorldRow)
    clock = _only(ledger, CLOCK, ClockRow)
    if world is None or clock is None:
        return None
    return Contents(
        world,
        clock,
        tuple(sorted(_all(ledger, "entity", EntityRow), key=lambda row: row.ordinal)),
        {
            name: msgspec.msgpack.decode(body, type=Model)
            for name, body in ledger.rows("model").items()
        },
        {name: body.decode() for name, body in ledger.rows("text").items()},
        tuple(sorted(_all(ledger, "answer", AnswerRow), key=lambda row: row.number)),
        tuple(_all(ledger, "aside", AsideRow)),
        _only(ledger, MOTION, MotionRow),
    )


def _all(ledger: Ledger, kind: str, row: type[Row]) -> list[Row]:
    return [msgspec.msgpack.decode(body, type=row) for body in ledger.rows(kind).values()]


def _only(ledger: Ledger, kind: str, row: type[Row]) -> Row | None:
    body = ledger.body(kind, "")
    return None if body is None else msgspec.msgpack.decode(body, type=row)


def _places(motion: MotionRow) -> dict[str, tuple[FloatArray, FloatArray]]:
    base = np.frombuffer(motion.base, dtype="<f8").reshape(len(motion.names), 13)
    joints = np.frombuffer(motion.joint_positions, dtype="<f8")
    ends = np.cumsum(np.array(motion.joint_counts, dtype=np.intp))
    return {
        name: (base[i].copy(), joints[ends[i] - motion.joint_counts[i] : ends[i]].copy())
        for i, name in enumerate(motion.names)
    }


def reading_of(contents: Contents, row: EntityRow) -> Reading | None:
    """Say what the model of an entity was read from."""
    if (how := row.read_as) is None:
        return None
    text = contents.texts[row.text]
    return Reading(text, how.compat, how.allow_missing, how.assets, how.dynamics)


def birth_of(contents: Contents, row: EntityRow, born_ns: int) -> Birth:
    """Say how an entity is spawned again."""
    return Birth(
        row.name,
        row.namespace,
        contents.models[row.model],
        np.frombuffer(row.initial, dtype="<f8").copy(),
        contents.texts[row.text],
        born_ns=born_ns,
        belongs_to_world=row.belongs_to_world,
        info=row.info,
    )


@dataclass
class Restored:
    """What came of it."""

    kept: list[Kept] = field(default_factory=list)
    refused: list[AsideRow] = field(default_factory=list)


def restore(contents: Contents, world: World, shelf: Shelf, now_ns: int) -> Restored:
    """Put all entities where they were, set time, and begin a new epoch."""
    restored = Restored()
    for row in contents.entities:
        _make(contents, row, world, shelf, now_ns, restored)
    _place_all(contents, world, restored)
    # What would end the process with its first step does so here, while the mark is up.
    world.step()
    _place_all(contents, world, restored)
    world.steps, world.epoch = contents.steps, contents.clock.epoch + 1
    world.state = State(contents.clock.state)
    return restored


def _place_all(contents: Contents, world: World, restored: Restored) -> None:
    rows = {row.name: row for row in contents.entities}
    for kept in restored.kept:
        world.place(kept.entity.name, *_standing(contents, rows[kept.entity.name]))


def _make(
    contents: Contents, row: EntityRow, world: World, shelf: Shelf, now_ns: int, restored: Restored
) -> None:
    try:
        shelf.fetch(contents.models[row.model])
        entity = world.spawn(birth_of(contents, row, now_ns))
    except (SimError, OSError) as error:
        restored.refused.append(AsideRow(entity=row, reason=" ".join(str(error).split())))
    else:
        restored.kept.append(Kept(row.ordinal, entity, row.bond, reading_of(contents, row)))


def _standing(contents: Contents, row: EntityRow) -> tuple[FloatArray, FloatArray]:
    base, positions = contents.stand(row)
    if contents.models[row.model].drive is not None:
        base[7:] = 0.0  # nobody drives it now
    return base, positions


@dataclass(frozen=True)
class Shelf:
    """Where meshes are kept, and where an engine looks for them."""

    files: Path
    store: AssetStore

    def fetch(self, model: Model) -> None:
        """Bring the meshes of a model to where the engine looks."""
        for mesh in meshes_of(model):
            self.store.keep(mesh, (self.files / f"{mesh}.stl").read_bytes())


def seal(ledger: Ledger, aside: list[AsideRow], clock: ClockRow | None = None) -> None:
    """Keep at once who is left out of the world from now on, and a new epoch.

    Nobody may see an epoch that another start would use again.
    """
    if not aside and clock is None:
        return
    ledger.begin()
    for row in aside:
        LOG.warning("entity %s set aside: %s", row.entity.name, row.reason)
        ledger.remove("entity", row.entity.name)
        ledger.put("aside", f"{row.entity.ordinal}/{row.entity.name}", ENCODER.encode(row))
    if clock is not None:
        ledger.put(CLOCK, "", ENCODER.encode(clock))
    ledger.commit(ledger.position + 1)
