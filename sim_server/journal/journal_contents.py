"""What a journal holds: read, restored into a world, summarized or exported."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal.batch_writer import CLOCK_KIND, MOTION_KIND, WORLD_KIND
from zensim.sim_server.journal.journal_records import (
    ENCODER,
    ClockRow,
    EntityRow,
    ExcludedEntityRow,
    JournaledEntity,
    MotionRow,
    ResponseRow,
    WorldRow,
)
from zensim.sim_server.journal.sqlite_store import JournalError, SqliteStore
from zensim.sim_server.parser_process.description_cache import ParseKey, list_meshes
from zensim.sim_server.world.spawn_request import ValidatedSpawn

if TYPE_CHECKING:
    from pathlib import Path

    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.physics.engine import FloatArray
    from zensim.sim_server.world.simulated_world import World

LOG = logging.getLogger(__name__)
Row = TypeVar("Row", bound=msgspec.Struct)


@dataclass(frozen=True)
class JournalContents:
    """Everything that a journal holds, read."""

    world: WorldRow
    clock: ClockRow
    entities: tuple[EntityRow, ...]
    """In the order of making."""
    models: dict[str, Model]
    texts: dict[str, str]
    answers: tuple[ResponseRow, ...]
    """Oldest first."""
    aside: tuple[ExcludedEntityRow, ...]
    motion: MotionRow | None = None
    _places: dict[str, tuple[FloatArray, FloatArray]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        if self.motion is not None:
            self._places.update(_index_states(self.motion))

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


def read_contents(ledger: SqliteStore) -> JournalContents | None:
    """Read what a journal holds; None when nothing was written to it yet.

    Raises:
        JournalError: It holds what cannot be.
    """
    try:
        return _decode_contents(ledger)
    except (msgspec.MsgspecError, UnicodeDecodeError, KeyError, ValueError) as error:
        text = " ".join(str(error).split())[:200]
        raise JournalError(
            f"{ledger.folder} holds what cannot be read: {text}; use the zensim that wrote it, "
            "or another folder"
        ) from error


def _decode_contents(ledger: SqliteStore) -> JournalContents | None:
    world = _decode_row(ledger, WORLD_KIND, WorldRow)
    clock = _decode_row(ledger, CLOCK_KIND, ClockRow)
    if world is None or clock is None:
        return None
    return JournalContents(
        world,
        clock,
        tuple(sorted(_decode_rows(ledger, "entity", EntityRow), key=lambda row: row.ordinal)),
        {
            name: msgspec.msgpack.decode(body, type=Model)
            for name, body in ledger.rows("model").items()
        },
        {name: body.decode() for name, body in ledger.rows("text").items()},
        tuple(sorted(_decode_rows(ledger, "answer", ResponseRow), key=lambda row: row.number)),
        tuple(_decode_rows(ledger, "aside", ExcludedEntityRow)),
        _decode_row(ledger, MOTION_KIND, MotionRow),
    )


def _decode_rows(ledger: SqliteStore, kind: str, row: type[Row]) -> list[Row]:
    return [msgspec.msgpack.decode(body, type=row) for body in ledger.rows(kind).values()]


def _decode_row(ledger: SqliteStore, kind: str, row: type[Row]) -> Row | None:
    body = ledger.body(kind, "")
    return None if body is None else msgspec.msgpack.decode(body, type=row)


def _index_states(motion: MotionRow) -> dict[str, tuple[FloatArray, FloatArray]]:
    base = np.frombuffer(motion.base, dtype="<f8").reshape(len(motion.names), 13)
    joints = np.frombuffer(motion.joint_positions, dtype="<f8")
    ends = np.cumsum(np.array(motion.joint_counts, dtype=np.intp))
    return {
        name: (base[i].copy(), joints[ends[i] - motion.joint_counts[i] : ends[i]].copy())
        for i, name in enumerate(motion.names)
    }


def make_parse_key(contents: JournalContents, row: EntityRow) -> ParseKey | None:
    """Say what the model of an entity was read from."""
    if (how := row.read_as) is None:
        return None
    text = contents.texts[row.text]
    return ParseKey(text, how.compat, how.allow_missing, how.assets, how.dynamics)


def make_spawn_request(contents: JournalContents, row: EntityRow, born_ns: int) -> ValidatedSpawn:
    """Say how an entity is spawned again."""
    return ValidatedSpawn(
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
class RestoreResult:
    """What came of it."""

    kept: list[JournaledEntity] = field(default_factory=list)
    refused: list[ExcludedEntityRow] = field(default_factory=list)


def restore_world(
    contents: JournalContents, world: World, mesh_restorer: MeshRestorer, now_ns: int
) -> RestoreResult:
    """Put all entities where they were, set time, and begin a new epoch."""
    restored = RestoreResult()
    for row in contents.entities:
        _restore_entity(contents, row, world, mesh_restorer, now_ns, restored)
    _set_states(contents, world, restored)
    # What would end the process with its first step does so here, while the mark is up.
    world.step()
    _set_states(contents, world, restored)
    world.clock.steps, world.clock.epoch = contents.steps, contents.clock.epoch + 1
    world.clock.state = State(contents.clock.state)
    return restored


def _set_states(contents: JournalContents, world: World, restored: RestoreResult) -> None:
    rows = {row.name: row for row in contents.entities}
    for kept in restored.kept:
        world.place(kept.entity.name, *_find_standing_state(contents, rows[kept.entity.name]))


def _restore_entity(
    contents: JournalContents,
    row: EntityRow,
    world: World,
    mesh_restorer: MeshRestorer,
    now_ns: int,
    restored: RestoreResult,
) -> None:
    try:
        mesh_restorer.fetch(contents.models[row.model])
        entity = world.spawn(make_spawn_request(contents, row, now_ns))
    except (SimError, OSError) as error:
        restored.refused.append(ExcludedEntityRow(entity=row, reason=" ".join(str(error).split())))
    else:
        restored.kept.append(
            JournaledEntity(row.ordinal, entity, row.bond, make_parse_key(contents, row))
        )


def _find_standing_state(
    contents: JournalContents, row: EntityRow
) -> tuple[FloatArray, FloatArray]:
    base, positions = contents.stand(row)
    if contents.models[row.model].drive is not None:
        base[7:] = 0.0  # nobody drives it now
    return base, positions


@dataclass(frozen=True)
class MeshRestorer:
    """Where meshes are kept, and where an engine looks for them."""

    files: Path
    store: AssetStore

    def fetch(self, model: Model) -> None:
        """Bring the meshes of a model to where the engine looks."""
        for mesh in list_meshes(model):
            self.store.keep(mesh, (self.files / f"{mesh}.stl").read_bytes())


def commit_restore(
    ledger: SqliteStore, aside: list[ExcludedEntityRow], clock: ClockRow | None = None
) -> None:
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
        ledger.put(CLOCK_KIND, "", ENCODER.encode(clock))
    ledger.commit(ledger.position + 1)


def summarize_journal(ledger: SqliteStore, contents: JournalContents | None) -> dict[str, object]:
    """Say what a journal holds, without descriptions."""
    if contents is None:
        return {"position": ledger.position, "entities": [], "aside": []}
    world, clock = contents.world, contents.clock
    return {
        "position": ledger.position,
        "lost": ledger.lost,
        "world": world.name,
        "world_model": world.source.name,
        "state": State(clock.state).name.lower(),
        "epoch": clock.epoch,
        "sim_time_s": round(contents.steps * round(NANOSECONDS / world.step_hz) * 1e-9, 9),
        "steps": contents.steps,
        "answers": len(contents.answers),
        "entities": [_summarize_entity(contents, row) for row in contents.entities],
        "aside": [{"name": row.entity.name, "reason": row.reason} for row in contents.aside],
    }


def export_journal(ledger: SqliteStore, contents: JournalContents | None) -> dict[str, object]:
    """Say everything, so that another server could be filled with it."""
    found = summarize_journal(ledger, contents)
    if contents is None:
        return found
    rows = (*contents.entities, *(row.entity for row in contents.aside))
    return {
        **found,
        "world_source": msgspec.to_builtins(contents.world.source),
        "step_hz": contents.world.step_hz,
        "seed": contents.world.seed,
        "descriptions": {row.name: contents.texts[row.text] for row in rows},
    }


def format_summary(found: dict[str, object]) -> str:
    """Write a summary as lines."""
    head = [f"{word}: {value}" for word, value in found.items() if not isinstance(value, list)]
    entities, aside = found["entities"], found["aside"]
    assert isinstance(entities, list)
    assert isinstance(aside, list)
    lines = [_format_entity(one) for one in entities]
    apart = [f"  {one['name']}: {one['reason']}" for one in aside]
    return "\n".join(
        [*head, f"entities: {len(entities)}", *lines, f"set aside: {len(aside)}", *apart]
    )


def _format_entity(entity: dict[str, list[float]]) -> str:
    place = " ".join(f"{round(value, 3) + 0.0:.3f}" for value in entity["position"])
    return f"  {entity['name']}  ns={entity['namespace']}  model={entity['model']}  at {place}"


def _summarize_entity(contents: JournalContents, row: EntityRow) -> dict[str, object]:
    base, joints = contents.stand(row)
    model = contents.models[row.model]
    return {
        "name": row.name,
        "namespace": row.namespace,
        "model": model.name,
        "belongs_to_world": row.belongs_to_world,
        "bond": row.bond,
        "position": [round(value, 6) + 0.0 for value in base[:3].tolist()],
        "orientation": [round(value, 9) for value in base[3:7].tolist()],
        "joints": {
            joint.name: round(value, 6)
            for joint, value in zip(model.joints, joints.tolist(), strict=True)
        },
    }
