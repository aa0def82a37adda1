"""Monitors of checks: the margin of a condition at each control step, and its verdict in time."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, cast

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray
from zensim.scenario import scenario_format as sections
from zensim.scenario.robot_behaviours import FleetState
from zensim.scenario.scenario_format import Check
from zensim.scenario.time_operators import (
    Always,
    Eventually,
    MarginResult,
    TimeOperator,
    combine_results,
)
from zensim.scenario.wall_outlines import Wall

IntArray = npt.NDArray[np.intp]
Verdict = Literal["passed", "failed", "not_evaluated", "error"]
EventKind = Literal["start", "end"]
UNITS_OF_MARGINS: Mapping[type, str] = {
    sections.SpeedCheck: "m/s",
    sections.RateCheck: "Hz",
    sections.AccelerationCheck: "m/s^2",
    sections.UprightCheck: "rad",
    sections.NoEventCheck: "",
    sections.RealTimeFactorCheck: "",
    sections.PythonCheck: "",
    sections.AllOfCheck: "",
    sections.AnyOfCheck: "",
}
"""Units of checks whose margin is not in metres."""


class ScenarioEvent(msgspec.Struct, frozen=True):
    """Start or end of a fault or behaviour."""

    time: float
    """Simulated seconds since all robots are driven."""
    name: str
    kind: EventKind


@dataclass(frozen=True)
class CheckedState(FleetState):
    """What a check sees at a control step.

    Attributes:
        orientations: Quaternions x y z w of the root links, (n, 4).
        real_time_factor: Simulated by wall time since the start.
        events: Of this step.
        active: Names of faults and behaviours that act.
        before: The state one control step before; None at the first.
    """

    orientations: FloatArray
    real_time_factor: float = math.inf
    events: tuple[ScenarioEvent, ...] = ()
    active: frozenset[str] = frozenset()
    before: "CheckedState | None" = None


class Outline(msgspec.Struct, frozen=True):
    """Rectangle around a robot in the frame of its root link: centre and half lengths [m]."""

    x: float = 0.0
    y: float = 0.0
    half_length: float = 0.0
    half_width: float = 0.0


class WorldOutlines(msgspec.Struct, frozen=True):
    """Outlines of robots by name, and of the world's own entities."""

    robots: Mapping[str, Outline] = {}
    walls: Sequence[Wall] = ()


class MessageCount:
    """Counts messages of a topic by their stamps."""

    def __init__(self) -> None:
        self._stamps: deque[float] = deque()

    def note(self, stamp: float) -> None:
        """Take the stamp of a message [s]."""
        self._stamps.append(stamp)

    def find_rate(self, now: float, window: float) -> float:
        """Find the rate [Hz] of messages in a window that ends now [s]; older ones are dropped."""
        while self._stamps and self._stamps[0] <= now - window + 1e-9:
            self._stamps.popleft()
        return len(self._stamps) / window


def make_rate_margin(check: sections.RateCheck, count: MessageCount) -> "Margin":
    """Make the margin of a rate; nothing to look at before the first window is over."""
    low = -math.inf if check.above is None else check.above
    high = math.inf if check.below is None else check.below

    def margin(state: CheckedState) -> FloatArray:
        if state.now < check.window - 1e-9:
            return np.zeros(0)
        rate = count.find_rate(state.now, check.window)
        return np.array([min(rate - low, high - rate)])

    return margin


def make_outline(corners: Sequence[tuple[float, float]]) -> Outline:
    """Make an outline from two corners, upper and lower [m]; none = a point."""
    if not corners:
        return Outline()
    (x0, x1), (y0, y1) = ((min(one), max(one)) for one in zip(*corners, strict=True))
    return Outline((x0 + x1) / 2.0, (y0 + y1) / 2.0, (x1 - x0) / 2.0, (y1 - y0) / 2.0)


Margin = Callable[[CheckedState], FloatArray]
"""Margins of the robots of a check, (m,)."""


class CheckResult(msgspec.Struct, frozen=True):
    """Verdict of one check."""

    name: str
    kind: str
    verdict: Verdict
    margin: float
    """Worst, in `unit`; nan if it was not evaluated."""
    unit: str = ""
    time: float = math.nan
    """Simulation time of the worst margin [s]."""
    robot: str = ""
    """Robot that has the worst margin; empty if the check is not on single robots."""
    message: str = ""
    severity: str = "fail"
    place: str = ""
    """File and line."""

    @property
    def is_failure(self) -> bool:
        """Whether the run fails by it."""
        return self.severity == "fail" and self.verdict != "passed"


