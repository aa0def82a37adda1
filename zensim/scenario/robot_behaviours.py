"""Behaviours: commanded twists of robots from their poses, on arrays; no clock, no network."""

import importlib
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

import numpy as np
import numpy.typing as npt

from zensim.proto.path_following import SLOW_DOWN_S, steer
from zensim.proto.se3 import FloatArray
from zensim.scenario.quantities import make_uniforms
from zensim.scenario.ray_navigation import (
    PERIOD_S,
    CastRays,
    find_bearings,
    find_ranges,
    steer_around,
)
from zensim.scenario.scenario_format import (
    Behaviour,
    CarryOutOrders,
    CircleAround,
    DriveAhead,
    FollowRobot,
    FollowWaypoints,
    Navigate,
    Patrol,
    PythonBehaviour,
    RandomWalk,
    ReplayCommands,
)

if TYPE_CHECKING:
    from zensim.scenario.fleet_orders import FleetOrders
    from zensim.scenario.scenario_reader import Scenario

BehaviourT = TypeVar("BehaviourT")


@dataclass(frozen=True)
class FleetState:
    """What a behaviour sees at a control step; a row for each robot of the scenario.

    Attributes:
        now: Simulated seconds since all robots are driven.
        period: Of control steps [s].
        poses: x, y [m] and heading [rad] in the world, (n, 3).
        twists: Linear and angular velocity in the robot's frame, (n, 6).
    """

    now: float
    period: float
    poses: FloatArray
    twists: FloatArray


class Motion(ABC):
    """Commands of the robots of one behaviour."""

    @abstractmethod
    def command(self, state: FleetState) -> FloatArray:
        """Command speed [m/s] and turn [rad/s] of each robot of the behaviour, (m, 2)."""


class ConstantMotion(Motion):
    """A twist that stays: stand, drive, circle."""

    def __init__(self, twists: FloatArray) -> None:
        self._twists = twists

    def command(self, _state: FleetState) -> FloatArray:
        """Repeat the twists."""
        return self._twists


class PathMotion(Motion):
    """Motion along points in straight lines: waypoints, patrol."""

    def __init__(
        self,
        rows: npt.NDArray[np.intp],
        paths: FloatArray,
        behaviours: Sequence[FollowWaypoints | Patrol],
    ) -> None:
        """Begin at the first points.

        Args:
            rows: Of the robots in the state, (m,).
            paths: Points, (m, k, 2).
            behaviours: Of each robot, (m,).
        """
        self._rows, self._paths = rows, paths
        self._speed = np.array([one.speed for one in behaviours])
        self._tolerance = np.array([one.tolerance for one in behaviours])
        self._is_patrol = isinstance(behaviours[0], Patrol)
        first = behaviours[0]
        self._loops = not self._is_patrol and cast("FollowWaypoints", first).loop
        self._pause = np.array([getattr(one, "pause", 0.0) for one in behaviours])
        self._next = np.zeros(len(rows), dtype=np.intp)
        self._step = np.ones(len(rows), dtype=np.intp)
        self._wait_until = np.full(len(rows), -math.inf)
        self._is_over = np.zeros(len(rows), dtype=bool)

    def command(self, state: FleetState) -> FloatArray:
        """Drive to the next point; robots turn on the spot where it is behind them."""
        poses = state.poses[self._rows]
        self._choose_points(state.now, poses)
        offset = self._offsets(poses)
        distance = np.hypot(offset[:, 0], offset[:, 1])
        is_last = self._stops_at_next()
        most = np.where(is_last, np.minimum(self._speed, distance / SLOW_DOWN_S), self._speed)
        found = steer(poses[:, 2], offset, most)
        found[self._is_over | (state.now < self._wait_until)] = 0.0
        return found

    def _offsets(self, poses: FloatArray) -> FloatArray:
        target = self._paths[np.arange(len(self._rows)), self._next]
        return np.asarray(target - poses[:, :2])

    def _stops_at_next(self) -> npt.NDArray[np.bool_]:
        last = self._paths.shape[1] - 1
        if self._is_patrol:
            at_end = np.where(self._step > 0, self._next == last, self._next == 0)
            return np.asarray(at_end & (self._pause > 0.0))
        return np.asarray((self._next == last) & (not self._loops))

    def _choose_points(self, now: float, poses: FloatArray) -> None:
        offset = self._offsets(poses)
        is_there = np.hypot(offset[:, 0], offset[:, 1]) < self._tolerance
        is_there &= ~self._is_over
        last = self._paths.shape[1] - 1
        if self._is_patrol:
            self._turn_back(now, is_there, last)
            return
        ends = is_there & (self._next == last)
        if not self._loops:
            self._is_over |= ends
        self._next = np.where(is_there & ~ends, self._next + 1, self._next)
        if self._loops:
            self._next = np.where(ends, 0, self._next)

    def _turn_back(self, now: float, is_there: npt.NDArray[np.bool_], last: int) -> None:
        ends = is_there & np.where(self._step > 0, self._next == last, self._next == 0)
        self._wait_until = np.where(ends, now + self._pause, self._wait_until)
        self._step = np.where(ends, -self._step, self._step)
        self._next = np.clip(np.where(is_there, self._next + self._step, self._next), 0, last)


