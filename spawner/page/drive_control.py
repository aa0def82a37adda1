"""Which visitor of the page drives which robot, and when it stops; no clock, no network."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.path_following import PathController
from zensim.spawner.teleop.drive_twists import find_drive_style, find_full_speeds, make_twist
from zensim.spawner.teleop.key_bindings import Direction

HOLD_S: Final = 0.2
"""An input counts for this time; a page repeats it each 50 ms while a key is held."""
REPEAT_S: Final = 0.05
"""Period of the commands of a robot that is driven."""
STOP_COMMANDS: Final = 3
"""Commands of zero after the last input, as one alone may be lost."""
KEEP_S: Final = 3.0
"""A visitor that has stopped keeps its robot for this time."""
PATH_HOLD_S: Final = 0.5
"""A command along a path counts for this time; without newer poses the robot stops."""
ALL_FULL: Final = Direction(1.0, 1.0, 1.0)


class Velocity(NamedTuple):
    """Forward and left [m/s], turn [rad/s], in the frame of the robot's base."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0


STOP: Final = Velocity()


class RobotBusy(Exception):
    """Another visitor drives the robot."""

    def __init__(self, robot: str, driver: int) -> None:
        """Name the robot."""
        super().__init__(f"another visitor drives {robot}; press Take over to drive it")
        self.driver = driver


@dataclass
class Hold:
    """State of a robot that a visitor drives, or drove until a moment ago."""

    visitor: int | None
    """None = free for the next one that drives."""
    velocity: Velocity = STOP
    until_s: float = 0.0
    """The velocity counts until then; after that it is zero."""
    next_s: float = 0.0
    """Time of the next command."""
    stops_left: int = 0
    """Commands of zero that are still sent."""
    path: PathController | None = None


