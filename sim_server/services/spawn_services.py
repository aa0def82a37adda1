"""Services that spawn entities, one or many, and list spawnable models."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from zensim.proto.messages import asset_messages, spawn_messages
from zensim.proto.messages.drive_messages import name_drive
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
from zensim.proto.se3 import IDENTITY_POSE
from zensim.sim_server.description.builtin_models import list_builtin_models
from zensim.sim_server.errors import IncorrectState, ModelError, RequestRefused, SimError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.physics.engine import FloatArray, can_move
from zensim.sim_server.queries.bounds_queries import make_bounds
from zensim.sim_server.queries.frame_queries import pose_to_world
from zensim.sim_server.scene.ray_casting import NO_ENTITY, Rays, cast_rays_exactly
from zensim.sim_server.scene.scene import place_collision_shapes
from zensim.sim_server.service_parts import (
    DeferredResponse,
    Descriptions,
    Spawning,
    make_environment,
)
from zensim.sim_server.services.sensor_notes import complete_report, make_sensor_notes
from zensim.sim_server.world.entity import Entity, check_entity_info
from zensim.sim_server.world.pose_conversion import is_zero_quaternion, pose_to_row
from zensim.sim_server.world.spawn_request import ValidatedSpawn

UNDERGROUND_M = 0.001
MAX_NAMED = 3
NOTHING_BELOW = "nothing is below it, so that it falls; spawn it above a floor of the world"
SEARCH_RISE_M = 0.5
"""Height above the pose from which the floor is searched: a frame may be at its soles or below."""
SEARCH_DEPTH_M = 1e6
SPAWN_SLICE_NS = 5 * NANOSECONDS // 1000
"""Wall time for spawning per turn if steps are late, or a quarter of the step time if more."""
MIN_SPARE_NS = NANOSECONDS // 1000
"""Spawning uses a part of the time until the next step if that is longer than this."""
MAX_SPARE_SLICE_NS = 15 * NANOSECONDS // 1000
"""Most of that time in a turn, and half of what is left: others' requests come in between."""
MAX_PARSES_AHEAD = 64
"""Most descriptions that are parsed at once."""
ParsedSpawnModel = tuple[Model, str] | SimError
SHIPPED_SCHEME = "zensim://"


def missing_assets(
    store: AssetStore, request: asset_messages.MissingAssetsRequest
) -> asset_messages.MissingAssetsResponse:
    """List the files that the server does not have."""
    missing = store.missing(request.sha256s)
    return asset_messages.MissingAssetsResponse(
        Result(), tuple(name for name, _ in missing), tuple(received for _, received in missing)
    )


def put_asset(
    store: AssetStore, request: asset_messages.PutAssetRequest
) -> asset_messages.PutAssetResponse:
    """Store a piece of a file."""
    received = store.put(
        request.sha256, offset=request.offset, total=request.total, data=request.data
    )
    return asset_messages.PutAssetResponse(Result(), received)


def get_asset(
    store: AssetStore, request: asset_messages.GetAssetRequest
) -> asset_messages.GetAssetResponse:
    """Return a piece of a file."""
    data = store.read(request.sha256, request.offset, asset_messages.MAX_CHUNK_BYTES)
    return asset_messages.GetAssetResponse(Result(), data, store.size(request.sha256))


def spawn_entity(spawning: Spawning, order: SpawnEntityOrder) -> SpawnEntityReport:
    """Spawn an entity, or report what a spawn would do if it is a dry run.

    Raises:
        SimError: The spawn is refused; nothing has changed.
    """
    return spawn_model(spawning, order, *spawning.descriptions.provider.model(order))


def spawn_model(
    spawning: Spawning, order: SpawnEntityOrder, model: Model, description: str
) -> SpawnEntityReport:
    """Spawn a parsed model, whatever the order's resource is; raises as `spawn_entity` does."""
    spawning.bonds.require(order.bond)
    validated, notes = _resolve_spawn(spawning, order, model, description)
    if order.strict or order.dry_run:
        notes.extend(_make_overlap_notes(spawning.world.check_overlaps(validated)))
    if order.strict:
        _refuse_suspicious((*notes, *validated.model.report))
    if order.dry_run:
        name, namespace = spawning.world.resolve_names_for(validated)
        report = (*notes, *_complete_report(spawning, model, namespace))
        kind = name_drive(validated.model.drive)
        return SpawnEntityReport(Result(), name, namespace, report, kind)
    if order.strict:
        entity = spawning.world.spawn(validated)
    else:
        entity, overlapped = spawning.world.spawn_and_find_overlaps(validated)
        notes.extend(_make_overlap_notes(overlapped))
    _record_spawn(spawning, entity, order.bond, notes)
    report = (*notes, *_complete_report(spawning, model, entity.namespace))
    kind = name_drive(entity.model.drive)
    return SpawnEntityReport(Result(), entity.name, entity.namespace, report, kind)


