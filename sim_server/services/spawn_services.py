"""Services that spawn entities, one or many, and list what can be spawned; all is checked before anything is made."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from zensim.proto.messages import spawn_messages
from zensim.proto.messages.entity_messages import BoundsType
from zensim.proto.messages.model_messages import Model, ReportEntry
from zensim.proto.messages.result_messages import Result, ResultCode, SpawnCode, SpawnEntitiesCode
from zensim.proto.messages.spawn_messages import (
    MAX_SPAWNS,
    NOT_SPAWNED_PREFIX,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnResult,
)
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.description.builtin_models import list_builtin_models
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.errors import IncorrectState, ModelError, RequestRefused, SimError
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.queries.bounds_queries import find_link_poses_at_zero, make_bounds
from zensim.sim_server.queries.frame_queries import pose_to_world
from zensim.sim_server.scene.convex_shapes import place_collision_shapes
from zensim.sim_server.service_parts import DeferredResponse, Descriptions, Spawning
from zensim.sim_server.world.entity import Entity, check_entity_info
from zensim.sim_server.world.pose_conversion import is_zero_quaternion, pose_to_row
from zensim.sim_server.world.spawn_request import ValidatedSpawn

UNDERGROUND_M = 0.001
MAX_NAMED = 3


def spawn_entity(spawning: Spawning, order: SpawnEntityOrder) -> SpawnEntityReport:
    """Put an entity into the world, or say what that would do.

    Raises:
        SimError: It is refused; nothing has changed.
    """
    return spawn_model(spawning, order, *spawning.descriptions.provider.model(order))


def spawn_model(
    spawning: Spawning, order: SpawnEntityOrder, model: Model, description: str
) -> SpawnEntityReport:
    """Spawn a model that has been read, whatever the order's resource is; raises as `spawn`."""
    spawning.bonds.require(order.bond)
    birth, notes = _resolve_spawn(spawning, order, model, description)
    if order.strict or order.dry_run:
        notes.extend(_make_overlap_notes(spawning.world.check_overlaps(birth)))
    if order.strict:
        _refuse_suspicious((*notes, *birth.model.report))
    if order.dry_run:
        name, namespace = spawning.world.resolve_names_for(birth)
        return SpawnEntityReport(Result(), name, namespace, (*notes, *birth.model.report))
    entity = spawning.world.spawn(birth)
    if not order.strict:
        notes.extend(_make_overlap_notes(spawning.world.find_overlaps(entity)))
    _record_spawn(spawning, entity, order.bond, notes)
    report = (*notes, *birth.model.report)
    return SpawnEntityReport(Result(), entity.name, entity.namespace, report)


@dataclass(frozen=True)
class StagedSpawn:
    """What was ordered and is not there yet."""

    entity: Entity
    bond: str
    notes: tuple[ReportEntry, ...]
    find_overlaps: Callable[[], list[str]]
    """Says whom it overlaps."""


def stage_model(
    spawning: Spawning, order: SpawnEntityOrder, model: Model, description: str
) -> StagedSpawn:
    """Make what `spawn_model` spawns, but let it in later; raises as that does."""
    spawning.bonds.require(order.bond)
    birth, notes = _resolve_spawn(spawning, order, model, description)
    entity, overlapped = spawning.world.stage_spawn(birth)
    if order.strict:
        try:
            _refuse_suspicious((*notes, *_make_overlap_notes(overlapped()), *birth.model.report))
        except ModelError:
            spawning.world.rollback_staged([entity])
            raise
    return StagedSpawn(entity, order.bond, tuple(notes), overlapped)


def commit_staged(spawning: Spawning, expected: Sequence[StagedSpawn]) -> None:
    """Let all that is expected be there between two steps.

    Raises:
        IncorrectState: A reset or another world has ended it, or what it hangs on is gone.
    """
    for bond in {one.bond for one in expected}:
        spawning.bonds.require(bond)
    if not all(spawning.world.entities.is_staged(one.entity) for one in expected):
        raise IncorrectState("the world was reset or replaced meanwhile; ask again")
    notes = [(*one.notes, *_make_overlap_notes(one.find_overlaps())) for one in expected]
    spawning.world.commit_staged([one.entity for one in expected])
    for one, told in zip(expected, notes, strict=True):
        _record_spawn(spawning, one.entity, one.bond, told)


