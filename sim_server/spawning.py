"""Spawning: everything is checked before anything is made; a dry run stops there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model, ReportEntry
from zensim.proto.messages.result_messages import Result, SpawnCode
from zensim.proto.messages.spawn_messages import SpawnEntityOrder, SpawnEntityReport
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import IncorrectState, ModelError
from zensim.sim_server.later import Later
from zensim.sim_server.lookup.frames import in_world
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.world.birth import Birth
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.infos import checked
from zensim.sim_server.world.poses import is_zero, pose_row

UNDERGROUND_M = 0.001
MAX_NAMED = 3


def spawn(desk: Desk, order: SpawnEntityOrder) -> SpawnEntityReport:
    """Put an entity into the world, or say what that would do.

    Raises:
        SimError: It is refused; nothing has changed.
    """
    return spawn_model(desk, order, *desk.descriptions.model(order))


def spawn_model(
    desk: Desk, order: SpawnEntityOrder, model: Model, description: str
) -> SpawnEntityReport:
    """Spawn a model that has been read, whatever the order's resource is; raises as `spawn`."""
    _check_bond(desk, order.bond)
    birth, notes = _planned(desk, order, model, description)
    if order.strict or order.dry_run:
        notes.extend(_overlaps(desk.world.rehearse(birth)))
    if order.strict:
        _refuse_suspicious((*notes, *birth.model.report))
    if order.dry_run:
        name, namespace = desk.world.names_for(birth)
        return SpawnEntityReport(Result(), name, namespace, (*notes, *birth.model.report))
    entity = desk.world.spawn(birth)
    if not order.strict:
        notes.extend(_overlaps(desk.world.overlapped(entity)))
    _tell_of(desk, entity, order.bond, notes)
    report = (*notes, *birth.model.report)
    return SpawnEntityReport(Result(), entity.name, entity.namespace, report)


@dataclass(frozen=True)
class Expected:
    """What was ordered and is not there yet."""

    entity: Entity
    bond: str
    notes: tuple[ReportEntry, ...]
    overlapped: Callable[[], list[str]]
    """Says whom it overlaps."""


def expect_model(desk: Desk, order: SpawnEntityOrder, model: Model, description: str) -> Expected:
    """Make what `spawn_model` spawns, but let it in later; raises as that does."""
    _check_bond(desk, order.bond)
    birth, notes = _planned(desk, order, model, description)
    entity, overlapped = desk.world.expect(birth)
    if order.strict:
        try:
            _refuse_suspicious((*notes, *_overlaps(overlapped()), *birth.model.report))
        except ModelError:
            desk.world.turn_away([entity])
            raise
    return Expected(entity, order.bond, tuple(notes), overlapped)


def let_in(desk: Desk, expected: Sequence[Expected]) -> None:
    """Let all that is expected be there between two steps.

    Raises:
        IncorrectState: A reset or another world has ended it, or what it hangs on is gone.
    """
    for bond in {one.bond for one in expected}:
        _check_bond(desk, bond)
    if not all(desk.world.expects(one.entity) for one in expected):
        raise IncorrectState("the world was reset or replaced meanwhile; ask again")
    notes = [(*one.notes, *_overlaps(one.overlapped())) for one in expected]
    desk.world.let_in([one.entity for one in expected])
    for one, told in zip(expected, notes, strict=True):
        _tell_of(desk, one.entity, one.bond, told)


def _tell_of(desk: Desk, entity: Entity, bond: str, notes: Sequence[ReportEntry]) -> None:
    if bond:
        desk.bonded.setdefault(bond, []).append((entity.name, entity.born_ns))
    for note in notes:
        desk.world.warn(entity.name, f"{note.subject}: {note.reason}")


def spawn_when_read(desk: Desk, order: SpawnEntityOrder) -> SpawnEntityReport | Later:
    """Spawn now, or once the description has been read; raises as `spawn` does."""
    if desk.descriptions.is_read(order):
        return spawn(desk, order)
    return Later(
        lambda: desk.has_read and desk.descriptions.is_read(order), lambda: spawn(desk, order)
    )


def _planned(
    desk: Desk, order: SpawnEntityOrder, model: Model, description: str
) -> tuple[Birth, list[ReportEntry]]:
    pose, notes = _birth_pose(desk, order, model)
    birth = Birth(
        name=order.name or model.name,
        namespace=order.entity_namespace,
        model=model,
        base=np.concatenate([pose, np.zeros(6)]),
        description=description,
        allow_renaming=order.allow_renaming,
        born_ns=desk.now_ns(),
        info=None if order.info is None else checked(order.info),
    )
    return birth, notes


def _check_bond(desk: Desk, bond: str) -> None:
    if not bond:
        return
    if bond not in desk.alive_bonds:
        raise IncorrectState(
            f"bond '{bond[:80]}' has no liveliness token; declare it before spawning"
        )


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


def _birth_pose(
    desk: Desk, request: SpawnEntityOrder, model: Model
) -> tuple[FloatArray, list[ReportEntry]]:
    wish = request.initial_pose
    notes = []
    if is_zero(wish.pose.orientation):
        notes.append(
            ReportEntry("suspicious", "initial_pose", "all-zero quaternion read as identity")
        )
    pose = in_world(desk.world, wish.header.frame_id, pose_row(wish.pose))
    qx, qy, qz, qw = pose[3:7].tolist()
    # Not -clearance, which is -0 for a model without collisions.
    standing = 0.0 - find_ground_clearance(model, (qx, qy, qz, qw), desk.store.corners)
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


def _overlaps(others: list[str]) -> list[ReportEntry]:
    if not others:
        return []
    named = ", ".join(f"'{name}'" for name in others[:MAX_NAMED])
    more = f" and {len(others) - MAX_NAMED} more" if len(others) > MAX_NAMED else ""
    return [ReportEntry("suspicious", "initial_pose", f"overlaps entity {named}{more}")]
