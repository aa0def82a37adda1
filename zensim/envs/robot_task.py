"""RobotTask: what robots are to do: goals, observations, rewards and ends, in arrays."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Invalid
from zensim.envs.world_streams import IntArray, WorldStreams
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.standard_messages import OccupancyGrid
from zensim.proto.se3 import FloatArray

BoolArray = npt.NDArray[np.bool_]
FAR_M = 20.0
"""Limit of distances in observations."""
FAST = 10.0
"""Limit of velocities in observations [m/s, rad/s]."""
ARRAY_KINDS = {"numbers": "fiub", "whole numbers": "iu", "bool": "b"}
"""Kinds of dtypes of NumPy."""
NEIGHBOURS = 3
NEIGHBOUR_NUMBERS = 4


@dataclass(frozen=True)
class FleetView:
    """Robots of all worlds at one moment.

    Attributes:
        poses: x, y [m] and heading [rad] in the world, (worlds, robots, 3).
        velocities: Forward [m/s] and turn [rad/s], (worlds, robots, 2).
        is_touching: Whether a robot touches something that does not carry it, (worlds, robots);
            at this moment: a contact that ends before is not seen.
        times: Seconds since each world was restarted, (worlds,).
    """

    poses: FloatArray
    velocities: FloatArray
    is_touching: BoolArray
    times: FloatArray


@dataclass(frozen=True)
class Judgement:
    """What a step was worth to each robot that learns, (worlds, agents).

    Attributes:
        rewards: Of the step.
        is_success: Whether it has done its task.
        is_failure: Whether it cannot do it any more.
    """

    rewards: FloatArray
    is_success: BoolArray
    is_failure: BoolArray


@dataclass(frozen=True)
class WorldStart:
    """A world with its robots, before it is copied.

    Attributes:
        places: Of the robots, x, y [m], (robots, 2).
        draw_map: Draws the map of what is fixed, with cells of this size [m].
    """

    places: FloatArray
    draw_map: Callable[[float], OccupancyGrid]


class RobotTask(ABC):
    """A task of the robots of many equal worlds."""

    least_robots = 1
    """Least number of robots in a world."""
    dynamics: Dynamics = "kinematic"
    """Dynamics of the robots, unless a setting says otherwise; `full` where something is pushed."""
    settings: Mapping[str, object] = MappingProxyType({})
    """Settings of its worlds, where none are given; see `EnvKeywords`."""

    def choose_agents(self, robots: int) -> IntArray:
        """Choose which of the robots (robots,) of a world learn; others are driven by the task."""
        return np.arange(robots)

    def prepare(self, start: WorldStart) -> None:  # noqa: B027 - most tasks need nothing
        """Take what the task needs of the world, with its robots, before it is copied."""

    @abstractmethod
    def list_bounds(self, robots: int) -> FloatArray:
        """List the greatest absolute values (d,) of the numbers of an observation."""

    @abstractmethod
    def restart(self, worlds: IntArray, view: FleetView, streams: WorldStreams) -> None:
        """Start episodes in some worlds.

        Args:
            worlds: (m,) their rows; all of them at first.
            view: Of all worlds.
            streams: Random numbers of the worlds.
        """

    def drive(self, view: FleetView) -> FloatArray:
        """Find forward velocity and turn (worlds, robots, 2) of the robots that do not learn."""
        return np.zeros_like(view.velocities)

    @abstractmethod
    def observe(self, view: FleetView) -> FloatArray:
        """Find the observations (worlds, agents, d)."""

    @abstractmethod
    def judge(self, view: FleetView) -> Judgement:
        """Judge the step that led here."""


def check_returned(
    task: RobotTask,
    what: str,
    found: object,
    shape: tuple[int, ...],
    kind: str = "numbers",
    *,
    live: BoolArray | bool = True,
) -> None:
    """Check shape and kind (of `ARRAY_KINDS`) of an array of a task, and where `live` for NaN.

    Raises:
        Invalid: It has another, or is none.
    """
    given, slug = type(found).__name__, "wrong_shape"
    if isinstance(found, np.ndarray):
        if found.shape == shape and found.dtype.kind in ARRAY_KINDS[kind]:
            if kind == "bool" or not ((is_nan := np.isnan(found)).any() and (is_nan & live).any()):
                return
            given, slug = "NaN", "not_finite"
        else:
            given = f"{found.shape} of {found.dtype}"
    name = f"{type(task).__name__}.{what}"
    raise Invalid(f"{name} is {given}", slug=slug, hint=f"return an array {shape} of {kind}")


def find_in_robot(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Find points (..., 2) of the world in the frames of robots at poses (..., 3)."""
    return turn_into_robot(poses[..., 2], points - poses[..., :2])


def turn_into_robot(headings: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn vectors (..., 2) of the world into frames with these headings (...,)."""
    cos, sin = np.cos(headings), np.sin(headings)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def find_distances(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Find the distances (...,) of points (..., 2) from robots at poses (..., 3)."""
    away = points - poses[..., :2]
    return np.asarray(np.hypot(away[..., 0], away[..., 1]))


class GoalProgress:
    """Goals of robots, and how far each came towards its own in a step."""

    def __init__(self, tolerance_m: float) -> None:
        self._tolerance_m = tolerance_m
        self.goals: FloatArray = np.zeros((0, 0, 2))
        """Goals x, y [m] in the world frame, (worlds, robots, 2)."""
        self._distances: FloatArray = np.zeros((0, 0))

    def restart(self, worlds: IntArray, poses: FloatArray, goals: FloatArray) -> None:
        """Set the goals (m, robots, 2) of some worlds (m,); poses are those of all."""
        if self.goals.shape != (*poses.shape[:2], 2):
            self.goals = np.zeros((*poses.shape[:2], 2))
            self._distances = np.zeros(poses.shape[:2])
        self.goals[worlds] = goals
        self._distances[worlds] = find_distances(poses[worlds], goals)

    def advance(self, poses: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Find how far [m] each robot came, (worlds, robots), and whether it is at its goal."""
        before, self._distances = self._distances, find_distances(poses, self.goals)
        return before - self._distances, self._distances <= self._tolerance_m


def find_neighbours(view: FleetView) -> FloatArray:
    """Find the nearest robots as each sees them, (worlds, robots, 12).

    Numbers of a neighbour: position x, y [m] and velocity x, y [m/s] in the frame of the robot.
    """
    worlds, robots = view.poses.shape[:2]
    heading = view.poses[..., 2]
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * view.velocities[..., :1]
    places = view.poses[..., :2]
    away = places[:, None] - places[:, :, None]
    distances = np.hypot(away[..., 0], away[..., 1])
    distances[:, np.arange(robots), np.arange(robots)] = np.inf
    count = min(NEIGHBOURS, robots - 1)
    nearest = np.argsort(distances, axis=2, kind="stable")[:, :, :count]
    found = np.zeros((worlds, robots, NEIGHBOURS, NEIGHBOUR_NUMBERS))
    found[..., 0] = FAR_M
    own = np.broadcast_to(heading[..., None], nearest.shape)
    vectors = np.take_along_axis(away, nearest[..., None], axis=2)
    moving = np.take_along_axis(np.broadcast_to(ahead[:, None], away.shape), nearest[..., None], 2)
    found[:, :, :count, :2] = turn_into_robot(own, vectors)
    found[:, :, :count, 2:] = turn_into_robot(own, moving)
    return found.reshape(worlds, robots, -1)