class RandomWalkMotion(Motion):
    """Ahead, with a turn that is drawn again and again."""

    def __init__(self, behaviours: Sequence[RandomWalk], seed: int, names: Sequence[str]) -> None:
        self._seed, self._names = seed, names
        self._path = f"behaviours.{behaviours[0].name}"
        self._turn = np.array([one.turn for one in behaviours])
        self._every = np.array([one.turn_every for one in behaviours])
        self._start = behaviours[0].at
        self._round = np.full(len(names), -1, dtype=np.int64)
        self._twists = np.zeros((len(names), 2))
        self._twists[:, 0] = [one.speed for one in behaviours]

    def command(self, state: FleetState) -> FloatArray:
        """Draw the turns that are due; each has its own key."""
        number = np.floor((state.now - self._start) / self._every + 1e-9).astype(np.int64)
        for row in np.flatnonzero(number != self._round):
            drawn = make_uniforms(self._seed, self._path, self._names[int(row)], str(number[row]))[
                0
            ]
            self._twists[row, 1] = self._turn[row] * (2.0 * drawn - 1.0)
        self._round = number
        return self._twists


class FollowMotion(Motion):
    """Motion behind other robots."""

    def __init__(
        self,
        rows: npt.NDArray[np.intp],
        targets: npt.NDArray[np.intp],
        behaviours: Sequence[FollowRobot],
    ) -> None:
        self._rows, self._targets = rows, targets
        self._distance = np.array([one.distance for one in behaviours])
        self._speed = np.array([one.speed for one in behaviours])

    def command(self, state: FleetState) -> FloatArray:
        """Drive towards the target, the slower the nearer, and stop at the distance."""
        poses = state.poses[self._rows]
        offset = state.poses[self._targets, :2] - poses[:, :2]
        gap = np.hypot(offset[:, 0], offset[:, 1]) - self._distance
        return steer(poses[:, 2], offset, np.clip(gap / SLOW_DOWN_S, 0.0, self._speed))


