"""Expectations: assertions of tests that step the simulation until they hold."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from zensim.api.api_errors import Invalid, Timeout, Unsupported
from zensim.api.argument_checks import check_range, make_numbers
from zensim.api.robot import EntityHandle
from zensim.api.simulation import Simulation

if TYPE_CHECKING:
    from zensim.api.topic import Topic

REST_SPEED, REST_TURN = 0.01, 0.02
"""Speeds [m/s] and [rad/s] below which a robot stands."""


class RobotExpectation:
    """What a test expects of one robot."""

    def __init__(self, sim: Simulation, robot: EntityHandle) -> None:
        self._sim = sim
        self._robot = robot

    def to_reach(
        self, point: tuple[float, float], *, within: float = 10.0, tolerance: float = 0.1
    ) -> None:
        """Step until the robot is at a point.

        Args:
            point: x and y in the world [m].
            within: Simulation time [s].
            tolerance: Distance [m].

        Raises:
            AssertionError: It was not there in time.
        """
        __tracebackhide__ = True
        place = make_numbers("point", point, "(2,): x, y")
        if place.shape != (2,) or not np.isfinite(place).all():
            raise Invalid(f"point={str(point)[:40]} is no place", hint="give x, y")
        x, y = place.tolist()
        check_range("tolerance", tolerance, 0.0, math.inf)
        self._wait(
            lambda: self._robot.pose.distance_to(x, y) <= tolerance,
            within,
            f"to be within {tolerance:g} m of {point}",
            lambda: (
                f"distance {self._robot.pose.distance_to(x, y):.3f} m, margin "
                f"{tolerance - self._robot.pose.distance_to(x, y):.3f} m"
            ),
        )

    def to_stop(self, *, within: float = 5.0, speed: float = REST_SPEED) -> None:
        """Step until the robot stands: below a speed [m/s], within simulation time [s].

        Raises:
            AssertionError: It still moves then.
        """
        __tracebackhide__ = True
        check_range("speed", speed, 0.0, math.inf)
        self._wait(
            lambda: self._robot.twist.speed <= speed and abs(self._robot.twist.w) <= REST_TURN,
            within,
            f"to be slower than {speed:g} m/s",
            lambda: (
                f"speed {self._robot.twist.speed:.4f} m/s, turn {self._robot.twist.w:.4f} "
                f"rad/s, margin {speed - self._robot.twist.speed:.4f} m/s"
            ),
        )

    def to_have_no_collision(self) -> None:
        """Check that the robot has touched nothing but what carries it since it was spawned.

        Raises:
            AssertionError: It has.
            Unsupported: The simulation is not a `World`, which alone has all contacts.
        """
        __tracebackhide__ = True
        from zensim.api.in_process_world import World  # noqa: PLC0415  needs the server extra

        if not isinstance(self._sim, World):
            raise Unsupported("collisions are watched in a World only", hint="use zensim_world")
        if (found := self._sim.find_collision(self._robot.name)) is not None:
            x, y, z = found.point
            raise AssertionError(
                f"expected {self._robot.name!r} to have no collision; at {found.time:.3f} s it "
                f"touched {found.other!r} at ({x:.3f}, {y:.3f}, {z:.3f})"
            )

    def _wait(
        self, is_met: Callable[[], bool], within: float, what: str, value: Callable[[], str]
    ) -> None:
        __tracebackhide__ = True
        began = self._sim.time
        try:
            self._sim.wait_until(is_met, within)
        except Timeout:
            pose = self._robot.pose
            raise AssertionError(
                f"expected {self._robot.name!r} {what} within {within:g} simulated s from "
                f"{began:.3f} s; at {self._sim.time:.3f} s: {value()}, at "
                f"({pose.x:.3f}, {pose.y:.3f}, yaw {pose.yaw:.3f})"
            ) from None


class TopicExpectation:
    """What a test expects of one topic."""

    def __init__(self, sim: Simulation, topic: "Topic[Any]") -> None:
        self._sim = sim
        self._topic = topic

    def to_have_rate(self, rate: float, *, within: float = 5.0, tolerance: float = 0.1) -> None:
        """Step until the rate of messages [Hz] in simulation time is right.

        Args:
            rate: Expected.
            within: Simulation time [s].
            tolerance: As a share of the rate.

        Raises:
            AssertionError: It is another one after that time.
        """
        __tracebackhide__ = True
        try:
            self._sim.wait_until(
                lambda: math.isclose(self._topic.rate, rate, rel_tol=tolerance), within
            )
        except Timeout:
            raise AssertionError(
                f"expected {rate:g} Hz on {self._topic.key} within {within:g} simulated s; "
                f"at {self._sim.time:.3f} s: {self._topic.rate:.3f} Hz"
            ) from None
