"""WorldView: live, writable arrays of the state of all entities of a world in process."""

import numpy as np

from zensim.api.api_errors import Invalid
from zensim.api.world_state import FloatArray
from zensim.sim_server.world.simulated_world import SimulatedWorld

POSE_COLUMNS, STATE_COLUMNS = 7, 13


class WorldView:
    """The state of all entities, as arrays that follow the world and may be written.

    What is written counts from the next step on. The arrays are the same objects until an entity is
    spawned or deleted; then `World.view` has others, and these do not follow any more.

    Attributes:
        names: Of the entities, a row each.
        poses: (n, 7) x y z [m], quaternion x y z w.
        velocities: (n, 6) linear [m/s] and angular [rad/s], in the world's axes.
        joint_positions: (k,) of all joints, entity by entity [rad or m].
        joint_velocities: (k,) likewise [rad/s or m/s].
    """

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self._index = world.entities.index
        self.names = self._index.names
        states = world.states()
        self._base = states.base.copy()
        self.poses = self._base[:, :POSE_COLUMNS]
        self.velocities = self._base[:, POSE_COLUMNS:]
        self.joint_positions = states.joint_positions.copy()
        self.joint_velocities = states.joint_velocities.copy()

    @property
    def is_current(self) -> bool:
        """Whether the entities are the same as when it was made."""
        return self._world.entities.index is self._index

    def joints_of(self, name: str) -> slice:
        """Find the joints of an entity, in the order of its model."""
        return self._index.joints_of(name)

    def refresh(self) -> None:
        """Read the present state into the arrays."""
        states = self._world.states()
        self._base[:] = states.base
        self.joint_positions[:] = states.joint_positions
        self.joint_velocities[:] = states.joint_velocities

    def apply(self) -> None:
        """Set the state of the entities whose numbers were changed.

        Raises:
            Invalid: A number is not finite, or a quaternion is 0; nothing is set.
        """
        states = self._world.states()
        is_changed = (self._base != states.base).any(axis=1)
        for own, present in (
            (self.joint_positions, states.joint_positions),
            (self.joint_velocities, states.joint_velocities),
        ):
            owners = np.repeat(np.arange(len(self.names)), self._index.joint_count)
            is_changed[owners[own != present]] = True
        rows = np.flatnonzero(is_changed).tolist()
        if not rows:
            return
        changed = {self.names[row]: self._read_row(row) for row in rows}
        for name, state in changed.items():
            self._world.set_state(name, *state)

    def _read_row(self, row: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        name = self.names[row]
        joints, base = self._index.joints_of(name), self._base[row].copy()
        state = base, self.joint_positions[joints].copy(), self.joint_velocities[joints].copy()
        norm = np.linalg.norm(base[3:7])
        if not all(np.isfinite(part).all() for part in state) or norm == 0.0:
            raise Invalid(
                f"the view of '{name}' has numbers that are not finite, or no orientation",
                hint="write finite numbers, and a quaternion other than 0",
            )
        base[3:7] /= norm
        return state
