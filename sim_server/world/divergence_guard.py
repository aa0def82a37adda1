"""Detects entities whose state diverged, stores last valid states, and chooses what to freeze."""

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
"""Largest valid coordinate: ten times the limit of requested poses."""
PROBATION_NS = 1_000_000_000
"""An entity that diverges again within this simulation time is frozen."""
FROZEN_MESSAGE = (
    "frozen at its last valid state: its state was not finite or out of range; "
    "set its state, reset the world, or delete it"
)
RESET_TO_REST_MESSAGE = (
    "put at rest at its last valid state: it diverged together with another entity"
)


@dataclass(frozen=True)
class RestState:
    """State of an entity at rest.

    Attributes:
        base: State row (13,), velocities 0.
        positions: Joint positions in the order of `Model.joints`.
    """

    base: FloatArray
    positions: FloatArray


class DivergenceGuard:
    """The last valid states, and the frozen entities."""

    def __init__(self) -> None:
        self._frozen: dict[str, RestState] = {}
        self._diverged_ns: dict[str, int] = {}
        self._new_names: set[str] = set()
        self._index: EntityIndex | None = None
        self._states: BodyStates | None = None

    def is_frozen(self, name: str) -> bool:
        """Whether an entity is frozen."""
        return name in self._frozen

    def require_not_frozen(self, name: str) -> None:
        """Check that an entity is not frozen.

        Raises:
            IncorrectState: The entity is frozen.
        """
        if self.is_frozen(name):
            raise IncorrectState(f"entity '{name}' is {FROZEN_MESSAGE}")

    def find_diverged(self, index: EntityIndex, states: BodyStates) -> list[str]:
        """Name the entities whose state is not valid, except frozen ones."""
        if is_valid_state(states):
            return []
        base = states.base
        is_diverged = ~np.isfinite(base).all(axis=1) | (np.abs(base[:, :3]) > MAX_COORDINATE_M).any(
            axis=1
        )
        owner = np.repeat(np.arange(len(index.names)), index.joint_count)
        rows = set(np.flatnonzero(is_diverged).tolist())
        for numbers in (states.joint_positions, states.joint_velocities):
            rows.update(owner[~np.isfinite(numbers)].tolist())
        names = [index.names[row] for row in sorted(rows)]
        return [name for name in names if name not in self._frozen]

    def find_culprits(self, diverged: Sequence[Entity], time_ns: int) -> set[str]:
        """Choose which of the entities that diverged in the same step are frozen.

        Those that diverge again within `PROBATION_NS`, or else the fastest. Entities that cannot
        move are never the cause.
        """
        names = [entity.name for entity in diverged if can_move(entity.model)]
        repeated = {
            name
            for name in names
            if time_ns - self._diverged_ns.get(name, -PROBATION_NS) < PROBATION_NS
        }
        self._diverged_ns.update(dict.fromkeys(names, time_ns))
        return repeated or set(sorted(names, key=self._speed_of)[-1:])

    def last_valid_state(self, entity: Entity) -> RestState:
        """Find the last valid state of an entity, at rest; its initial state if there is none."""
        base, positions = entity.initial, np.zeros(len(entity.model.joints))
        if (found := self._last(entity.name)) is not None:
            base, positions, _ = found
        row = base.copy()
        row[7:] = 0.0
        return RestState(row, positions.copy())

    def freeze(self, entity: Entity) -> RestState:
        """Mark an entity as frozen."""
        return self._frozen.setdefault(entity.name, self.last_valid_state(entity))

    def unfreeze(self, name: str) -> RestState | None:
        """Mark an entity as not frozen; return the state that it had, None if it was not frozen."""
        self._diverged_ns.pop(name, None)
        return self._frozen.pop(name, None)

    def forget(self, name: str) -> None:
        """Forget a deleted entity: a new one of the same name does not get its states."""
        self.unfreeze(name)
        self._new_names.add(name)

    def forget_all(self) -> None:
        """Forget all valid states, after a reset; frozen entities stay frozen."""
        self._diverged_ns.clear()
        self._index = self._states = None

    def remember(self, index: EntityIndex, states: BodyStates) -> BodyStates:
        """Store valid states; return them with the joint positions of frozen entities filled in."""
        for name, rest in self._frozen.items():
            states.joint_positions[index.joints_of(name)] = rest.positions
        self._index, self._states = index, states
        self._new_names.clear()
        return states

    def _last(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        index, states = self._index, self._states
        if index is None or states is None or name in self._new_names:
            return None
        if (row := index.row.get(name)) is None:
            return None
        joints = index.joints_of(name)
        return states.base[row], states.joint_positions[joints], states.joint_velocities[joints]

    def _speed_of(self, name: str) -> float:
        if (found := self._last(name)) is None:
            return np.inf
        base, _, velocities = found
        return float(np.abs(np.concatenate([base[7:], velocities])).max())


def is_valid_state(states: BodyStates) -> bool:
    """Test quickly whether all states are valid; False may be wrong for very large values."""
    # A sum is finite only if all its terms are: one pass over each array.
    sums = states.base.sum() + states.joint_positions.sum() + states.joint_velocities.sum()
    return bool(np.isfinite(sums)) and bool(
        np.abs(states.base[:, :3]).max(initial=0.0) <= MAX_COORDINATE_M
    )


def can_move(model: Model) -> bool:
    """Whether any link of a model can move."""
    return not model.is_static or any(joint.kind != "fixed" for joint in model.joints)


def make_frozen_model(model: Model, positions: FloatArray) -> Model:
    """Make a static copy of a model with its joints fixed at these positions."""
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
