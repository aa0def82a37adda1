"""CoverField: robots visit all cells of a field together."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from zensim.envs.robot_task import (
    FAR_M,
    FAST,
    NEIGHBOURS,
    BoolArray,
    FleetView,
    GoalProgress,
    Judgement,
    RobotTask,
    find_in_robot,
    find_neighbours,
)
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.se3 import FloatArray

CELL, NEARER, COLLISION, STEP = 0.1, 0.2, -1.0, -0.01
"""Rewards; `NEARER` of a metre."""
CELL_M = 0.5
"""Side of a cell; it is covered by a robot that comes as near to its centre."""
WANTED_SHARE = 0.95


class CoverField(RobotTask):
    """Come near each cell of a square field about the robots.

    Observation: the place in the field x, y [m], cosine and sine of the heading, forward velocity
    [m/s] and turn [rad/s], the share of cells that are covered, the nearest open cell, in the
    robot's frame x, y [m], and the three nearest robots as in `AvoidEachOther`.
    Reward: 0.1 for each cell that the robot covers first, 0.2 for each metre that it came nearer to
    the nearest open cell, -0.01 a step, and -1 at a collision, which ends the episode of the robot.
    Those of the others end with 95 % of the cells.
    """

    settings: Mapping[str, object] = MappingProxyType({"count": 4, "time_limit_s": 120.0})

    def __init__(self, *, side_m: float = 6.0) -> None:
        """Set the side of the field, which is rounded to cells of 0.5 m."""
        cells = max(1, round(side_m / CELL_M))
        along = (np.arange(cells) - (cells - 1) / 2.0) * CELL_M
        self._cells = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        self._progress = GoalProgress(CELL_M)
        self._centres: FloatArray = np.zeros((0, 2))
        self._is_covered: BoolArray = np.zeros((0, 0), np.bool_)

    def list_bounds(self, robots: int) -> FloatArray:  # noqa: ARG002 - the same for any
        """See `RobotTask`."""
        own = [FAR_M, FAR_M, 1.0, 1.0, FAST, FAST, 1.0, FAR_M, FAR_M]
        return np.array(own + [FAR_M, FAR_M, FAST, FAST] * NEIGHBOURS)

    def restart(
        self,
        worlds: IntArray,
        view: FleetView,
        streams: WorldStreams,  # noqa: ARG002 - nothing is drawn
    ) -> None:
        """See `RobotTask`."""
        if len(self._centres) != len(view.poses):
            self._centres = np.zeros((len(view.poses), 2))
            self._is_covered = np.zeros((len(view.poses), len(self._cells)), np.bool_)
        self._centres[worlds] = view.poses[worlds, :, :2].mean(axis=1)
        self._is_covered[worlds] = False
        self._is_covered[worlds] = self._find_near(view)[worlds].any(axis=1)
        self._progress.restart(worlds, view.poses, self._find_wanted(view)[worlds])

    def observe(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        places = view.poses[..., :2] - self._centres[:, None]
        heading = view.poses[..., 2:]
        share = np.broadcast_to(self._is_covered.mean(axis=1)[:, None, None], heading.shape)
        own = [places, np.cos(heading), np.sin(heading), view.velocities, share]
        nearest = find_in_robot(view.poses, self._progress.goals)
        return np.concatenate([*own, nearest, find_neighbours(view)], axis=-1)

    def judge(self, view: FleetView) -> Judgement:
        """See `RobotTask`."""
        nearer, _ = self._progress.advance(view.poses)
        is_new = self._find_near(view) & ~self._is_covered[:, None]
        self._is_covered |= is_new.any(axis=1)
        is_done = self._is_covered.mean(axis=1) >= WANTED_SHARE
        self._progress.restart(np.arange(len(is_done)), view.poses, self._find_wanted(view))
        rewards = CELL * is_new.sum(axis=-1) + NEARER * nearer + STEP + COLLISION * view.is_touching
        is_success = np.broadcast_to(is_done[:, None], view.is_touching.shape)
        return Judgement(rewards, is_success, view.is_touching & ~is_success)

    def _find_wanted(self, view: FleetView) -> FloatArray:
        """Find the nearest cell that is not covered x, y [m] in the world, (worlds, robots, 2)."""
        places = view.poses[..., :2] - self._centres[:, None]
        square = ((self._cells - places[:, :, None]) ** 2).sum(axis=-1)
        square = np.where(self._is_covered[:, None], np.inf, square)
        return np.asarray(self._cells[square.argmin(axis=-1)] + self._centres[:, None])

    def _find_near(self, view: FleetView) -> BoolArray:
        """Find the cells (worlds, robots, cells) that are near each robot."""
        away = self._cells - (view.poses[..., :2] - self._centres[:, None])[:, :, None]
        return np.asarray((away * away).sum(axis=-1) <= CELL_M * CELL_M)
