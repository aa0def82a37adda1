"""ReachGoal: each robot drives to a point of its own."""

import numpy as np

from zensim.envs.robot_task import (
    FAR_M,
    FAST,
    FleetView,
    GoalProgress,
    Judgement,
    RobotTask,
    find_in_robot,
)
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.se3 import FloatArray

SUCCESS, COLLISION, STEP = 1.0, -1.0, -0.01
"""Rewards."""


class ReachGoal(RobotTask):
    """Reach a point that is drawn about the place where the robot starts.

    Observation: the goal in the robot's frame x, y [m], forward velocity [m/s], turn [rad/s].
    Reward: metres that the robot came nearer to its goal, -0.01 a step, 1 at the goal, and -1 at
    a collision. Both end the episode of the robot.
    """

    def __init__(
        self, *, distance_m: tuple[float, float] = (1.0, 3.0), tolerance_m: float = 0.2
    ) -> None:
        """Set the task.

        Args:
            distance_m: Least and greatest distance of goals from the start.
            tolerance_m: Distance at which a goal is reached.
        """
        self._distance_m = distance_m
        self._progress = GoalProgress(tolerance_m)

    def list_bounds(self, robots: int) -> FloatArray:  # noqa: ARG002 - the same for any
        """See `RobotTask`."""
        return np.array([FAR_M, FAR_M, FAST, FAST])

    def restart(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> None:
        """See `RobotTask`."""
        robots = view.poses.shape[1]
        drawn = streams.draw(worlds, 2 * robots).reshape(-1, robots, 2)
        least, most = self._distance_m
        distances = least + (most - least) * drawn[..., 0]
        angles = 2.0 * np.pi * drawn[..., 1]
        away = distances[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        self._progress.restart(worlds, view.poses, view.poses[worlds, :, :2] + away)

    def observe(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        goals = find_in_robot(view.poses, self._progress.goals)
        return np.concatenate([goals, view.velocities], axis=-1)

    def judge(self, view: FleetView) -> Judgement:
        """See `RobotTask`."""
        nearer, is_there = self._progress.advance(view.poses)
        is_failure = view.is_touching & ~is_there
        rewards = nearer + STEP + SUCCESS * is_there + COLLISION * is_failure
        return Judgement(rewards, is_there, is_failure)
