"""Values of the API: pose, twist, the report of a spawn, and angles."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.printable_text import to_html
from zensim.proto.rigid_transforms import find_yaw

MAX_HTML_ENTRIES = 50
WARNING_STATUSES = frozenset({"suspicious", "predicted"})


def deg(angle: float) -> float:
    """Convert degrees to radians."""
    return math.radians(angle)


class RobotPose(NamedTuple):
    """Pose in the world: position [m], orientation as quaternion x y z w."""

    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float

    @property
    def yaw(self) -> float:
        """Angle about z [rad], in (-pi, pi]."""
        return find_yaw((self.qx, self.qy, self.qz, self.qw), FLOAT_MATH)

    @property
    def pitch(self) -> float:
        """Angle about the turned y axis [rad], in [-pi/2, pi/2]."""
        sine = 2.0 * (self.qw * self.qy - self.qz * self.qx)
        return math.asin(max(-1.0, min(1.0, sine)))

    @property
    def roll(self) -> float:
        """Angle about the turned x axis [rad], in (-pi, pi]."""
        x, y, z, w = self.qx, self.qy, self.qz, self.qw
        return math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))

    def distance_to(self, x: float, y: float) -> float:
        """Distance in the plane [m] to a point of the world."""
        return math.hypot(self.x - x, self.y - y)


class RobotTwist(NamedTuple):
    """Twist of the base in its own frame: forward, left, up [m/s]; about x, y, z [rad/s]."""

    vx: float
    vy: float
    vz: float
    wx: float
    wy: float
    wz: float

    @property
    def v(self) -> float:
        """Forward velocity [m/s]."""
        return self.vx

    @property
    def w(self) -> float:
        """Angular velocity about the base's z axis [rad/s], positive to the left."""
        return self.wz

    @property
    def linear(self) -> tuple[float, float, float]:
        """Linear velocity [m/s]."""
        return self.vx, self.vy, self.vz

    @property
    def angular(self) -> tuple[float, float, float]:
        """Angular velocity [rad/s]."""
        return self.wx, self.wy, self.wz

    @property
    def speed(self) -> float:
        """Magnitude of the linear velocity [m/s]."""
        return math.sqrt(self.vx**2 + self.vy**2 + self.vz**2)


class SpawnReport:
    """What became of a description: each tag, warnings, and the names in the world.

    Attributes:
        name: Name of the entity.
        namespace: Prefix of its topics and frames.
        entries: What became of each tag, plug-in and argument.
        refused: Of a fleet: by name, why a robot was not spawned.
    """

    def __init__(
        self,
        name: str = "",
        namespace: str = "",
        entries: Iterable[ReportEntry] = (),
        *,
        drive: str = "",
        refused: dict[str, str] | None = None,
    ) -> None:
        self.name = name
        self.namespace = namespace
        self.entries = tuple(entries)
        self.drive = drive
        """Kind of the drive, such as `diff_drive`; empty = it has none."""
        self.refused = dict(refused or {})

    @property
    def warnings(self) -> tuple[ReportEntry, ...]:
        """Entries that are probably mistakes, or predict that the robot moves badly."""
        return tuple(entry for entry in self.entries if entry.status in WARNING_STATUSES)

    def __str__(self) -> str:
        """Write a line for each entry."""
        lines = [f"{entry.status}: {entry.subject}: {entry.reason}" for entry in self.entries]
        lines += [f"refused: {name}: {reason}" for name, reason in self.refused.items()]
        return "\n".join([f"{self.name or 'report'}, drive: {self.drive or 'none'}", *lines])

    def __repr__(self) -> str:
        """Write name and counts."""
        return (
            f"SpawnReport(name={self.name!r}, drive={self.drive!r}, "
            f"entries={len(self.entries)}, warnings={len(self.warnings)})"
        )

    def _repr_html_(self) -> str:
        rows: list[tuple[object, ...]] = [
            (entry.status, entry.subject, entry.reason) for entry in self.entries
        ]
        rows += [("refused", name, reason) for name, reason in self.refused.items()]
        return make_html_table(("status", "subject", "reason"), rows[:MAX_HTML_ENTRIES])


def make_html_table(head: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """Make a table for a notebook; all texts are escaped."""
    top = "".join(f"<th>{to_html(name)}</th>" for name in head)
    lines = (
        "<tr>" + "".join(f"<td>{to_html(str(cell)[:200])}</td>" for cell in row) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{top}</tr>{''.join(lines)}</table>"


class Collision(NamedTuple):
    """The first contact of a robot with something that does not carry it."""

    time: float
    """Simulation time [s]."""
    other: str
    """Name of the other entity."""
    point: tuple[float, float, float]
    """Where, in the world [m]."""