def _complete_report(spawning: Spawning, model: Model, namespace: str) -> tuple[ReportEntry, ...]:
    return complete_report(model, namespace, make_environment(spawning.world, spawning.current))


@dataclass(frozen=True)
class StagedSpawn:
    """An entity that is built but not yet in the world."""

    entity: Entity
    bond: str
    notes: tuple[ReportEntry, ...]
    find_overlaps: Callable[[], list[str]]
    """Lists the entities that it overlaps."""


def stage_model(
    spawning: Spawning, order: SpawnEntityOrder, model: Model, description: str
) -> StagedSpawn:
    """Build what `spawn_model` spawns, to be committed later; raises as that does."""
    spawning.bonds.require(order.bond)
    validated, notes = _resolve_spawn(spawning, order, model, description)
    entity, overlapped = spawning.world.stage_spawn(validated)
    if order.strict:
        try:
            _refuse_suspicious(
                (*notes, *_make_overlap_notes(overlapped()), *validated.model.report)
            )
        except ModelError:
            spawning.world.rollback_staged([entity])
            raise
    return StagedSpawn(entity, order.bond, tuple(notes), overlapped)


def commit_staged(spawning: Spawning, expected: Sequence[StagedSpawn]) -> None:
    """Insert all staged entities between two steps.

    Raises:
        IncorrectState: The world was reset or replaced, or a bond has ended.
    """
    for bond in {one.bond for one in expected}:
        spawning.bonds.require(bond)
    if not all(spawning.world.entities.is_staged(one.entity) for one in expected):
        raise IncorrectState("the world was reset or replaced meanwhile; try again")
    notes = [(*one.notes, *_make_overlap_notes(one.find_overlaps())) for one in expected]
    spawning.world.commit_staged([one.entity for one in expected])
    for one, report in zip(expected, notes, strict=True):
        _record_spawn(spawning, one.entity, one.bond, report)


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
    """Spawn now, or when the description is parsed; raises as `spawn_entity` does."""
    if spawning.descriptions.provider.is_parsed(order):
        return spawn_entity(spawning, order)
    return DeferredResponse(
        lambda: spawning.descriptions.provider.is_parsed(order),
        lambda: spawn_entity(spawning, order),
        lambda: spawning.descriptions.has_new,
    )


def _resolve_spawn(
    spawning: Spawning, order: SpawnEntityOrder, model: Model, description: str
) -> tuple[ValidatedSpawn, list[ReportEntry]]:
    pose, notes = _resolve_pose(spawning, order, model)
    notes += make_sensor_notes(spawning, model, pose)
    if is_above_nothing(spawning, model, pose):
        notes.append(ReportEntry("suspicious", "initial_pose", NOTHING_BELOW))
    validated = ValidatedSpawn(
        name=order.name or model.name,
        namespace=order.entity_namespace,
        model=model,
        base=np.concatenate([pose, np.zeros(6)]),
        description=description,
        allow_renaming=order.allow_renaming,
        born_ns=spawning.pacing.now_ns(),
        info=None if order.info is None else check_entity_info(order.info),
    )
    return validated, notes


def is_above_nothing(spawning: Spawning, model: Model, pose: FloatArray) -> bool:
    """Whether a model that moves is placed where the world has no floor."""
    world, store = spawning.world, spawning.descriptions.store
    if spawning.current.model.ground_plane or not can_move(model) or model.is_static:
        return False
    if not np.abs(np.array(spawning.current.model.gravity)).any():
        return False
    scene = world.support_scene(store.vertices, store.corners)
    origin = pose[None, :3] + (0.0, 0.0, SEARCH_RISE_M)
    down = np.array([[0.0, 0.0, -1.0]])
    rays = Rays(origin, down, SEARCH_DEPTH_M, np.array([NO_ENTITY]))
    return not np.isfinite(cast_rays_exactly(scene.shapes, rays).ranges[0])


