"""WorldState: a snapshot as arrays, with a row for each entity."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import Snapshot
from zensim.proto.state_hash import hash_states

FloatArray = npt.NDArray[np.float64]
POSE, LINEAR, ANGULAR = slice(0, 7), slice(7, 10), slice(10, 13)
"""Columns of a state row: x y z qx qy qz qw; linear and angular velocity in the world frame."""


@dataclass(frozen=True)
class WorldState:
    """State of all entities at one step; arrays are read-only."""

    snapshot: Snapshot
    row: Mapping[str, int]
    """Row of each entity in `base`."""

    @cached_property
    def base(self) -> FloatArray:
        """Position, quaternion, linear and angular velocity of each entity, (n, 13)."""
        return np.frombuffer(self.snapshot.base, dtype="<f8").reshape(-1, STATE_COLUMNS)

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self.snapshot.time_ns / NANOSECONDS

    @property
    def order(self) -> tuple[int, int]:
        """Epoch and step: later states are greater."""
        return self.snapshot.epoch, self.snapshot.step

    @cached_property
    def twists(self) -> FloatArray:
        """Linear and angular velocity of each entity in its own frame, (n, 6)."""
        found = np.concatenate(
            [
                _rotate_inverse(self.base[:, 3:7], self.base[:, LINEAR]),
                _rotate_inverse(self.base[:, 3:7], self.base[:, ANGULAR]),
            ],
            axis=1,
        )
        found.flags.writeable = False
        return found

    def digest(self) -> str:
        """Hash of time, names, poses, velocities and joint positions, as hexadecimal digits."""
        snapshot = self.snapshot
        states = snapshot.base, snapshot.joint_positions
        return hash_states(snapshot.time_ns, snapshot.names, *states)


def make_world_state(snapshot: Snapshot, before: WorldState | None = None) -> WorldState:
    """Make the state of a snapshot; `before` saves the index of an equal roster."""
    if before is not None and before.snapshot.names == snapshot.names:
        return WorldState(snapshot, before.row)
    row = {name: number for number, name in enumerate(snapshot.names)}
    return WorldState(snapshot, MappingProxyType(row))


def _rotate_inverse(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) of the world into frames with these orientations (n, 4), x y z w."""
    axis, scalar = -quaternions[:, :3], quaternions[:, 3:4]
    across = 2.0 * np.cross(axis, vectors)
    return np.asarray(vectors + scalar * across + np.cross(axis, across))
