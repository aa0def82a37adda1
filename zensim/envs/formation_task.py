"""FollowFormation: robots keep their places about a leader that drives along a curve."""

import numpy as np

from zensim.envs.robot_task import (
    FAR_M,
    FAST,
    FleetView,
    Judgement,
    RobotTask,
    find_distances,
    find_in_robot,
)
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.se3 import FloatArray

COLLISION = -1.0
"""Reward."""
LOST_M = 2.0
ERROR_SCALE_M = 0.5
TURN_RAD_S, PERIOD_S = (0.1, 0.3), (8.0, 16.0)
"""Limits of the amplitude and the period of the leader's turn, which are drawn."""


class FollowFormation(RobotTask):
    """Keep the place beside the leader that the robot had at the start.

    The first robot leads: it drives ahead and turns to and fro, as drawn for each episode. The
    others learn.
    Observation: the wanted place in the robot's frame x, y [m], cosine and sine of the leader's
    heading from the robot's, and forward velocity [m/s] and turn [rad/s] of the leader and of
    the robot.
    Reward: 1 at the wanted place, less linearly to 0 at 0.5 m, and -1 at a collision.
    A collision, or an error of more than 2 m, ends the episode of the robot.
    """

    least_robots = 2

    def __init__(self, *, speed_m_s: float = 0.25) -> None:
        """Set the forward velocity of the leader."""
        self._speed_m_s = speed_m_s
        self._offsets: FloatArray = np.zeros((0, 0, 2))
        self._turns: FloatArray = np.zeros((0, 3))

    def choose_agents(self, robots: int) -> IntArray:
        """See `RobotTask`."""
        return np.arange(1, robots)

    def list_bounds(self, robots: int) -> FloatArray:  # noqa: ARG002 - the same for any
        """See `RobotTask`."""
        return np.array([FAR_M, FAR_M, 1.0, 1.0, FAST, FAST, FAST, FAST])

    def restart(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> None:
        """See `RobotTask`."""
        if self._offsets.shape[:2] != (len(view.poses), view.poses.shape[1] - 1):
            self._offsets = np.zeros((len(view.poses), view.poses.shape[1] - 1, 2))
            self._turns = np.zeros((len(view.poses), 3))
        leaders, others = view.poses[worlds, :1], view.poses[worlds, 1:, :2]
        self._offsets[worlds] = find_in_robot(leaders, others)
        drawn = streams.draw(worlds, 3)
        low = np.array([TURN_RAD_S[0], PERIOD_S[0], 0.0])
        high = np.array([TURN_RAD_S[1], PERIOD_S[1], 2.0 * np.pi])
        self._turns[worlds] = low + (high - low) * drawn

    def drive(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        found = np.zeros_like(view.velocities)
        amplitudes, periods, phases = self._turns.T
        found[:, 0, 0] = self._speed_m_s
        found[:, 0, 1] = amplitudes * np.sin(2.0 * np.pi * view.times / periods + phases)
        return found

    def observe(self, view: FleetView) -> FloatArray:
        """See `RobotTask`."""
        own = view.poses[:, 1:]
        turned = view.poses[:, :1, 2] - own[..., 2]
        leader = np.broadcast_to(view.velocities[:, :1], view.velocities[:, 1:].shape)
        return np.concatenate(
            [
                find_in_robot(own, self._find_places(view)),
                np.cos(turned)[..., None],
                np.sin(turned)[..., None],
                leader,
                view.velocities[:, 1:],
            ],
            axis=-1,
        )

    def judge(self, view: FleetView) -> Judgement:
        """See `RobotTask`."""
        errors = find_distances(view.poses[:, 1:], self._find_places(view))
        touching = view.is_touching[:, 1:]
        rewards = np.maximum(1.0 - errors / ERROR_SCALE_M, 0.0) + COLLISION * touching
        return Judgement(rewards, np.zeros_like(touching), touching | (errors > LOST_M))

    def _find_places(self, view: FleetView) -> FloatArray:
        leaders = view.poses[:, :1]
        cos, sin = np.cos(leaders[..., 2]), np.sin(leaders[..., 2])
        x, y = np.moveaxis(self._offsets, -1, 0)
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        return np.asarray(leaders[..., :2] + turned)