def _record_spawn(
    spawning: Spawning, entity: Entity, bond: str, notes: Sequence[ReportEntry]
) -> None:
    if bond:
        spawning.bonds.add(bond, entity)
    for note in notes:
        spawning.world.clock.warn(entity.name, f"{note.subject}: {note.reason}")


def spawn_entity_when_parsed(
    spawning: Spawning, order: SpawnEntityOrder
) -> SpawnEntityReport | DeferredResponse[SpawnEntityReport]:
    """Spawn now, or once the description has been read; raises as `spawn` does."""
    if spawning.descriptions.provider.is_parsed(order):
        return spawn_entity(spawning, order)
    return DeferredResponse(
        lambda: spawning.descriptions.has_new and spawning.descriptions.provider.is_parsed(order),
        lambda: spawn_entity(spawning, order),
    )


def _resolve_spawn(
    spawning: Spawning, order: SpawnEntityOrder, model: Model, description: str
) -> tuple[ValidatedSpawn, list[ReportEntry]]:
    pose, notes = _resolve_pose(spawning, order, model)
    birth = ValidatedSpawn(
        name=order.name or model.name,
        namespace=order.entity_namespace,
        model=model,
        base=np.concatenate([pose, np.zeros(6)]),
        description=description,
        allow_renaming=order.allow_renaming,
        born_ns=spawning.pacing.now_ns(),
        info=None if order.info is None else check_entity_info(order.info),
    )
    return birth, notes


def _refuse_suspicious(report: tuple[ReportEntry, ...]) -> None:
    found = [f"{entry.subject}: {entry.reason}" for entry in report if entry.status == "suspicious"]
    if found:
        more = f" and {len(found) - MAX_NAMED} more" if len(found) > MAX_NAMED else ""
        raise ModelError(
            f"{len(found)} suspicious: {'; '.join(found[:MAX_NAMED])}{more}; "
            "mend them, or spawn without strict",
            code=SpawnCode.RESOURCE_PARSE_ERROR,
            slug="report.suspicious",
        )


def _resolve_pose(
    spawning: Spawning, request: SpawnEntityOrder, model: Model
) -> tuple[FloatArray, list[ReportEntry]]:
    wish = request.initial_pose
    notes = []
    if is_zero_quaternion(wish.pose.orientation):
        notes.append(
            ReportEntry("suspicious", "initial_pose", "all-zero quaternion read as identity")
        )
    pose = pose_to_world(spawning.world, wish.header.frame_id, pose_to_row(wish.pose))
    qx, qy, qz, qw = pose[3:7].tolist()
    # Not -clearance, which is -0 for a model without collisions.
    standing = 0.0 - find_ground_clearance(
        model, (qx, qy, qz, qw), spawning.descriptions.store.vertices
    )
    if request.snap_to_ground:
        pose[2] = standing
    depth = standing - float(pose[2])
    if depth > UNDERGROUND_M:
        notes.append(
            ReportEntry(
                "suspicious",
                "initial_pose",
                f"lowest point is {depth * 100:.1f} cm below ground; "
                f"z = {standing:.3f} puts it on the ground",
            )
        )
    return pose, notes


def _make_overlap_notes(others: list[str]) -> list[ReportEntry]:
    if not others:
        return []
    named = ", ".join(f"'{name}'" for name in others[:MAX_NAMED])
    more = f" and {len(others) - MAX_NAMED} more" if len(others) > MAX_NAMED else ""
    return [ReportEntry("suspicious", "initial_pose", f"overlaps entity {named}{more}")]


SPAWN_SLICE_NS = 5 * NANOSECONDS // 1000
"""What spawning takes of each turn of the loop where steps are late; the last begun is finished.

Where a quarter of a step is more, it is that.
"""
MIN_SPARE_NS = NANOSECONDS // 1000
"""Where that much is left before the next step is due, spawning takes what is left."""
MAX_PARSES_AHEAD = 64
"""Descriptions that are waited for at once."""
ParsedSpawnModel = tuple[Model, str] | SimError


