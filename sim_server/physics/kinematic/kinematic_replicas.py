"""Copies of a world of kinematic robots: the rows of all worlds are stepped as one table."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from zensim.sim_server.physics.engine import (
    BodyStates,
    BoolArray,
    EngineReplicas,
    FloatArray,
    SteppedTogether,
)
from zensim.sim_server.physics.kinematic.kinematic_robots import KinematicRobots
from zensim.sim_server.physics.kinematic.proximity_index import (
    NONE_STOPPED,
    ProximityIndex,
    step_robots,
)
from zensim.sim_server.physics.kinematic.tier_body_table import TierBodyTable

if TYPE_CHECKING:
    from zensim.sim_server.scene.broad_phase import IntArray


class KinematicReplicas(EngineReplicas):
    """Robots of many equal worlds, world by world; worlds share the edges of what never moves.

    Each row has the bits that it has in a world of its own: a step is made of operations on
    elements, and of minima over the pairs of one world.
    """

    def __init__(
        self,
        table: TierBodyTable,
        kinematic: KinematicRobots,
        surroundings: ProximityIndex,
        bodies: Sequence[int],
        count: int,
    ) -> None:
        """Make the copies.

        Args:
            table: Of the world, of which all that moves is kinematic.
            kinematic: Its robots.
            surroundings: Its discs and edges.
            bodies: See `Engine.replicate`.
            count: Likewise.
        """
        rows = np.array(bodies, np.intp)
        self._shape = count, len(rows)
        self._table = table.tile(rows, count)
        self._kinematic = kinematic.tile(self._table, rows, count)
        self._surroundings = surroundings.tile(self._table, self._kinematic, count)
        self._stopped: IntArray = NONE_STOPPED[0]
        self._start = [column[..., 0, :].copy() for column in self._view_state()]

    def make_groups(self, least: int) -> Sequence[SteppedTogether]:  # noqa: ARG002
        """See `EngineReplicas.make_groups`; one group: its arrays are what makes it fast."""
        return [self]

    def step(self) -> bool:
        """See `SteppedTogether.step`."""
        self._stopped, _ = step_robots(self._kinematic, self._surroundings)
        return True

    def read(self) -> BodyStates:
        """See `EngineReplicas.read`."""
        everything = slice(0, len(self._table.tier))
        positions, velocities = self._kinematic.positions.numbers, self._kinematic.velocities
        return BodyStates(self._table.states(everything), positions.copy(), velocities.copy())

    def command(self, targets: FloatArray) -> None:
        """See `EngineReplicas.command`."""
        self._kinematic.targets.numbers[:] = targets.reshape(-1)

    def restore(self, copies: Iterable[int]) -> None:
        """See `EngineReplicas.restore`."""
        chosen = np.fromiter(copies, np.intp)
        for column, start in zip(self._view_state(), self._start, strict=True):
            column[..., chosen, :] = start[..., None, :]
        self._stopped = self._stopped[~np.isin(self._stopped // self._shape[1], chosen)]
        self._surroundings.invalidate()

    def save(self) -> tuple[FloatArray, ...]:
        """See `EngineReplicas.save`."""
        stopped = self._stopped.astype(np.float64)
        return (*(column.copy() for column in self._view_state()), stopped)

    def load(self, saved: tuple[FloatArray, ...]) -> None:
        """See `EngineReplicas.load`."""
        for column, values in zip(self._view_state(), saved[:-1], strict=True):
            column[:] = values
        self._stopped = saved[-1].astype(np.intp)
        self._surroundings.invalidate()

    def find_touching(self) -> BoolArray:
        """See `EngineReplicas.find_touching`: what stopped before others in the last step."""
        found = np.zeros(len(self._table.tier), np.bool_)
        if len(self._stopped):
            found[self._surroundings.find_touched(self._stopped)] = True
        return found.reshape(self._shape)

    def _view_state(self) -> list[FloatArray]:
        """View what changes as arrays (..., copies, k)."""
        table, robots = self._table, self._kinematic
        changing = (table.place, table.yaw, table.half, table.tilt, table.twist)
        count = self._shape[0]
        return [
            column.reshape(*column.shape[:-1], count, column.shape[-1] // count)
            for column in (*changing, *robots.view_state())
        ]
