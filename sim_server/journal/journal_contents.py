"""The contents of a journal: read, restored into a world, summarized or exported."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np

from zensim.proto.bounded_files import read_file
from zensim.proto.messages.asset_messages import MAX_BUNDLE_BYTES
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.process_limits import sync_folder
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal.batch_writer import CLOCK_KIND, MOTION_KIND, WORLD_KIND, copy_synced
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
from zensim.sim_server.journal.sqlite_store import (
    FILES,
    JournalError,
    SqliteStore,
    raising_journal_errors,
)
from zensim.sim_server.parser_process.description_cache import ParseKey, list_assets
from zensim.sim_server.world.spawn_request import ValidatedSpawn

if TYPE_CHECKING:
    from pathlib import Path

    from zensim.sim_server.journal.restore_progress import RestoreProgress
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.physics.engine import FloatArray
    from zensim.sim_server.world.simulated_world import SimulatedWorld

LOG = logging.getLogger(__name__)
Row = TypeVar("Row", bound=msgspec.Struct)


@dataclass(frozen=True)
class JournalContents:
    """All rows of a journal, decoded."""

    world: WorldRow
    clock: ClockRow
    entities: tuple[EntityRow, ...]
    """Entities in the order of spawning."""
    models: dict[str, Model]
    texts: dict[str, str]
    responses: tuple[ResponseRow, ...]
    """Oldest first."""
    aside: tuple[ExcludedEntityRow, ...]
    motion: MotionRow | None = None
    _last_states: dict[str, tuple[FloatArray, FloatArray]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        if self.motion is not None:
            self._last_states.update(_index_states(self.motion))

    @property
    def steps(self) -> int:
        """The last known step."""
        motion = self.motion
        is_newer = motion is not None and motion.epoch == self.clock.epoch
        return max(self.clock.steps, motion.steps) if motion and is_newer else self.clock.steps

    def last_state(self, row: EntityRow) -> tuple[FloatArray, FloatArray]:
        """Find the last known state row (13,) and joint positions of an entity."""
        if (found := self._last_states.get(row.name)) is not None:
            return found
        joints = len(self.models[row.model].joints)
        return np.frombuffer(row.initial, dtype="<f8").copy(), np.zeros(joints)


def read_contents(database: SqliteStore) -> JournalContents | None:
    """Read a journal; None if it is empty.

    Raises:
        JournalError: A row cannot be decoded.
    """
    try:
        return _decode_contents(database)
    except (msgspec.MsgspecError, UnicodeDecodeError, KeyError, ValueError) as error:
        text = " ".join(str(error).split())[:200]
        raise JournalError(
            f"{database.folder} has rows that cannot be decoded: {text}; "
            "use the zensim that wrote it, or another folder"
        ) from error


def _decode_contents(database: SqliteStore) -> JournalContents | None:
    world = _decode_row(database, WORLD_KIND, WorldRow)
    clock = _decode_row(database, CLOCK_KIND, ClockRow)
    if world is None or clock is None:
        return None
    return JournalContents(
        world,
        clock,
        tuple(sorted(_decode_rows(database, "entity", EntityRow), key=lambda row: row.ordinal)),
        {
            name: msgspec.msgpack.decode(body, type=Model)
            for name, body in database.rows("model").items()
        },
        {name: body.decode() for name, body in database.rows("text").items()},
        tuple(sorted(_decode_rows(database, "answer", ResponseRow), key=lambda row: row.number)),
        tuple(_decode_rows(database, "aside", ExcludedEntityRow)),
        _decode_row(database, MOTION_KIND, MotionRow),
    )


def _decode_rows(database: SqliteStore, kind: str, row: type[Row]) -> list[Row]:
    return [msgspec.msgpack.decode(body, type=row) for body in database.rows(kind).values()]


def _decode_row(database: SqliteStore, kind: str, row: type[Row]) -> Row | None:
    body = database.body(kind, "")
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
    """Make the key that the model of an entity was parsed from; None if it is not known."""
    if (how := row.read_as) is None:
        return None
    return ParseKey(contents.texts[row.text], *msgspec.structs.astuple(how))


def make_spawn_request(
    contents: JournalContents, row: EntityRow, born_ns: int, start: FloatArray | None = None
) -> ValidatedSpawn:
    """Make the request that spawns an entity again, at a state row (13,)."""
    return ValidatedSpawn(
        row.name,
        row.namespace,
        contents.models[row.model],
        np.frombuffer(row.initial, dtype="<f8").copy(),
        contents.texts[row.text],
        born_ns=born_ns,
        belongs_to_world=row.belongs_to_world,
        info=row.info,
        start=start,
    )


@dataclass
class RestoreResult:
    """The entities that were restored and those that were refused."""

    restored: list[JournaledEntity] = field(default_factory=list)
    refused: list[ExcludedEntityRow] = field(default_factory=list)

    def refuse(self, row: EntityRow, error: Exception) -> None:
        """Set an entity aside."""
        self.refused.append(ExcludedEntityRow(entity=row, reason=" ".join(str(error).split())))


def restore_world(
    contents: JournalContents,
    world: SimulatedWorld,
    mesh_restorer: MeshRestorer,
    now_ns: int,
    progress: RestoreProgress,
) -> RestoreResult:
    """Spawn all entities with their last states, set the clock, and start a new epoch."""
    result = RestoreResult()
    progress.total, progress.done = len(contents.entities), 0
    rows = [
        row for row in contents.entities if _restore_meshes(contents, row, mesh_restorer, result)
    ]
    starts = [_find_state_at_rest(contents, row)[0] for row in rows]
    # Announced together, they are divided into cells before they are made.
    world.expect(
        [contents.models[row.model] for row in rows],
        [(float(start[0]), float(start[1])) for start in starts],
    )
    for row, start in zip(rows, starts, strict=True):
        request = make_spawn_request(contents, row, now_ns, start)
        _restore_entity(contents, row, world, request, result)
        progress.done += 1
    world.expect(())
    _set_joints(contents, world, result)
    # An entity that crashes the first step must do so here, while the mark file exists.
    world.step()
    _set_states(contents, world, result)
    world.clock.steps, world.clock.epoch = contents.steps, contents.clock.epoch + 1
    world.clock.state = State(contents.clock.state)
    return result


def _set_joints(contents: JournalContents, world: SimulatedWorld, result: RestoreResult) -> None:
    """Set the last states of entities that were made with other joint positions, which are 0."""
    rows = {row.name: row for row in contents.entities}
    for one in result.restored:
        base, positions = _find_state_at_rest(contents, rows[one.entity.name])
        if positions.any():
            _place(world, one.entity.name, base, positions)


def _set_states(contents: JournalContents, world: SimulatedWorld, result: RestoreResult) -> None:
    """Set the last states of entities that the step has moved; others are as they were made."""
    rows = {row.name: row for row in contents.entities}
    index = world.entities.index
    states = world.engine.read(index.bodies)
    for one in result.restored:
        name = one.entity.name
        base, positions = _find_state_at_rest(contents, rows[name])
        joints = index.joints_of(name)
        is_moved = (states.base[index.row[name]] != base).any()
        is_moved |= (states.joint_positions[joints] != positions).any()
        if is_moved or states.joint_velocities[joints].any():
            _place(world, name, base, positions)


def _place(world: SimulatedWorld, name: str, base: FloatArray, positions: FloatArray) -> None:
    try:
        world.place(name, base, positions)
    except SimError as error:  # it is frozen, and stays so
        LOG.warning("state not restored name=%s reason=%s", name, error)


def _restore_meshes(
    contents: JournalContents, row: EntityRow, mesh_restorer: MeshRestorer, result: RestoreResult
) -> bool:
    try:
        mesh_restorer.copy(contents.models[row.model])
    except (SimError, OSError) as error:
        result.refuse(row, error)
        return False
    return True


def _restore_entity(
    contents: JournalContents,
    row: EntityRow,
    world: SimulatedWorld,
    request: ValidatedSpawn,
    result: RestoreResult,
) -> None:
    try:
        entity = world.spawn(request)
    except (SimError, OSError) as error:
        result.refuse(row, error)
    else:
        result.restored.append(
            JournaledEntity(row.ordinal, entity, row.bond, make_parse_key(contents, row))
        )


def _find_state_at_rest(contents: JournalContents, row: EntityRow) -> tuple[FloatArray, FloatArray]:
    base, positions = contents.last_state(row)
    if contents.models[row.model].drive is not None:
        base[7:] = 0.0  # no agent drives it now
    return base, positions


@dataclass(frozen=True)
class MeshRestorer:
    """Copies meshes of the journal to the asset store."""

    files: Path
    store: AssetStore

    def copy(self, model: Model) -> None:
        """Copy the meshes of a model that are not in the store.

        Raises:
            MeshDamaged: A file has changed; it is removed, so that a new spawn writes it again.
            OSError: A file cannot be read.
        """
        for mesh in sorted(list_assets(model)):
            if mesh in self.store:
                continue
            path = self.files / f"{mesh}.stl"
            data = read_file(path, MAX_BUNDLE_BYTES)
            if not _is_intact(mesh, data):
                path.unlink(missing_ok=True)
                raise MeshDamaged(mesh)
            self.store.add(mesh, data)


class MeshDamaged(SimError):
    """A file of the journal does not have the bytes that were written."""

    slug = "journal.mesh"

    def __init__(self, sha256: str) -> None:
        super().__init__(f"file {sha256}.stl of the journal has changed; spawn the model again")


def _is_intact(sha256: str, data: bytes) -> bool:
    return hashlib.sha256(data).hexdigest() == sha256


def find_damaged_files(contents: JournalContents, files: Path) -> tuple[str, ...]:
    """Find the files that entities need and that are missing or have changed.

    Returns:
        The names of the files in the folder `files`, in order.
    """
    needed = {mesh for row in contents.entities for mesh in list_assets(contents.models[row.model])}
    return tuple(
        f"{mesh}.stl" for mesh in sorted(needed) if not _is_readable(mesh, files / f"{mesh}.stl")
    )


def _is_readable(sha256: str, path: Path) -> bool:
    try:
        return _is_intact(sha256, read_file(path, MAX_BUNDLE_BYTES))
    except OSError:
        return False


def backup_journal(database: SqliteStore, contents: JournalContents | None, folder: Path) -> None:
    """Copy a journal to an empty folder, while a server may use it.

    Raises:
        JournalError: The folder is not empty or cannot be written, or a mesh is damaged.
    """
    database.backup(folder)
    if contents is None:
        return
    source, target = database.folder / FILES, folder / FILES
    with raising_journal_errors(folder):
        for mesh in sorted(
            {one for model in contents.models.values() for one in list_assets(model)}
        ):
            if (source / f"{mesh}.stl").is_file():
                copy_synced(source / f"{mesh}.stl", target / f"{mesh}.stl")
        sync_folder(target)
    if damaged := find_damaged_files(contents, target):
        raise JournalError(
            f"{folder} is a copy, but {len(damaged)} of its meshes are damaged or missing, "
            f"as {damaged[0]}; a server sets their entities aside"
        )


def commit_restore(
    database: SqliteStore, aside: list[ExcludedEntityRow], clock: ClockRow | None = None
) -> None:
    """Write excluded entities and the new epoch at once.

    An epoch must be durable before it is published: the next start must not use it again.
    """
    if not aside and clock is None:
        return
    database.begin()
    for row in aside:
        LOG.warning("entity excluded name=%s reason=%s", row.entity.name, row.reason)
        database.remove("entity", row.entity.name)
        database.put("aside", f"{row.entity.ordinal}/{row.entity.name}", ENCODER.encode(row))
    if clock is not None:
        database.put(CLOCK_KIND, "", ENCODER.encode(clock))
    database.commit(database.position + 1)


def summarize_journal(database: SqliteStore, contents: JournalContents | None) -> dict[str, object]:
    """Summarize a journal, without descriptions."""
    if contents is None:
        return {"position": database.position, "loss": database.loss, "entities": [], "aside": []}
    world, clock = contents.world, contents.clock
    return {
        "position": database.position,
        "lost": database.lost,
        "loss": database.loss,
        "world": world.name,
        "world_model": world.source.name,
        "state": State(clock.state).name.lower(),
        "epoch": clock.epoch,
        "sim_time_s": round(contents.steps * round(NANOSECONDS / world.step_rate_hz) * 1e-9, 9),
        "steps": contents.steps,
        "answers": len(contents.responses),
        "entities": [_summarize_entity(contents, row) for row in contents.entities],
        "aside": [{"name": row.entity.name, "reason": row.reason} for row in contents.aside],
    }


def export_journal(database: SqliteStore, contents: JournalContents | None) -> dict[str, object]:
    """Export a journal with all descriptions."""
    summary = summarize_journal(database, contents)
    if contents is None:
        return summary
    world = msgspec.to_builtins(contents.world)
    rows = (*contents.entities, *(row.entity for row in contents.aside))
    return {
        **summary,
        "world_source": world.pop("source"),
        **{name: value for name, value in world.items() if name not in ("name", "resource")},
        "descriptions": {row.name: contents.texts[row.text] for row in rows},
    }


def format_summary(summary: dict[str, object]) -> str:
    """Format a summary as lines."""
    head = [
        f"{key}: {value}"
        for key, value in summary.items()
        if not isinstance(value, list) and (value or key != "loss")
    ]
    entities, aside = summary["entities"], summary["aside"]
    assert isinstance(entities, list)
    assert isinstance(aside, list)
    lines = [_format_entity(one) for one in entities]
    excluded = [f"  {one['name']}: {one['reason']}" for one in aside]
    return "\n".join(
        [*head, f"entities: {len(entities)}", *lines, f"set aside: {len(aside)}", *excluded]
    )


def _format_entity(entity: dict[str, list[float]]) -> str:
    position = " ".join(f"{round(value, 3) + 0.0:.3f}" for value in entity["position"])
    return f"  {entity['name']}  ns={entity['namespace']}  model={entity['model']}  at {position}"


def _summarize_entity(contents: JournalContents, row: EntityRow) -> dict[str, object]:
    base, joints = contents.last_state(row)
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
