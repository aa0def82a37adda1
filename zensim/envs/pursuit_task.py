"""CatchEvader: robots catch one that flees."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from zensim.envs.robot_task import (
    FAR_M,
    FAST,
    NEIGHBOURS,
    FleetView,
    Judgement,
    RobotTask,
    find_distances,
    find_in_robot,
    find_neighbours,
    turn_into_robot,
)
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.se3 import FloatArray

CATCH, COLLISION, STEP = 1.0, -1.0, -0.01
"""Rewards."""
MIN_SQUARE_M2 = 1e-6
TURN_GAIN = 3.0
"""Turn [rad/s] by an error of the heading of a radian."""


class CatchEvader(RobotTask):
    """Come near the last robot, which flees from the others more slowly than they can drive.

    The evader drives away from its pursuers, from near ones more than from far ones. The others
    learn.
    Observation: the evader in the robot's frame x, y [m], its forward velocity [m/s], cosine and
    sine of its heading from the robot's, forward velocity [m/s] and turn [rad/s] of the robot, and
    the three nearest robots as in `AvoidEachOther`.
    Reward: metres that the robot came nearer to the evader, -0.01 a step, 1 for all when one has
    caught it, and -1 at a collision, which ends the episode of the robot.
    """

    least_robots = 2
    settings: Mapping[str, object] = MappingProxyType({"count": 4, "spacing": 1.5})

    def __init__(self, *, speed_m_s: float = 0.3, distance_m: float = 0.4) -> None:
        """Set the task.

        Args:
            speed_m_s: Of the evader.
            distance_m: At which it is caught, from root link to root link.
        """
        self._speed_m_s, self._distance_m = speed_m_s, distance_m
        self._distances: FloatArray = np.zeros((0, 0))

    def choose_agents(self, robots: int) -> IntArray:
        """See `RobotTask`."""
        return np.arange(robots - 1)

    def list_bounds(self, robots: int) -> FloatArray:  # noqa: ARG002 - the same for any
        """See `RobotTask`."""
        own = [FAR_M, FAR_M, FAST, 1.0, 1.0, FAST, FAST]
        return np.array(own + [FAR_M, FAR_M, FAST, FAST] * NEIGHBOURS)

    def restart(
        self,
        worlds: IntArray,
        view: FleetView,
        streams: WorldStreams,  # noqa: ARG002 - nothing is drawn
    ) -> None:
        """See `RobotTask`."""
        found = self._find_distances(view)
        if self._distances.shape != found.shape:
            self._distances = found
        self._distances[worlds] = found[worlds]

    def drive(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        away = view.poses[:, -1:, :2] - view.poses[:, :-1, :2]
        square = np.maximum((away * away).sum(axis=-1, keepdims=True), MIN_SQUARE_M2)
        ahead, left = turn_into_robot(view.poses[:, -1, 2], (away / square).sum(axis=1)).T
        found = np.zeros_like(view.velocities)
        found[:, -1, 0] = self._speed_m_s
        found[:, -1, 1] = TURN_GAIN * np.arctan2(left, ahead)
        return found

    def observe(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        own, evader = view.poses[:, :-1], view.poses[:, -1:]
        turned = evader[..., 2] - own[..., 2]
        speed = np.broadcast_to(view.velocities[:, -1:, :1], (*turned.shape, 1))
        heading = np.stack([np.cos(turned), np.sin(turned)], axis=-1)
        seen = find_in_robot(own, evader[..., :2])
        near = find_neighbours(view)[:, :-1]
        return np.concatenate([seen, speed, heading, view.velocities[:, :-1], near], axis=-1)

    def judge(self, view: FleetView) -> Judgement:
        """See `RobotTask`."""
        before, self._distances = self._distances, self._find_distances(view)
        is_caught = (self._distances <= self._distance_m).any(axis=1, keepdims=True)
        is_touching = view.is_touching[:, :-1] & ~is_caught
        rewards = before - self._distances + STEP + CATCH * is_caught + COLLISION * is_touching
        return Judgement(rewards, np.broadcast_to(is_caught, is_touching.shape), is_touching)

    def _find_distances(self, view: FleetView) -> FloatArray:
        return find_distances(view.poses[:, :-1], view.poses[:, -1:, :2])