def _refuse_suspicious(report: tuple[ReportEntry, ...]) -> None:
    found = [f"{entry.subject}: {entry.reason}" for entry in report if entry.status == "suspicious"]
    if found:
        more = f" and {len(found) - MAX_NAMED} more" if len(found) > MAX_NAMED else ""
        raise ModelError(
            f"{len(found)} suspicious: {'; '.join(found[:MAX_NAMED])}{more}; "
            "correct them, or spawn without strict",
            code=SpawnCode.RESOURCE_PARSE_ERROR,
            slug="report.suspicious",
        )


def _resolve_pose(
    spawning: Spawning, request: SpawnEntityOrder, model: Model
) -> tuple[FloatArray, list[ReportEntry]]:
    wanted = request.initial_pose
    notes = []
    if is_zero_quaternion(wanted.pose.orientation):
        notes.append(
            ReportEntry("suspicious", "initial_pose", "all-zero quaternion read as identity")
        )
    pose = pose_to_world(spawning.world, wanted.header.frame_id, pose_to_row(wanted.pose))
    qx, qy, qz, qw = pose[3:7].tolist()
    # -clearance would be -0 for a model without collisions.
    ground_z = 0.0 - spawning.descriptions.find_ground_clearance(model, (qx, qy, qz, qw))
    if request.snap_to_ground:
        pose[2] = ground_z
    depth = ground_z - float(pose[2])
    if depth > UNDERGROUND_M:
        notes.append(
            ReportEntry(
                "suspicious",
                "initial_pose",
                f"lowest point is {depth * 100:.1f} cm below ground; "
                f"z = {ground_z:.3f} puts it on the ground",
            )
        )
    return pose, notes


def _make_overlap_notes(others: list[str]) -> list[ReportEntry]:
    if not others:
        return []
    named = ", ".join(f"'{name}'" for name in others[:MAX_NAMED])
    more = f" and {len(others) - MAX_NAMED} more" if len(others) > MAX_NAMED else ""
    return [ReportEntry("suspicious", "initial_pose", f"overlaps entity {named}{more}")]


def spawn_entities(
    spawning: Spawning, request: SpawnEntitiesOrder
) -> SpawnEntitiesResponse | DeferredResponse[SpawnEntitiesResponse]:
    """Spawn many entities: all that can be, or if atomic all or none."""
    if len(request.spawn_requests) > MAX_SPAWNS:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{len(request.spawn_requests)} spawns are too many; use {MAX_SPAWNS} at most",
        )
    orders = [_merge_order(request.common, one) for one in request.spawn_requests]
    batch = (
        _AtomicSpawns(spawning, orders) if request.atomic else _IndependentSpawns(spawning, orders)
    )
    return batch.response() if batch.advance() else DeferredResponse(batch.advance, batch.response)


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
    """Spawn orders and their results so far."""

    def __init__(self, spawning: Spawning, orders: list[SpawnEntityOrder]) -> None:
        self._spawning = spawning
        self._orders = orders
        self._results: list[SpawnResult] = []
        self._read: dict[int, ParsedSpawnModel] = {}

    def _is_read(self, order: SpawnEntityOrder) -> bool:
        """Whether the description is parsed; it is kept until the batch ends."""
        # Orders with the same resource share the object; comparing texts is slow.
        number = id(order.entity_resource)
        if number not in self._read and self._spawning.descriptions.provider.is_parsed(order):
            try:
                self._read[number] = self._spawning.descriptions.provider.model(order)
            except SimError as error:
                self._read[number] = error
        return number in self._read

    def _is_ready_to_spawn(self, order: SpawnEntityOrder) -> bool:
        """Whether the engine can add the model without delay; otherwise prepare it."""
        read = self._read[id(order.entity_resource)]
        return isinstance(read, SimError) or self._spawning.world.prepare(read[0])

    def _model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        read = self._read[id(order.entity_resource)]
        if isinstance(read, SimError):
            raise read
        return read

    def response(self) -> SpawnEntitiesResponse:
        """Make the response with the result of each order."""
        failed = [one for one in self._results if one.result.result != ResultCode.OK]
        if not failed:
            return SpawnEntitiesResponse(results=tuple(self._results))
        message = f"{len(failed)} of {len(self._results)} were not spawned; the results say why"
        return SpawnEntitiesResponse(
            Result(SpawnEntitiesCode.ENTITIES_SPAWN_FAILED, message), tuple(self._results)
        )


