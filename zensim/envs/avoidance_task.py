"""AvoidEachOther: robots exchange their places without a collision."""

import numpy as np

from zensim.envs.robot_task import (
    FAR_M,
    FAST,
    NEIGHBOURS,
    FleetView,
    GoalProgress,
    Judgement,
    RobotTask,
    find_in_robot,
    find_neighbours,
)
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.se3 import FloatArray

SUCCESS, COLLISION, STEP = 1.0, -2.0, -0.01
"""Rewards."""


class AvoidEachOther(RobotTask):
    """Reach the place where another robot started, and touch none.

    Robots go where the next one started, in an order that is drawn.
    Observation: the goal in the robot's frame x, y [m], forward velocity [m/s], turn [rad/s]; and
    of each of the three nearest robots its position x, y [m] and velocity x, y [m/s] in this
    frame, 20 m ahead where there is none.
    Reward: metres that the robot came nearer to its goal, -0.01 a step, 1 at the goal, and -2 at
    a collision. Both end the episode of the robot, which then stands still.
    """

    least_robots = 2

    def __init__(self, *, tolerance_m: float = 0.2) -> None:
        """Set the distance [m] at which a goal is reached."""
        self._progress = GoalProgress(tolerance_m)

    def list_bounds(self, robots: int) -> FloatArray:  # noqa: ARG002 - the same for any
        """See `RobotTask`."""
        return np.array([FAR_M, FAR_M, FAST, FAST] + [FAR_M, FAR_M, FAST, FAST] * NEIGHBOURS)

    def restart(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> None:
        """See `RobotTask`."""
        order = np.argsort(streams.draw(worlds, view.poses.shape[1]), axis=1)
        rows = np.empty_like(order)
        np.put_along_axis(rows, order, np.roll(order, -1, axis=1), axis=1)
        goals = np.take_along_axis(view.poses[worlds, :, :2], rows[..., None], axis=1)
        self._progress.restart(worlds, view.poses, goals)

    def observe(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        goals = find_in_robot(view.poses, self._progress.goals)
        near = find_neighbours(view)
        return np.concatenate([goals, view.velocities, near], axis=-1)

    def judge(self, view: FleetView) -> Judgement:
        """See `RobotTask`."""
        nearer, is_there = self._progress.advance(view.poses)
        rewards = nearer + STEP + SUCCESS * is_there + COLLISION * view.is_touching
        return Judgement(rewards, is_there & ~view.is_touching, view.is_touching)
