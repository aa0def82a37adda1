"""Drives the robots of `zensim up` where poses decide, each until something else commands it."""

import math
from collections.abc import Sequence

import numpy as np

from zensim.api.local_deployment import OPERATOR, LocalDeployment
from zensim.api.server_access import ServerAccess
from zensim.api.sim import Sim
from zensim.deploy.demo_patterns import RADIUS, SPEED, PoseBehaviour
from zensim.deploy.other_commands import OtherCommands
from zensim.deploy.up_driver import UpDriver
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.scenario.robot_behaviours import FleetState, Motion, PathMotion, RandomWalkMotion
from zensim.scenario.scenario_format import FollowWaypoints, RandomWalk
from zensim.spawner.spawn.spawn_poses import RobotPlacement


class FleetDemo(UpDriver):
    """Commands the robots in a world that runs by itself; `update` has to be called often.

    A robot that gets a `cmd_vel`, or an order of another client, is left to that for good.
    """

    def __init__(
        self,
        bus: Bus,
        endpoint: str,
        world: str,
        placements: Sequence[RobotPlacement],
        behaviour: PoseBehaviour,
    ) -> None:
        self._names = [one.name for one in placements]
        self._motion = make_demo_motion(placements, behaviour)
        # A session of its own, which ends with the demo; so do its orders.
        self._access = ServerAccess(open_bus(BusConfig(connect=(endpoint,))), world)
        self._others = OtherCommands(bus, world, self._access.client)
        self._sim = Sim(self._access)
        self._fleet = self._sim.fleet(self._names)
        self._is_ours = np.ones(len(self._names), dtype=bool)
        self._sent: np.ndarray | None = None
        self._epoch = self._sim.epoch

    @property
    def is_over(self) -> bool:
        """Whether no robot is left to command."""
        return not self._is_ours.any()

    def update(self) -> None:
        """Leave robots that others command, and command the rest."""
        self._leave_commanded()
        if self._sim.epoch != self._epoch:
            # A reset deletes what was spawned.
            self._is_ours[:] = False
        if self.is_over or self._sim.is_paused:
            return
        now = self._sim.time
        state = FleetState(now, 0.0, self._fleet.poses2d(), self._fleet.twists())
        twists = self._motion.command(state)
        self._is_ours &= self._fleet.alive
        if self._sent is None or not np.array_equal(twists, self._sent):
            self._sent = twists.copy()
            fleet = self._fleet[self._is_ours]
            fleet.drive(v=twists[self._is_ours, 0], w=twists[self._is_ours, 1])

    def close(self) -> None:
        """End; the robots stop."""
        self._others.close()
        self._sim.close()

    def _leave_commanded(self) -> None:
        names = self._others.take()
        taken = np.array([name in names for name in self._names]) & self._is_ours
        if taken.any():
            self._is_ours &= ~taken
            self._fleet[taken].release()


def make_demo(deployment: LocalDeployment, behaviour: PoseBehaviour) -> FleetDemo:
    """Make the demo of the robots of a deployment."""
    config = deployment.config
    return FleetDemo(
        deployment.bus,
        config.address_of(OPERATOR),
        config.network.world_name,
        config.placements,
        behaviour,
    )


def make_demo_motion(placements: Sequence[RobotPlacement], behaviour: PoseBehaviour) -> Motion:
    """Make the motion of a pattern: all robots alike, each from where it stands."""
    count = len(placements)
    if behaviour == "waypoints":
        paths = np.array([_make_square(one) for one in placements])
        square = FollowWaypoints(
            name="demo", robots="*", points=((0.0, 0.0),), speed=SPEED, tolerance=0.1, loop=True
        )
        return PathMotion(np.arange(count), paths, [square] * count)
    walk = RandomWalk(name="demo", robots="*", speed=SPEED)
    return RandomWalkMotion([walk] * count, 0, [one.name for one in placements])


def _make_square(start: RobotPlacement) -> list[tuple[float, float]]:
    """Make the corners of a square to the left of a robot, beginning ahead of it."""
    side, cos, sin = 2.0 * RADIUS, math.cos(start.yaw), math.sin(start.yaw)
    corners = ((side, 0.0), (side, side), (0.0, side), (0.0, 0.0))
    return [(start.x + x * cos - y * sin, start.y + x * sin + y * cos) for x, y in corners]
