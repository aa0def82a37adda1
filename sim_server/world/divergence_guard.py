"""Detects entities whose state diverged, keeps their last valid state, and freezes the culprits."""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from zensim.proto.forward_kinematics import compute_joint_poses
from zensim.proto.messages.model_messages import Joint, Model, Origin
from zensim.proto.se3 import to_origin
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.world.entity import Entity, EntityIndex

MAX_COORDINATE_M = 1e6
"""From the origin along an axis: ten times as far as a pose may be asked for."""
PROBATION_NS = 1_000_000_000
"""An entity that goes bad again within this simulation time is frozen."""
FROZEN_MESSAGE = (
    "frozen where it was last good: its state was not finite or out of the world; "
    "set its state, reset the world, or delete it"
)
RESET_TO_REST_MESSAGE = "put back at rest where it was last good: it went bad together with another"


@dataclass(frozen=True)
class RestState:
    """How an entity stands still.

    Attributes:
        base: State row (13,), velocities 0.
        positions: Of its joints, in the order of `Model.joints`.
    """

    base: FloatArray
    positions: FloatArray


class DivergenceGuard:
    """Remembers the last good reading, and which entities are frozen."""

    def __init__(self) -> None:
        self._frozen: dict[str, RestState] = {}
        self._diverged_ns: dict[str, int] = {}
        self._new_names: set[str] = set()
        self._roster: EntityIndex | None = None
        self._reading: BodyStates | None = None

    def is_frozen(self, name: str) -> bool:
        """Whether an entity is frozen."""
        return name in self._frozen

    def require_not_frozen(self, name: str) -> None:
        """Refuse what is frozen.

        Raises:
            IncorrectState: The entity is frozen.
        """
        if self.is_frozen(name):
            raise IncorrectState(f"entity '{name}' is {FROZEN_MESSAGE}")

    def find_diverged(self, roster: EntityIndex, reading: BodyStates) -> list[str]:
        """Name the entities that have gone bad, but for those that are frozen already."""
        if is_valid_state(reading):
            return []
        base = reading.base
        is_bad = ~np.isfinite(base).all(axis=1) | (np.abs(base[:, :3]) > MAX_COORDINATE_M).any(
            axis=1
        )
        owner = np.repeat(np.arange(len(roster.names)), roster.joint_count)
        rows = set(np.flatnonzero(is_bad).tolist())
        for numbers in (reading.joint_positions, reading.joint_velocities):
            rows.update(owner[~np.isfinite(numbers)].tolist())
        names = [roster.names[row] for row in sorted(rows)]
        return [name for name in names if name not in self._frozen]

    def find_culprits(self, bad: Sequence[Entity], time_ns: int) -> set[str]:
        """Choose whom to freeze of those that went bad together; the others were pulled along.

        It is those that are bad again after a short time, or else the one that was fastest. What
        cannot move did not begin it.
        """
        names = [entity.name for entity in bad if can_move(entity.model)]
        again = {
            name
            for name in names
            if time_ns - self._diverged_ns.get(name, -PROBATION_NS) < PROBATION_NS
        }
        self._diverged_ns.update(dict.fromkeys(names, time_ns))
        return again or set(sorted(names, key=self._speed_of)[-1:])

    def last_valid_state(self, entity: Entity) -> RestState:
        """Find where an entity was last good; where it was spawned if it never was."""
        base, positions = entity.initial, np.zeros(len(entity.model.joints))
        if (found := self._last(entity.name)) is not None:
            base, positions, _ = found
        row = base.copy()
        row[7:] = 0.0
        return RestState(row, positions.copy())

    def freeze(self, entity: Entity) -> RestState:
        """Note that an entity is frozen from now on."""
        return self._frozen.setdefault(entity.name, self.last_valid_state(entity))

    def unfreeze(self, name: str) -> RestState | None:
        """Note that an entity lives again; None when it was not frozen."""
        self._diverged_ns.pop(name, None)
        return self._frozen.pop(name, None)

    def forget(self, name: str) -> None:
        """Note that an entity is gone: another of its name has nothing to do with it."""
        self.unfreeze(name)
        self._new_names.add(name)

    def forget_all(self) -> None:
        """Note that the world starts again; who is frozen remains so."""
        self._diverged_ns.clear()
        self._roster = self._reading = None

    def remember(self, roster: EntityIndex, reading: BodyStates) -> BodyStates:
        """Keep a good reading; return it with the joints of frozen entities as they froze."""
        for name, stand in self._frozen.items():
            reading.joint_positions[roster.joints_of(name)] = stand.positions
        self._roster, self._reading = roster, reading
        self._new_names.clear()
        return reading

    def _last(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        roster, reading = self._roster, self._reading
        if roster is None or reading is None or name in self._new_names:
            return None
        if (row := roster.row.get(name)) is None:
            return None
        joints = roster.joints_of(name)
        return reading.base[row], reading.joint_positions[joints], reading.joint_velocities[joints]

    def _speed_of(self, name: str) -> float:
        if (found := self._last(name)) is None:
            return np.inf
        base, _, velocities = found
        return float(np.abs(np.concatenate([base[7:], velocities])).max())


def is_valid_state(reading: BodyStates) -> bool:
    """Whether nothing has gone bad, as a rule told at a glance; if not, it may still be so."""
    # A sum is finite only if all are: one pass over each array then tells all.
    sums = reading.base.sum() + reading.joint_positions.sum() + reading.joint_velocities.sum()
    return bool(np.isfinite(sums)) and bool(
        np.abs(reading.base[:, :3]).max(initial=0.0) <= MAX_COORDINATE_M
    )


def can_move(model: Model) -> bool:
    """Whether any part of a model moves by itself."""
    return not model.is_static or any(joint.kind != "fixed" for joint in model.joints)


def make_frozen_model(model: Model, positions: FloatArray) -> Model:
    """Make a model whose links never move: its joints are fixed where they are."""
    joints = tuple(
        _fix_joint(joint, position)
        for joint, position in zip(model.joints, positions.tolist(), strict=True)
    )
    return msgspec.structs.replace(model, joints=joints, drive=None, is_static=True, dynamics="")


def _fix_joint(joint: Joint, position: float) -> Joint:
    return msgspec.structs.replace(
        joint, kind="fixed", origin=_find_moved_origin(joint, position), mimic=None
    )


def _find_moved_origin(joint: Joint, position: float) -> Origin:
    return to_origin(compute_joint_poses(joint, np.array([position]))[0])