class NavigateMotion(Motion):
    """Motion between points, around what rays hit."""

    def __init__(
        self,
        rows: npt.NDArray[np.intp],
        paths: FloatArray,
        behaviours: Sequence[Navigate],
        cast_rays: CastRays,
    ) -> None:
        """Begin at the first points (m, k, 2)."""
        self._rows, self._paths, self._cast = rows, paths, cast_rays
        self._speed = np.array([one.speed for one in behaviours])
        self._tolerance = np.array([one.tolerance for one in behaviours])
        self._next = np.zeros(len(rows), dtype=np.intp)
        self._due = -math.inf
        self._commands = np.zeros((len(rows), 2))

    def command(self, state: FleetState) -> FloatArray:
        """Measure and steer when a scan is due; repeat the commands between."""
        if state.now < self._due - 1e-9:
            return self._commands
        self._due = state.now + PERIOD_S
        poses = state.poses[self._rows]
        points = self._paths[np.arange(len(self._rows)), self._next]
        is_there = np.hypot(*(points - poses[:, :2]).T) < self._tolerance
        self._next = np.where(is_there, (self._next + 1) % self._paths.shape[1], self._next)
        points = self._paths[np.arange(len(self._rows)), self._next]
        ranges = find_ranges(self._cast, poses)
        self._commands = steer_around(ranges, find_bearings(poses, points), self._speed)
        return self._commands


class ReplayMotion(Motion):
    """Recorded commands, each from its time on."""

    def __init__(self, recorded: Sequence[FloatArray], behaviour: ReplayCommands) -> None:
        """Take time since the start, speed and turn (k, 3) of each robot."""
        self._recorded, self._start = recorded, behaviour.at
        self._loops = behaviour.loop

    def command(self, state: FleetState) -> FloatArray:
        """Find the newest command of each robot; zero before the first."""
        return np.array([self._find(one, state.now - self._start) for one in self._recorded])

    def _find(self, rows: FloatArray, now: float) -> FloatArray:
        if not len(rows):
            return np.zeros(2)
        length = rows[-1, 0]
        if self._loops and length > 0.0:
            now %= length
        number = int(np.searchsorted(rows[:, 0], now + 1e-9, side="right")) - 1
        return np.asarray(rows[number, 1:]) if number >= 0 else np.zeros(2)


class OrderMotion(Motion):
    """Motion of vehicles that carry out orders of a fleet manager."""

    def __init__(self, orders: "FleetOrders") -> None:
        self._orders = orders

    def command(self, state: FleetState) -> FloatArray:
        """Follow the routes of the orders.

        Raises:
            ValueError: A vehicle rejects an order, or cannot carry it out.
        """
        return self._orders.command(state.now, state.poses, state.twists)


class PythonController(Protocol):
    """A class that a file names in `call`."""

    def step(self, now: float, state: FleetState) -> npt.ArrayLike:
        """Command speed [m/s] and turn [rad/s] of each robot, (m, 2)."""


class PythonMotion(Motion):
    """Commands of a class of the file's author."""

    def __init__(self, controller: PythonController, count: int, rate: float | None) -> None:
        self._controller = controller
        self._twists = np.zeros((count, 2))
        self._period = 0.0 if rate is None else 1.0 / rate
        self._due = -math.inf

    def command(self, state: FleetState) -> FloatArray:
        """Call the class when it is due, and repeat its commands between.

        Raises:
            ValueError: It returns no array (m, 2) of finite numbers.
        """
        if state.now < self._due - 1e-9:
            return self._twists
        self._due = state.now + self._period if self._period else state.now
        found = np.asarray(self._controller.step(state.now, state), dtype=np.float64)
        if found.shape != self._twists.shape or not np.isfinite(found).all():
            raise ValueError(
                f"step() returned an array {found.shape}; "
                f"finite numbers {self._twists.shape} are needed: speed, turn"
            )
        self._twists = found
        return found


@dataclass(frozen=True)
class ScheduledMotion:
    """A behaviour with its robots and its time.

    Attributes:
        rows: Of its robots among those of the scenario, (m,).
        holds: Whether it goes on when others command its robots.
    """

    name: str
    rows: npt.NDArray[np.intp]
    start: float
    end: float
    motion: Motion
    holds: bool = False

    def is_active(self, now: float) -> bool:
        """Whether it acts at a control step."""
        return self.start - 1e-9 <= now < self.end - 1e-9