class _IndependentSpawns(_SpawnBatch):
    """Orders spawned one by one, with steps in between."""

    def __init__(self, spawning: Spawning, orders: list[SpawnEntityOrder]) -> None:
        super().__init__(spawning, orders)
        self._work = self._spawn_each()

    def advance(self) -> bool:
        """Spawn for a time slice; return whether all orders are done."""
        end_ns = _find_slice_end(self._spawning)
        for is_spawned in self._work:
            if not is_spawned or self._spawning.pacing.now_ns() >= end_ns:
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
    """Orders staged first and then committed between two steps, or none of them."""

    def __init__(self, spawning: Spawning, orders: list[SpawnEntityOrder]) -> None:
        self._is_dry_run = any(order.dry_run for order in orders)
        replace = msgspec.structs.replace
        super().__init__(spawning, [replace(order, dry_run=False) for order in orders])
        self._unparsed = list({id(one.entity_resource): one for one in self._orders}.values())
        self._has_started = False
        self._staged: list[StagedSpawn] = []

    def advance(self) -> bool:
        """Stage for a time slice, commit after the last; return whether the batch has ended."""
        if self._spawning.descriptions.has_new or not self._has_started:
            self._has_started = True
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
        """Stage entities for a time slice; return whether all are staged."""
        end_ns = _find_slice_end(self._spawning)
        for order in self._orders[len(self._staged) :]:
            if not self._is_ready_to_spawn(order):
                break
            staged = stage_model(self._spawning, order, *self._model(order))
            self._staged.append(staged)
            self._results.append(SpawnResult(Result(), staged.entity.name))
            if self._spawning.pacing.now_ns() >= end_ns:
                break
        return len(self._staged) == len(self._orders)

    def _fail_all(self, error: SimError) -> None:
        failed = len(self._results)
        if failed == len(self._orders):
            self._results = [_make_refused_result(error)] * failed
            return
        name = self._orders[failed].name or f"number {failed}"
        reason = f"{NOT_SPAWNED_PREFIX} '{name[:80]}': all or none were requested"
        other = SpawnResult(Result(ResultCode.OPERATION_FAILED, reason))
        self._results = [other] * len(self._orders)
        self._results[failed] = _make_refused_result(error)


def _find_slice_end(spawning: Spawning) -> int:
    """Return the wall time until which spawning may run without delaying the next step."""
    now_ns = spawning.pacing.now_ns()
    if (left_ns := spawning.pacing.due_ns - now_ns) > MIN_SPARE_NS:
        return now_ns + min(left_ns // 2, MAX_SPARE_SLICE_NS)
    return now_ns + spawning.pacing.loop_stats.work_budget_ns(SPAWN_SLICE_NS)


def _make_refused_result(error: SimError) -> SpawnResult:
    return SpawnResult(Result(int(error.code), str(error)))


def get_spawnables(
    descriptions: Descriptions, request: spawn_messages.GetSpawnablesRequest
) -> spawn_messages.GetSpawnablesResponse | DeferredResponse[spawn_messages.GetSpawnablesResponse]:
    """List the models shipped with the server, once all of them are parsed."""
    if unknown := [source for source in request.sources if source != SHIPPED_SCHEME]:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"source {unknown[0][:80]!r} is not known; use {SHIPPED_SCHEME} or none",
        )
    orders = [
        SpawnEntityOrder(entity_resource=Resource(SHIPPED_SCHEME + name))
        for name in list_builtin_models()
    ]

    def respond() -> spawn_messages.GetSpawnablesResponse:
        found = tuple(_make_spawnable(descriptions, order) for order in orders)
        return spawn_messages.GetSpawnablesResponse(spawnables=found)

    def is_read() -> bool:
        # Not all(): each call of is_read() starts the parsing of one model.
        return sum(descriptions.provider.is_parsed(order) for order in orders) == len(orders)

    return (
        respond() if is_read() else DeferredResponse(is_read, respond, lambda: descriptions.has_new)
    )


def _make_spawnable(
    descriptions: Descriptions, order: SpawnEntityOrder
) -> spawn_messages.Spawnable:
    model, _ = descriptions.provider.model(order)
    at_zero = np.zeros((1, len(model.joints)))
    shapes = place_collision_shapes(
        model, IDENTITY_POSE[None], at_zero, descriptions.store.vertices
    )
    bounds = make_bounds(shapes, BoundsType.BOX)
    return spawn_messages.Spawnable(order.entity_resource, _describe_model(model), bounds)


def _describe_model(model: Model) -> str:
    drive = type(model.drive).__name__ if model.drive else "no drive"
    return f"{model.name}: {drive}, {model.mass_kg:.3g} kg"
