"""RobotDriver: publishes the velocity commands of the page's visitors, on a thread of its own."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Final

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.network_protocols import Publisher, TopicNetwork
from zensim.proto.path_following import PathController
from zensim.proto.topic_catalog import CMD_VEL
from zensim.spawner.page.drive_control import DriveControl, Velocity

LOG = logging.getLogger(__name__)
MAX_WAIT_S: Final = 1.0


class RobotDriver:
    """Drives robots for visitors; all methods may be called by any thread.

    A thread of its own, as the one that draws waits for replies of services.
    """

    def __init__(self, network: TopicNetwork, clock: Callable[[], float] = time.monotonic) -> None:
        """Start the thread; `close` ends it."""
        self._network, self._clock = network, clock
        self._control = DriveControl()
        self._changed = threading.Condition()
        self._publishers: dict[str, Publisher] = {}
        self._failing: set[str] = set()
        """Robots whose last command could not be published."""
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="robot driver", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop all robots that are driven, and end the thread."""
        with self._changed:
            self._control.stop_all(self._control.robots, self._clock())
            self._is_closed = True
            self._changed.notify()
        self._thread.join()
        for publisher in self._publishers.values():
            publisher.close()

    def drive(self, visitor: int, robot: str, velocity: Velocity) -> None:
        """Drive a robot for a moment; see `DriveControl.drive`.

        Raises:
            RobotBusy: Another visitor drives it.
        """
        with self._changed:
            self._control.drive(visitor, robot, velocity, self._clock())
            self._changed.notify()

    def follow(self, visitor: int, robot: str, path: PathController) -> None:
        """Drive a robot along a path until its end, or until the visitor leaves.

        Raises:
            RobotBusy: Another visitor drives it.
        """
        with self._changed:
            self._control.follow(visitor, robot, path, self._clock())
            self._changed.notify()

    def take_over(self, visitor: int, robot: str) -> int | None:
        """Give a robot to a visitor, and stop it; return who drove it before, if another did."""
        with self._changed:
            before = self._control.take_over(visitor, robot, self._clock())
            self._changed.notify()
        return before

    def release(self, visitor: int) -> None:
        """Stop the robots that a visitor drives by hand."""
        with self._changed:
            self._control.release(visitor, self._clock())
            self._changed.notify()

    def leave(self, visitor: int) -> None:
        """Stop all robots of a visitor, which is gone."""
        with self._changed:
            self._control.leave(visitor, self._clock())
            self._changed.notify()

    def stop_all(self, robots: Iterable[str]) -> None:
        """Stop robots, also those of other visitors."""
        with self._changed:
            self._control.stop_all(robots, self._clock())
            self._changed.notify()

    def observe(self, poses: Mapping[str, tuple[float, float, float]]) -> None:
        """Take new poses of robots that follow a path: x, y [m], heading [rad]."""
        with self._changed:
            now_s = self._clock()
            for robot, pose in poses.items():
                self._control.observe(robot, pose, now_s)
            self._changed.notify()

    def list_paths(self, visitor: int) -> frozenset[str]:
        """List the robots of a visitor that follow a path."""
        with self._changed:
            return self._control.list_paths(visitor)

    def find_driver(self, robot: str) -> int | None:
        """Find the visitor that drives a robot."""
        with self._changed:
            return self._control.find_driver(robot)

    def _run(self) -> None:
        is_over = False
        while not is_over:
            with self._changed:
                wait_s = self._control.find_next_s() - self._clock()
                is_over = self._is_closed and wait_s > MAX_WAIT_S
                if wait_s > 0.0 and not is_over:
                    self._changed.wait(min(MAX_WAIT_S, wait_s))
                due = self._control.take_due(self._clock())
                robots = self._control.robots
            for robot, velocity in due:
                self._attempt(robot, partial(self._publish, robot, velocity))
            for gone in self._publishers.keys() - robots:
                self._attempt(gone, self._publishers.pop(gone).close)

    def _attempt(self, robot: str, act: Callable[[], None]) -> None:
        """Call a function of the network; a failure is logged once until the next success."""
        try:
            act()
        except Exception as error:  # noqa: BLE001  without this thread no robot is stopped
            if robot not in self._failing:
                LOG.warning("cannot publish the commands of %s: %s", robot, error)
            self._failing.add(robot)
        else:
            self._failing.discard(robot)

    def _publish(self, robot: str, velocity: Velocity) -> None:
        if robot not in self._publishers:
            self._publishers[robot] = self._network.advertise(CMD_VEL.key(robot), CMD_VEL.encoding)
        twist = Twist(Vector3(velocity.forward, velocity.left), Vector3(z=velocity.turn))
        self._publishers[robot].send(encode(twist, Format.CDR))