def spawn_entities(
    spawning: Spawning, request: SpawnEntitiesOrder
) -> SpawnEntitiesResponse | DeferredResponse[SpawnEntitiesResponse]:
    """Put entities into the world: as many as can be, or all or none."""
    if len(request.spawn_requests) > MAX_SPAWNS:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{len(request.spawn_requests)} spawns are too many; use {MAX_SPAWNS} at most",
        )
    orders = [_merge_order(request.common, one) for one in request.spawn_requests]
    fleet = (
        _AtomicSpawns(spawning, orders) if request.atomic else _IndependentSpawns(spawning, orders)
    )
    return fleet.response() if fleet.go_on() else DeferredResponse(fleet.go_on, fleet.response)


def _merge_order(common: SpawnEntityOrder, one: SpawnEntity) -> SpawnEntityOrder:
    has_own = one.entity_resource != Resource()
    return msgspec.structs.replace(
        common,
        name=one.name,
        allow_renaming=one.allow_renaming or common.allow_renaming,
        entity_resource=one.entity_resource if has_own else common.entity_resource,
        entity_namespace=one.entity_namespace,
        initial_pose=one.initial_pose,
    )


class _SpawnBatch:
    """Orders, and what became of them so far."""

    def __init__(self, spawning: Spawning, orders: list[SpawnEntityOrder]) -> None:
        self._spawning = spawning
        self._orders = orders
        self._results: list[SpawnResult] = []
        self._read: dict[int, ParsedSpawnModel] = {}

    def _is_read(self, order: SpawnEntityOrder) -> bool:
        """Whether the description of an order is read; it is kept until all is over."""
        # Orders that share a resource share the object; to compare texts would take long.
        number = id(order.entity_resource)
        if number not in self._read and self._spawning.descriptions.provider.is_parsed(order):
            try:
                self._read[number] = self._spawning.descriptions.provider.model(order)
            except SimError as error:
                self._read[number] = error
        return number in self._read

    def _is_ready_to_spawn(self, order: SpawnEntityOrder) -> bool:
        """Whether the engine would not hold steps up to add what was read; else it gets ready."""
        read = self._read[id(order.entity_resource)]
        return isinstance(read, SimError) or self._spawning.world.prepare(read[0])

    def _model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        read = self._read[id(order.entity_resource)]
        if isinstance(read, SimError):
            raise read
        return read

    def response(self) -> SpawnEntitiesResponse:
        """Say what became of each."""
        failed = [one for one in self._results if one.result.result != ResultCode.OK]
        if not failed:
            return SpawnEntitiesResponse(results=tuple(self._results))
        message = f"{len(failed)} of {len(self._results)} were not spawned; the results say why"
        return SpawnEntitiesResponse(
            Result(SpawnEntitiesCode.ENTITIES_SPAWN_FAILED, message), tuple(self._results)
        )


class _IndependentSpawns(_SpawnBatch):
    """Each order for itself; steps are made meanwhile."""

    def __init__(self, spawning: Spawning, orders: list[SpawnEntityOrder]) -> None:
        super().__init__(spawning, orders)
        self._work = self._spawn_each()

    def go_on(self) -> bool:
        """Spawn for a while; say whether that was the last."""
        end_ns = _find_slice_end(self._spawning)
        for has_spawned in self._work:
            if not has_spawned or self._spawning.pacing.now_ns() >= end_ns:
                return False
        return True

    def _spawn_each(self) -> Iterator[bool]:
        for order in self._orders:
            while not (self._is_read(order) and self._is_ready_to_spawn(order)):
                yield False
            try:
                report = spawn_model(self._spawning, order, *self._model(order))
                self._results.append(SpawnResult(report.result, report.entity_name))
            except SimError as error:
                self._results.append(_make_refused_result(error))
            yield True