def make_motions(
    scenario: "Scenario",
    make_controller: Callable[[PythonBehaviour, Sequence[str]], PythonController],
    cast_rays: CastRays,
) -> list[ScheduledMotion]:
    """Make the motions of all behaviours; later ones win for the robots that they share."""
    made = []
    row = {name: number for number, name in enumerate(scenario.robot_names)}
    for index, common in enumerate(scenario.format.behaviours):
        names = scenario.select(common.robots)
        own = [scenario.resolve_behaviour(index, name) for name in names]
        rows = np.array([row[name] for name in names], dtype=np.intp)
        end = math.inf if common.duration is None else common.at + common.duration
        if isinstance(common, Navigate):
            navigating = cast_all(Navigate, own)
            paths = np.array([one.points for one in navigating])
            motion: Motion = NavigateMotion(rows, paths, navigating, cast_rays)
        elif isinstance(common, ReplayCommands):
            # Most behaviours read no recording.
            from zensim.scenario.recorded_commands import read_commands  # noqa: PLC0415

            file = scenario.find_file(f"behaviours[{index}].file", common.file)
            recorded = read_commands(file, scenario.robot_names)
            motion = ReplayMotion([recorded.find(name) for name in names], common)
        elif isinstance(common, CarryOutOrders):
            from zensim.scenario.fleet_orders import FleetOrders, read_orders  # noqa: PLC0415

            file = scenario.find_file(f"behaviours[{index}].file", common.file)
            orders = read_orders(file, names)
            motion = OrderMotion(FleetOrders(rows, orders, cast_all(CarryOutOrders, own)))
        else:
            motion = _make_motion(own, names, rows, scenario, make_controller)
        made.append(ScheduledMotion(common.name, rows, common.at, end, motion, common.hold))
    return made


def cast_all(kind: type[BehaviourT], own: Sequence[Behaviour]) -> list[BehaviourT]:
    """List the behaviours of a kind."""
    return [one for one in own if isinstance(one, kind)]


def _make_motion(
    own: Sequence[Behaviour],
    names: Sequence[str],
    rows: npt.NDArray[np.intp],
    scenario: "Scenario",
    make_controller: Callable[[PythonBehaviour, Sequence[str]], PythonController],
) -> Motion:
    first = own[0]
    if isinstance(first, FollowWaypoints | Patrol):
        paths = np.array([cast("Patrol", one).points for one in own])
        return PathMotion(rows, paths, cast("Sequence[Patrol]", own))
    if isinstance(first, RandomWalk):
        return RandomWalkMotion(cast("Sequence[RandomWalk]", own), scenario.seed, names)
    if isinstance(first, FollowRobot):
        every = scenario.robot_names
        targets = [every.index(cast("FollowRobot", one).target) for one in own]
        return FollowMotion(
            rows, np.array(targets, dtype=np.intp), cast("Sequence[FollowRobot]", own)
        )
    if isinstance(first, PythonBehaviour):
        return PythonMotion(make_controller(first, names), len(names), first.rate)
    return ConstantMotion(np.array([_find_constant(one) for one in own]))


def _find_constant(behaviour: Behaviour) -> tuple[float, float]:
    if isinstance(behaviour, DriveAhead):
        return behaviour.v, behaviour.w
    if isinstance(behaviour, CircleAround):
        return behaviour.speed, behaviour.speed / behaviour.radius
    return 0.0, 0.0


def load_class(call: str, folder: Path) -> Callable[..., object]:
    """Import the class that `module:Class` names; modules beside the file are found, too.

    Raises:
        ValueError: There is no such module or class.
    """
    module_name, _, class_name = call.partition(":")
    with _search_folder(folder):
        try:
            module = importlib.import_module(module_name)
        except ImportError as error:
            raise ValueError(f"`{call}`: {error}") from error
    if class_name not in vars(module):
        raise ValueError(f"`{call}`: module {module_name} has no class {class_name}")
    return cast("Callable[..., object]", vars(module)[class_name])


@contextmanager
def _search_folder(folder: Path) -> Iterator[None]:
    word = str(folder.resolve())
    sys.path.insert(0, word)
    try:
        yield
    finally:
        sys.path.remove(word)
