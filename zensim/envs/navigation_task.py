"""NavigateMaze and DeliverGoods: robots drive to free places of a world with walls."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from zensim.envs.free_places import find_free_places
from zensim.envs.reaching_task import ReachGoal
from zensim.envs.robot_task import (
    FAR_M,
    FAST,
    NEIGHBOURS,
    FleetView,
    Judgement,
    WorldStart,
    find_neighbours,
)
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.se3 import FloatArray

DELIVERY, COLLISION, STEP = 1.0, -2.0, -0.01
"""Rewards."""


class NavigateMaze(ReachGoal):
    """Reach a place between the walls that is drawn among those that the robots can reach.

    Observation and reward are those of `ReachGoal`; a lidar follows, unless other sensors are set.
    """

    settings: Mapping[str, object] = MappingProxyType(
        {"world": "maze", "model": "box_bot_lidar", "sensors": ("scan",), "time_limit_s": 60.0}
    )

    draws = 1
    """Places that are drawn for a goal, which is the nearest of them."""

    def __init__(self, *, tolerance_m: float = 0.2, clearance_m: float = 0.2) -> None:
        """Set the task.

        Args:
            tolerance_m: Distance at which a goal is reached.
            clearance_m: Least distance of goals from what is fixed.
        """
        super().__init__(tolerance_m=tolerance_m)
        self._clearance_m = clearance_m
        self.places: FloatArray = np.zeros((0, 2))
        """Places (k, 2) of goals."""

    def prepare(self, start: WorldStart) -> None:
        """See `RobotTask`."""
        self.places = find_free_places(start, self._clearance_m)

    def restart(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> None:
        """See `RobotTask`."""
        self._progress.restart(worlds, view.poses, self._draw_goals(worlds, view, streams))

    def _draw_goals(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> FloatArray:
        """Draw goals (m, robots, 2)."""
        starts = view.poses[worlds, :, None, :2]
        drawn = streams.draw(worlds, starts.shape[1] * self.draws)
        found = self.places[(drawn * len(self.places)).astype(np.intp)]
        found = found.reshape(*starts.shape[:2], self.draws, 2)
        nearest = ((found - starts) ** 2).sum(axis=-1).argmin(axis=-1)
        return np.take_along_axis(found, nearest[..., None, None], axis=2)[:, :, 0]


class DeliverGoods(NavigateMaze):
    """Reach places one after another, among other robots and shelves.

    A place is the nearest of eight that are drawn.
    Observation: that of `ReachGoal`, and that of the three nearest robots in `AvoidEachOther`; a
    lidar follows, unless other sensors are set.
    Reward: metres that the robot came nearer to its goal, -0.01 a step, 1 at the goal, and -2 at
    a collision, which ends the episode of the robot. At its goal it gets the next.
    """

    settings: Mapping[str, object] = MappingProxyType(
        {**NavigateMaze.settings, "world": "warehouse", "count": 20, "spacing": 0.6}
    )

    draws = 8

    def list_bounds(self, robots: int) -> FloatArray:
        """See `RobotTask`."""
        others = np.array([FAR_M, FAR_M, FAST, FAST] * NEIGHBOURS)
        return np.concatenate([super().list_bounds(robots), others])

    def restart(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> None:
        """See `RobotTask`."""
        self._streams = streams
        super().restart(worlds, view, streams)

    def observe(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        return np.concatenate([super().observe(view), find_neighbours(view)], axis=-1)

    def judge(self, view: FleetView) -> Judgement:
        """See `RobotTask`."""
        nearer, is_there = self._progress.advance(view.poses)
        rewards = nearer + STEP + DELIVERY * is_there + COLLISION * view.is_touching
        worlds = np.flatnonzero(is_there.any(axis=1))
        if len(worlds):
            drawn = self._draw_goals(worlds, view, self._streams)
            goals = np.where(is_there[worlds, :, None], drawn, self._progress.goals[worlds])
            self._progress.restart(worlds, view.poses, goals)
        return Judgement(rewards, np.zeros_like(is_there), view.is_touching)