class _AtomicSpawns(_SpawnBatch):
    """All orders between two steps, or none; they are made before, out of sight."""

    def __init__(self, spawning: Spawning, orders: list[SpawnEntityOrder]) -> None:
        self._is_dry_run = any(order.dry_run for order in orders)
        replace = msgspec.structs.replace
        super().__init__(spawning, [replace(order, dry_run=False) for order in orders])
        self._unparsed = list({id(one.entity_resource): one for one in self._orders}.values())
        self._has_begun = False
        self._staged: list[StagedSpawn] = []

    def go_on(self) -> bool:
        """Make some once all is read; let all in with the last; say whether that is over."""
        if self._spawning.descriptions.has_new or not self._has_begun:
            self._has_begun = True
            self._collect_parsed()
        if self._unparsed:
            return False
        try:
            if not self._stage_some() or not self._spawning.world.is_idle:
                return False
            if not self._is_dry_run:
                commit_staged(self._spawning, self._staged)
        except SimError as error:
            self._fail_all(error)
        self._spawning.world.rollback_staged(one.entity for one in self._staged)
        return True

    def _collect_parsed(self) -> None:
        waiting: list[SpawnEntityOrder] = []
        for at, order in enumerate(self._unparsed):
            if len(waiting) == MAX_PARSES_AHEAD:
                waiting.extend(self._unparsed[at:])
                break
            if not self._is_read(order):
                waiting.append(order)
        self._unparsed = waiting

    def _stage_some(self) -> bool:
        """Make entities while there is time; say whether none is left to be made."""
        end_ns = _find_slice_end(self._spawning)
        for order in self._orders[len(self._staged) :]:
            if not self._is_ready_to_spawn(order):
                break
            made = stage_model(self._spawning, order, *self._model(order))
            self._staged.append(made)
            self._results.append(SpawnResult(Result(), made.entity.name))
            if self._spawning.pacing.now_ns() >= end_ns:
                break
        return len(self._staged) == len(self._orders)

    def _fail_all(self, error: SimError) -> None:
        failed = len(self._results)
        if failed == len(self._orders):
            self._results = [_make_refused_result(error)] * failed
            return
        name = self._orders[failed].name or f"number {failed}"
        reason = f"{NOT_SPAWNED_PREFIX} '{name[:80]}': all or none were asked for"
        other = SpawnResult(Result(ResultCode.OPERATION_FAILED, reason))
        self._results = [other] * len(self._orders)
        self._results[failed] = _make_refused_result(error)


def _find_slice_end(spawning: Spawning) -> int:
    """Say until when spawning may hold the loop up: steps that can be in time are to be so."""
    now_ns = spawning.pacing.now_ns()
    if spawning.pacing.due_ns - now_ns > MIN_SPARE_NS:
        return spawning.pacing.due_ns - MIN_SPARE_NS // 2
    return now_ns + spawning.pacing.loop_stats.work_budget_ns(SPAWN_SLICE_NS)


def _make_refused_result(error: SimError) -> SpawnResult:
    return SpawnResult(Result(int(error.code), str(error)))


SHIPPED_SCHEME = "zensim://"


def get_spawnables(
    descriptions: Descriptions, request: spawn_messages.GetSpawnablesRequest
) -> spawn_messages.GetSpawnablesResponse | DeferredResponse[spawn_messages.GetSpawnablesResponse]:
    """List the robots that come with the server, once all of them are read."""
    if unknown := [source for source in request.sources if source != SHIPPED_SCHEME]:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"source {unknown[0][:80]!r} is not known; use {SHIPPED_SCHEME} or none",
        )
    orders = [
        SpawnEntityOrder(entity_resource=Resource(SHIPPED_SCHEME + name))
        for name in list_builtin_models()
    ]

    def answer() -> spawn_messages.GetSpawnablesResponse:
        found = tuple(_make_spawnable(descriptions, order) for order in orders)
        return spawn_messages.GetSpawnablesResponse(spawnables=found)

    def is_read() -> bool:
        # Not by all(): each has to be asked for, so that all are read meanwhile.
        return sum(descriptions.provider.is_parsed(order) for order in orders) == len(orders)

    return (
        answer()
        if is_read()
        else DeferredResponse(lambda: descriptions.has_new and is_read(), answer)
    )


def _make_spawnable(
    descriptions: Descriptions, order: SpawnEntityOrder
) -> spawn_messages.Spawnable:
    model, _ = descriptions.provider.model(order)
    solids = list(
        place_collision_shapes(model, find_link_poses_at_zero(model), descriptions.store.vertices)
    )
    bounds = make_bounds(solids, BoundsType.BOX)
    return spawn_messages.Spawnable(order.entity_resource, _describe_model(model), bounds)


def _describe_model(model: Model) -> str:
    drive = type(model.drive).__name__ if model.drive else "no drive"
    return f"{model.name}: {drive}, {model.mass_kg:.3g} kg"
