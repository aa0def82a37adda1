"""How entities move, drawn in the scene of a visitor: trails and velocity arrows."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np
import viser

from zensim.proto.se3 import to_yaw
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.robot_colours import to_linear
from zensim.spawner.page.viewer_client import PageState

MAX_TRAILS: Final = 100
TRAIL_POINTS: Final = 80
TRAIL_PERIOD_S: Final = 0.25
"""Time between two points of a trail: its length is 20 s."""
TRAIL_SEND_S: Final = 0.5
"""Time between two messages with all trails."""
TRAIL_HEIGHT_M: Final = 0.01
"""Height above the origin of the base, so that a trail does not flicker in the ground."""
TRAIL_PX: Final = 2.0
JUMP_M: Final = 1.0
"""A longer way between two points is a placement, not a motion."""
MAX_ARROWS: Final = 200
ARROW_PERIOD_S: Final = 0.1
FEW_ARROWS: Final = 20
"""Number of arrows up to which each frame has them, so that they stay at their robots."""
LEAST_ARROW_MPS: Final = 0.02
ARROW_S: Final = 1.0
"""An arrow is as long as the way in this time."""
MEASURED: Final = (86, 180, 233)
COMMANDED: Final = (230, 159, 0)
"""Sky blue and orange are distinct in all kinds of colour blindness (Okabe and Ito, 2008)."""

Clock = Callable[[], float]
SegmentsHandle = viser.ArrowsHandle | viser.LineSegmentsHandle
Colour = tuple[int, int, int]


class TrailHistory:
    """The last positions of entities.

    Attributes:
        names: Entities, in the order of the rows of `points`.
        points: (n, TRAIL_POINTS, 3) [m], the newest last.
    """

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self.points = np.zeros((0, TRAIL_POINTS, 3))
        self._sim_time_s = 0.0

    def add(self, names: tuple[str, ...], positions: Array, sim_time_s: float) -> bool:
        """Add the positions (n, 3) at a simulation time; return whether a point is new."""
        if sim_time_s < self._sim_time_s:
            self.names = ()
        has_time_passed, self._sim_time_s = sim_time_s != self._sim_time_s, sim_time_s
        if names != self.names:
            self._keep(names, positions)
        elif not has_time_passed:
            return False
        steps = np.linalg.norm(positions - self.points[:, -1], axis=1)
        self.points = np.concatenate((self.points[:, 1:], positions[:, None]), axis=1)
        jumped = steps > JUMP_M
        self.points[jumped] = positions[jumped, None]
        return True

    def make_segments(self) -> Array:
        """Make the segments (n (TRAIL_POINTS - 1), 2, 3) of all trails."""
        pairs = np.stack((self.points[:, :-1], self.points[:, 1:]), axis=2)
        return pairs.reshape(-1, 2, 3)

    def _keep(self, names: tuple[str, ...], positions: Array) -> None:
        rows = {name: row for row, name in enumerate(self.names)}
        points = np.repeat(positions[:, None], TRAIL_POINTS, axis=1)
        for row, name in enumerate(names):
            if name in rows:
                points[row] = self.points[rows[name]]
        self.names, self.points = names, points


class Trails:
    """The paths of robots in the last 20 s, in the colours of the robots."""

    def __init__(
        self,
        scene: viser.SceneApi,
        find_colour: Callable[[str], Colour],
        clock: Clock = time.monotonic,
    ) -> None:
        self._scene, self._find_colour, self._clock = scene, find_colour, clock
        self._history = TrailHistory()
        self._node: viser.LineSegmentsHandle | None = None
        self._shown: tuple[str, ...] = ()
        self._next_point_at = self._next_send_at = 0.0

    def draw(self, names: Sequence[str], state: PageState) -> None:
        """Add the positions of the first `MAX_TRAILS` robots among these entities."""
        now = self._clock()
        if now < self._next_point_at:
            return
        self._next_point_at = now + TRAIL_PERIOD_S
        robots = tuple(name for name in names if name in state.fleet.driven)[:MAX_TRAILS]
        rows = [state.fleet.rows[name] for name in robots]
        positions = state.frame.base[rows, :3] + np.array((0.0, 0.0, TRAIL_HEIGHT_M))
        is_new = self._history.add(robots, positions, state.status.sim_time_s)
        if is_new and (now >= self._next_send_at or robots != self._shown):
            self._next_send_at = now + TRAIL_SEND_S
            self._show()

    def clear(self) -> None:
        """Remove all trails."""
        if self._node is not None:
            self._node.remove()
        self._node, self._shown, self._history = None, (), TrailHistory()

    def _show(self) -> None:
        points = self._history.make_segments().astype(np.float32)
        if self._node is not None and self._history.names == self._shown:
            self._node.points = points
            return
        if self._node is not None:
            self._node.remove()
        self._node, self._shown = None, self._history.names
        if len(points):
            colours = [self._find_colour(name) for name in self._shown]
            self._node = self._scene.add_line_segments(
                "/trails",
                points,
                make_segment_colours(colours, TRAIL_POINTS - 1),
                thickness=TRAIL_PX,
                thickness_units="screen",
            )


def make_segment_colours(colours: Sequence[Colour], count: int) -> np.ndarray:
    """Make linear colours (n count, 2, 3), uint8: each colour is that of `count` segments."""
    rows = np.repeat(to_linear(np.array(colours, np.uint8).reshape(-1, 3)), count, axis=0)
    return np.repeat(rows[:, None], 2, axis=1)


class VelocityArrows:
    """Arrows of the measured velocity, and of the commanded one where it is known."""

    def __init__(self, scene: viser.SceneApi, clock: Clock = time.monotonic) -> None:
        measured, commanded = "/velocities/measured", "/velocities/commanded"
        self._measured = Segments(partial(_add_arrows, scene, measured, MEASURED))
        self._commanded = Segments(partial(_add_arrows, scene, commanded, COMMANDED))
        self._clock, self._next_at = clock, 0.0

    def draw(self, names: Sequence[str], state: PageState) -> None:
        """Draw the arrows of the first `MAX_ARROWS` of these entities."""
        if len(names) > FEW_ARROWS and self._clock() < self._next_at:
            return
        self._next_at = self._clock() + ARROW_PERIOD_S
        tops = {name: state.find_top(name) for name in names[:MAX_ARROWS]}
        ways = {name: state.state_of(name)[7:10] * ARROW_S for name in tops}
        self._measured.show(make_arrows(tops, ways))
        wanted = {
            name: find_commanded_way(state.state_of(name), command.forward_mps)
            for name, command in state.commands.items()
            if name in tops
        }
        self._commanded.show(make_arrows(tops, wanted))

    def clear(self) -> None:
        """Remove all arrows."""
        self._measured.show(np.zeros((0, 2, 3)))
        self._commanded.show(np.zeros((0, 2, 3)))


class Segments:
    """A node of segments (n, 2, 3) [m], such as arrows or a line."""

    def __init__(self, add: Callable[[Array], SegmentsHandle]) -> None:
        """Show nothing yet; the function adds a node with points."""
        self._add = add
        self._node: SegmentsHandle | None = None
        self._shown: Array = np.zeros((0, 2, 3))

    def show(self, points: Array) -> None:
        """Show exactly these segments."""
        if np.array_equal(points, self._shown):
            return
        has_same_size = len(points) == len(self._shown)
        self._shown = points
        if self._node is not None and has_same_size:
            self._node.points = points.astype(np.float32)
            return
        if self._node is not None:
            self._node.remove()
            self._node = None
        if len(points):
            self._node = self._add(points)


def _add_arrows(
    scene: viser.SceneApi, path: str, colour: Colour, points: Array
) -> viser.ArrowsHandle:
    return scene.add_arrows(
        path,
        points,
        to_linear(np.array(colour)),
        shaft_radius=0.01,
        head_radius=0.025,
        head_length=0.05,
    )


def make_arrows(starts: dict[str, Array], ways: dict[str, Array]) -> Array:
    """Make arrows (n, 2, 3) of those ways [m] that are not too short."""
    long = [n for n, way in ways.items() if np.linalg.norm(way) >= LEAST_ARROW_MPS * ARROW_S]
    return np.array([(starts[n], starts[n] + ways[n]) for n in long]).reshape(-1, 2, 3)


def find_commanded_way(state: Array, forward_mps: float) -> Array:
    """Find the way (3,) [m] of a commanded speed along the x axis of a base."""
    yaw = float(to_yaw(state[3:7]))
    return np.array((np.cos(yaw), np.sin(yaw), 0.0)) * forward_mps * ARROW_S