class DriveControl:
    """Holds of robots by visitors; times are monotonic [s], robots are namespaces."""

    def __init__(self) -> None:
        self._holds: dict[str, Hold] = {}
        self._refused: set[tuple[int, str]] = set()
        """Visitors whose held input drives a robot only after its end, as it was not theirs."""

    def find_driver(self, robot: str) -> int | None:
        """Find the visitor that drives a robot."""
        hold = self._holds.get(robot)
        return hold.visitor if hold else None

    @property
    def robots(self) -> frozenset[str]:
        """Robots that are driven, or were until a moment ago."""
        return frozenset(self._holds)

    def list_paths(self, visitor: int) -> frozenset[str]:
        """List the robots of a visitor that follow a path."""
        return frozenset(
            robot for robot, hold in self._holds.items() if hold.path and hold.visitor == visitor
        )

    def drive(self, visitor: int, robot: str, velocity: Velocity, now_s: float) -> None:
        """Drive a robot for `HOLD_S`, or stop it; either ends its path.

        An input that began while another visitor had the robot, or took it, has no effect.

        Raises:
            RobotBusy: Another visitor drives it.
        """
        driver = self.find_driver(robot)
        if velocity == STOP:
            self._refused.discard((visitor, robot))
            if driver != visitor:
                return
        elif driver not in (visitor, None):
            self._refused.add((visitor, robot))
        elif (visitor, robot) in self._refused:
            return
        hold = self._take(visitor, robot)
        hold.path = None
        if velocity == STOP:
            _stop(hold, now_s)
        else:
            _renew(hold, velocity, now_s, HOLD_S)

    def follow(self, visitor: int, robot: str, path: PathController, now_s: float) -> None:
        """Let a robot follow a path; its poses come by `observe`.

        Raises:
            RobotBusy: Another visitor drives it.
        """
        hold = self._take(visitor, robot)
        _stop(hold, now_s)
        hold.path = path

    def observe(self, robot: str, pose: tuple[float, float, float], now_s: float) -> None:
        """Steer a robot on a path at a new pose: x, y [m], heading [rad]."""
        hold = self._holds.get(robot)
        if hold is None or hold.path is None:
            return
        found = hold.path.control(*pose)
        if found is None:
            hold.path = None
        velocity = Velocity(found[0], 0.0, found[1]) if found else STOP
        if velocity == STOP:
            _stop(hold, now_s)
        else:
            _renew(hold, velocity, now_s, PATH_HOLD_S)

    def take_over(self, visitor: int, robot: str, now_s: float) -> int | None:
        """Give a robot to a visitor, and stop it; return who drove it before, if another did."""
        hold = self._holds.get(robot)
        before = hold.visitor if hold else None
        if hold and before not in (visitor, None) and hold.velocity != STOP and not hold.path:
            self._refused.add((before, robot))
        hold = self._holds[robot] = Hold(visitor)
        _stop(hold, now_s)
        return None if before == visitor else before

    def release(self, visitor: int, now_s: float) -> None:
        """Stop the robots that a visitor drives by hand, as its page was hidden."""
        self._refused = {one for one in self._refused if one[0] != visitor}
        for hold in self._holds.values():
            if hold.visitor == visitor and hold.path is None:
                _stop(hold, now_s)

    def leave(self, visitor: int, now_s: float) -> None:
        """Stop all robots of a visitor whose page is closed or out of reach."""
        self.release(visitor, now_s)
        for hold in self._holds.values():
            if hold.visitor == visitor:
                hold.visitor, hold.path = None, None
                _stop(hold, now_s)

    def stop_all(self, robots: Iterable[str], now_s: float) -> None:
        """Stop robots, also those of other visitors."""
        for robot in robots:
            hold = self._holds.setdefault(robot, Hold(None))
            hold.path = None
            _stop(hold, now_s)

    def take_due(self, now_s: float) -> list[tuple[str, Velocity]]:
        """Take the commands that are due: robot and velocity."""
        for hold in self._holds.values():
            if now_s >= hold.until_s and hold.velocity != STOP:
                hold.path = None
                _stop(hold, hold.until_s)
        due = list(self._list_due(now_s))
        self._holds = {r: h for r, h in self._holds.items() if now_s < h.until_s + KEEP_S}
        return due

    def find_next_s(self) -> float:
        """Find the time of the next command; infinite if there is none."""
        times = (
            min(hold.next_s, hold.until_s) if hold.velocity != STOP else hold.next_s
            for hold in self._holds.values()
            if hold.velocity != STOP or hold.stops_left
        )
        return min(times, default=float("inf"))

    def _take(self, visitor: int, robot: str) -> Hold:
        hold = self._holds.setdefault(robot, Hold(visitor))
        if hold.visitor not in (visitor, None):
            raise RobotBusy(robot, hold.visitor)
        hold.visitor = visitor
        return hold

    def _list_due(self, now_s: float) -> Iterator[tuple[str, Velocity]]:
        for robot, hold in self._holds.items():
            if now_s < hold.next_s or (hold.velocity == STOP and not hold.stops_left):
                continue
            hold.stops_left = max(0, hold.stops_left - 1)
            hold.next_s = now_s + REPEAT_S
            yield robot, hold.velocity


def _renew(hold: Hold, velocity: Velocity, now_s: float, hold_s: float) -> None:
    if velocity != hold.velocity:
        hold.next_s = now_s
    hold.velocity, hold.until_s, hold.stops_left = velocity, now_s + hold_s, 0


def _stop(hold: Hold, now_s: float) -> None:
    if hold.velocity == STOP and hold.stops_left:
        return
    hold.velocity, hold.until_s = STOP, now_s
    hold.next_s, hold.stops_left = now_s, STOP_COMMANDS


def find_scale(drive: Drive | None) -> Velocity:
    """Find the velocities at full deflection: the limits of a drive, else usual ones."""
    if drive is None:
        return STOP
    full = make_twist(ALL_FULL, find_full_speeds(drive), find_drive_style(drive))
    return Velocity(full.linear.x, full.linear.y, full.angular.z)