@dataclass
class CheckMonitor:
    """A check in time: which operator looks at which samples.

    Attributes:
        subjects: Robot, or pair of robots, of each row of the margins.
    """

    check: Check
    margin: Margin
    subjects: Sequence[str]
    place: str = ""
    operators: list[TimeOperator] = field(default_factory=list)
    is_over: bool = False
    newest: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Begin to look, unless an event has to come first."""
        check = self.check
        if not check.after:
            end = math.inf if check.to is None else check.to
            if check.by is None:
                self.operators.append(Always(check.start, end))
            else:
                self.operators.append(Eventually(check.start, check.by, check.hold))

    def update(self, state: CheckedState) -> None:
        """Look at a control step."""
        check = self.check
        self._take_events(state)
        self.newest = self.margin(state)
        if check.excluded and check.excluded in state.active:
            return
        if not self.is_over and len(self.newest):
            for operator in self.operators:
                operator.update(state.now, self.newest)

    def _take_events(self, state: CheckedState) -> None:
        check = self.check
        for event in state.events:
            if event.kind == "start" and event.name == check.until:
                self.is_over = True
            if event.kind == "start" and event.name == check.after and not self.is_over:
                start = max(event.time, check.start)
                end = math.inf if check.to is None else check.to
                self.operators.append(
                    Always(start, end)
                    if check.within is None
                    else Eventually(start, start + check.within, check.hold)
                )

    def result(self) -> MarginResult:
        """Find the margin so far: the worst over all times to look."""
        return combine_results([one.result() for one in self.operators])

    def has_passed(self, now: float) -> bool:
        """Whether it is true, and for eventual checks already decided by that."""
        found = self.result()
        is_eventual = self.check.by is not None or self.check.within is not None
        is_true = found.margin >= 0.0
        return is_true and (is_eventual or all(one.is_decided(now) for one in self.operators))

    def has_failed(self, now: float) -> bool:
        """Whether nothing that comes can make it true."""
        for operator in self.operators:
            is_late = isinstance(operator, Always) or operator.is_decided(now)
            if is_late and operator.result().margin < 0.0:
                return True
        return False

    def report(self) -> CheckResult:
        """Give the verdict at the end of the run."""
        found = self.result()
        verdict: Verdict = "passed" if found.margin >= 0.0 else "failed"
        message = ""
        if math.isnan(found.margin):
            verdict = "not_evaluated"
            what = f"'{self.check.after}' never started" if self.check.after else "it had no time"
            message = f"not looked at: {what}"
        elif verdict == "failed":
            message = _describe_failure(self.check, found, self._name_subject(found))
        return CheckResult(
            name=self.check.name,
            kind=str(type(self.check).__struct_config__.tag),
            verdict=verdict,
            margin=found.margin,
            unit=UNITS_OF_MARGINS.get(type(self.check), "m"),
            time=found.time,
            robot=self._name_subject(found),
            message=message,
            severity=self.check.severity,
            place=self.place,
        )

    def _name_subject(self, found: MarginResult) -> str:
        return self.subjects[found.row] if 0 <= found.row < len(self.subjects) else ""


def _describe_failure(check: Check, found: MarginResult, subject: str) -> str:
    unit = UNITS_OF_MARGINS.get(type(check), "m")
    who = f"{subject}: " if subject else ""
    if math.isinf(found.margin) and check.hold:
        return f"{who}no `hold` ({check.hold:g} s) was over at the end of the run"
    if math.isinf(found.margin):
        return f"{who}was never true in the time that counts"
    how = f"{-found.margin:.4g} {unit}".strip()
    return f"{who}missed by {how} at {found.time:.3f} s"


def make_monitor(
    check: Check,
    robots: Sequence[str],
    *,
    rows: IntArray,
    place: str,
    outlines: WorldOutlines,
    others: Mapping[str, CheckMonitor],
) -> CheckMonitor:
    """Make the monitor of a check.

    Args:
        check: As in the file.
        robots: That it selects.
        rows: Of these robots in the states, (m,).
        place: File and line.
        outlines: For `no_collision`.
        others: Monitors that it may refer to.
    """
    if isinstance(check, sections.NoCollisionCheck | sections.DistanceCheck):
        first, second = np.triu_indices(len(rows), 1)
        pairs = list(zip(first.tolist(), second.tolist(), strict=True))
        subjects = [f"{robots[one]}, {robots[other]}" for one, other in pairs]
        known = [outlines.robots.get(name) for name in robots]
        margin = _make_pair_margin(check, rows, known)
        if isinstance(check, sections.NoCollisionCheck) and check.walls and outlines.walls:
            subjects += [f"{robot}, {wall.name}" for robot in robots for wall in outlines.walls]
            margin = _add_walls(margin, make_wall_margin(check, rows, known, outlines.walls))
        return CheckMonitor(check, margin, subjects, place)
    if isinstance(check, sections.AllOfCheck | sections.AnyOfCheck):
        parts = [others[name] for name in check.checks]
        worst = np.min if isinstance(check, sections.AllOfCheck) else np.max
        return CheckMonitor(check, _combine_margins(parts, worst), [""], place)
    whole = _make_whole_margin(check)
    if whole is not None:
        return CheckMonitor(check, whole, [""], place)
    return CheckMonitor(check, _make_robot_margin(check, rows), robots, place)


def _combine_margins(
    parts: Sequence[CheckMonitor], worst: Callable[[list[float]], np.floating]
) -> Margin:
    def margin(_state: CheckedState) -> FloatArray:
        values = [float(part.newest.min()) for part in parts if len(part.newest)]
        return np.array([worst(values)] if values else [])

    return margin


def _make_whole_margin(check: Check) -> Margin | None:
    """Make the margin of a check that is not on robots."""
    if isinstance(check, sections.NoEventCheck):
        word = check.event

        def no_event(state: CheckedState) -> FloatArray:
            came = any(one.name == word and one.kind == "start" for one in state.events)
            return np.array([-1.0 if came else 1.0])

        return no_event
    if isinstance(check, sections.RealTimeFactorCheck):
        least = check.above
        return lambda state: np.array([state.real_time_factor - least])
    return None


def _make_robot_margin(check: Check, rows: IntArray) -> Margin:
    if isinstance(check, sections.SpeedCheck):
        return _make_speed_margin(check, rows)
    if isinstance(check, sections.AccelerationCheck):
        most = check.below
        return lambda state: most - _find_accelerations(state, rows)
    if isinstance(check, sections.ReachedCheck):
        point, tolerance = np.array(check.point), check.tolerance
        return lambda state: tolerance - _norm(state.poses[rows, :2] - point)
    if isinstance(check, sections.InsideCheck | sections.OutsideCheck):
        corners = np.array(check.polygon)
        sign = 1.0 if isinstance(check, sections.InsideCheck) else -1.0
        return lambda state: sign * find_depths(state.poses[rows, :2], corners)
    if isinstance(check, sections.TrackingCheck):
        path, limit = np.array(check.path), check.below
        return lambda state: limit - find_distances_to_path(state.poses[rows, :2], path)
    upright = cast("sections.UprightCheck", check)
    return lambda state: upright.below - find_tilts(state.orientations[rows])


def _make_speed_margin(check: sections.SpeedCheck, rows: IntArray) -> Margin:
    low = -math.inf if check.above is None else check.above
    high = math.inf if check.below is None else check.below

    def margin(state: CheckedState) -> FloatArray:
        speeds = _norm(state.twists[rows, :2])
        return np.minimum(speeds - low, high - speeds)

    return margin


def _find_accelerations(state: CheckedState, rows: IntArray) -> FloatArray:
    if state.before is None:
        return np.zeros(len(rows))
    speeds = _norm(state.twists[rows, :2]), _norm(state.before.twists[rows, :2])
    return np.asarray(np.abs(speeds[0] - speeds[1]) / state.period)


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))


def _make_pair_margin(
    check: sections.NoCollisionCheck | sections.DistanceCheck,
    rows: IntArray,
    outlines: Sequence[Outline | None],
) -> Margin:
    """Make the margin of all pairs of robots: of their origins, or between their outlines."""
    first, second = np.triu_indices(len(rows), 1)
    if isinstance(check, sections.DistanceCheck):
        low = -math.inf if check.above is None else check.above
        high = math.inf if check.below is None else check.below

        def margin(state: CheckedState) -> FloatArray:
            points = state.poses[rows, :2]
            gaps = _norm(points[first] - points[second])
            return np.minimum(gaps - low, high - gaps)

        return margin
    if check.radius is not None:
        apart = 2.0 * check.radius
        return lambda state: (
            _norm(state.poses[rows[first], :2] - state.poses[rows[second], :2]) - apart
        )
    known = [one or Outline() for one in outlines]
    boxes = np.array([(one.x, one.y, one.half_length, one.half_width) for one in known])
    return lambda state: find_gaps(state.poses[rows], boxes, first, second)


def _add_walls(pairs: Margin, walls: Margin) -> Margin:
    return lambda state: np.concatenate([pairs(state), walls(state)])


NEAR_WALL_M = 1.0
"""Farther gaps are bounded from below only."""


def make_wall_margin(
    check: sections.NoCollisionCheck,
    rows: IntArray,
    outlines: Sequence[Outline | None],
    walls: Sequence[Wall],
) -> Margin:
    """Make the margin of all pairs of a robot and a wall, robot by robot."""
    radius = check.radius
    known = [one or Outline() for one in outlines]
    boxes = np.array([(one.x, one.y, one.half_length, one.half_width) for one in known])
    if radius is not None:
        # A square around the circle.
        boxes = np.tile(np.array([0.0, 0.0, radius, radius]), (len(rows), 1))
    boxes = boxes.reshape(-1, 4)
    fixed = np.array([(one.x, one.y, one.yaw) for one in walls])
    sizes = np.array([(0.0, 0.0, one.half_length, one.half_width) for one in walls])
    reach = np.hypot(np.abs(boxes[:, 0]) + boxes[:, 2], np.abs(boxes[:, 1]) + boxes[:, 3])
    cos, sin = np.cos(fixed[:, 2]), np.sin(fixed[:, 2])

    def margin(state: CheckedState) -> FloatArray:
        poses = state.poses[rows]
        offset = poses[:, None, :2] - fixed[None, :, :2]
        along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin) - sizes[:, 2]
        across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin) - sizes[:, 3]
        gaps = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)) - reach[:, None]
        robot, wall = np.nonzero(gaps < NEAR_WALL_M)
        gaps[robot, wall] = find_gaps(
            np.concatenate([poses, fixed]), np.concatenate([boxes, sizes]), robot, wall + len(poses)
        )
        return np.asarray(gaps.ravel())

    return margin


def find_gaps(
    poses: FloatArray, boxes: FloatArray, first: IntArray, second: IntArray
) -> FloatArray:
    """Find the gap between rectangles by their separating axes [m]; negative = they overlap.

    Args:
        poses: x, y [m] and heading [rad] of each robot, (n, 3).
        boxes: Centre x, y and half lengths along x, y in the robot's frame [m], (n, 4).
        first: Of each pair, (k,).
        second: Of each pair, (k,).
    """
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead, left = np.column_stack([cos, sin]), np.column_stack([-sin, cos])
    centres = poses[:, :2] + boxes[:, :1] * ahead + boxes[:, 1:2] * left
    offset = centres[second] - centres[first]
    worst = np.full(len(first), -math.inf)
    for axis in (ahead[first], left[first], ahead[second], left[second]):
        reach = np.zeros(len(first))
        for one in (first, second):
            reach += boxes[one, 2] * np.abs((ahead[one] * axis).sum(axis=1))
            reach += boxes[one, 3] * np.abs((left[one] * axis).sum(axis=1))
        worst = np.maximum(worst, np.abs((offset * axis).sum(axis=1)) - reach)
    return worst


def find_tilts(orientations: FloatArray) -> FloatArray:
    """Find the angle of each z axis to the vertical [rad], (n,), from x y z w, (n, 4)."""
    x, y = orientations[:, 0], orientations[:, 1]
    return np.asarray(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))


def find_distances_to_path(points: FloatArray, path: FloatArray) -> FloatArray:
    """Find the distance of each point (n, 2) from a line of points (k, 2) [m], (n,)."""
    if len(path) == 1:
        return _norm(points - path[0])
    start, along = path[:-1], np.diff(path, axis=0)
    squared = np.maximum((along * along).sum(axis=1), 1e-30)
    offset = points[:, None, :] - start
    share = np.clip((offset * along).sum(axis=2) / squared, 0.0, 1.0)
    gap = offset - share[:, :, None] * along
    return np.asarray(np.hypot(gap[:, :, 0], gap[:, :, 1]).min(axis=1))


def find_depths(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Find how deep each point (n, 2) is inside of a polygon (k, 2) [m]; negative = outside."""
    ring = np.concatenate([corners, corners[:1]])
    distance = find_distances_to_path(points, ring)
    (x0, y0), (x1, y1) = ring[:-1].T, ring[1:].T
    x, y = points[:, :1], points[:, 1:]
    crosses = (y0 > y) != (y1 > y)
    height = np.where(y1 == y0, 1.0, y1 - y0)
    is_left = x < (x1 - x0) * (y - y0) / height + x0
    is_inside = (crosses & is_left).sum(axis=1) % 2 == 1
    return np.where(is_inside, distance, -distance)
