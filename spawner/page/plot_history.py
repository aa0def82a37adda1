"""What plots show: numbers over simulation time of robots and of messages. NumPy only."""

import csv
import io
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from math import hypot, inf, isfinite, isnan, nan
from typing import Final

import msgspec
import numpy as np

from zensim.proto.messages.standard_messages import JointState, LaserScan
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.render_state import LastCommand

PLOT_POINTS: Final = 300
"""60 s at 5 Hz."""
MAX_FIELDS: Final = 6
"""Most fields of a message that are plotted."""
MAX_NAME: Final = 60
"""Characters of the name of a field that are shown."""
TIME_COLUMN: Final = "simulation time [s]"
FACTOR: Final = "real-time factor"
HEADROOM: Final = 0.1
STILL_RANGE: Final = 0.1
"""Range of a chart whose values are all zero."""
COMPARABLE: Final = 0.5
"""Share of the greatest distance of values from zero at which the least one has zero in view."""
LEAST_SPAN: Final = 1e-4
"""Least range of a chart without zero, as a share of its values: smaller changes are noise."""
PLAIN: Final = (0.01, 1e6)
"""Numbers that legends show without an exponent."""
ROUNDED: Final = (1e-12, 1e300)
"""Least and greatest difference of values whose range is rounded."""


class PlotHistory:
    """The last `PLOT_POINTS` values of some columns over simulation time."""

    def __init__(self) -> None:
        self.columns: tuple[str, ...] = ()
        self._rows: deque[tuple[float, ...]] = deque(maxlen=PLOT_POINTS)

    def add(self, time_s: float, values: Mapping[str, float]) -> bool:
        """Add the values at a time; an earlier time begins a new history.

        A new column is NaN in earlier rows; a column that is not given is removed.

        Returns:
            Whether the row is new: time does not pass while a world is paused.
        """
        columns = tuple(values)
        if self._rows and time_s < self._rows[-1][0]:
            self._rows.clear()
        if columns != self.columns:
            self._arrange(columns)
        if self._rows and time_s == self._rows[-1][0]:
            return False
        self._rows.append((time_s, *values.values()))
        return True

    def _arrange(self, columns: tuple[str, ...]) -> None:
        rows = [dict(zip(self.columns, row[1:], strict=True)) for row in self._rows]
        times = [row[0] for row in self._rows]
        self.columns = columns
        self._rows.clear()
        for time_s, row in zip(times, rows, strict=True):
            self._rows.append((time_s, *(row.get(column, nan) for column in columns)))

    def make_arrays(self, columns: Sequence[str]) -> tuple[Array, ...]:
        """Make an array of times [s] and one of each column, NaN where it has no finite number.

        Rows without any number are left out.
        """
        places = [0, *(1 + self.columns.index(column) for column in columns)]
        if not self._rows:
            return tuple(np.zeros(0) for _ in places)
        chosen = np.array(self._rows, dtype=np.float64)[:, places]
        chosen[~np.isfinite(chosen)] = nan
        return tuple(chosen[np.isfinite(chosen[:, 1:]).any(axis=1)].T.copy())

    def make_csv(self) -> bytes:
        """Write all rows as CSV of RFC 4180, with a line of titles; no number is an empty cell."""
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow((TIME_COLUMN, *self.columns))
        writer.writerows(
            ["" if isnan(number) else f"{number:.6g}" for number in row] for row in self._rows
        )
        return text.getvalue().encode()


def find_axis_range(values: Sequence[Array], *, has_zero: bool) -> tuple[float, float]:
    """Find the range of the axis of a chart: all values (n,), and room beyond them.

    Its ends are multiples of a round step, so that they seldom change while values come.

    Args:
        values: Of each line.
        has_zero: Whether zero is in view in any case, else only beside values as far from it.
    """
    finite = [line[np.isfinite(line)] for line in values]
    ends = [float(end(one)) for one in finite if len(one) for end in (np.min, np.max)] or [0.0]
    low, high = min(ends), max(ends)
    far = max(abs(low), abs(high))
    if has_zero or low < 0.0 < high or min(abs(low), abs(high)) <= COMPARABLE * far:
        low, high = min(low, 0.0), max(high, 0.0)
    least = LEAST_SPAN * far
    if high - low < least:
        low, high = low - least / 2.0, high + least / 2.0
    if not ROUNDED[0] < high - low < ROUNDED[1]:
        return low, max(high, STILL_RANGE)
    room = HEADROOM * (high - low)
    step = 10.0 ** np.floor(np.log10(high - low)) / 2.0
    lowest = np.floor((low - room) / step) * step if low else 0.0
    highest = np.ceil((high + room) / step) * step if high else 0.0
    return float(lowest), float(highest)


def format_number(number: float) -> str:
    """Format a value for a legend; empty for NaN."""
    if isnan(number):
        return ""
    is_plain = number == 0.0 or PLAIN[0] <= abs(number) < PLAIN[1]
    return f"{number:.2f}" if is_plain else f"{number:.2e}"


def name_robot_columns(name: str) -> dict[str, tuple[str, str]]:
    """Name the two columns of a robot in each chart."""
    return {
        "Speed": (f"{name} v [m/s]", f"{name} v commanded [m/s]"),
        "Turn rate": (f"{name} w [rad/s]", f"{name} w commanded [rad/s]"),
        "Position": (f"{name} x [m]", f"{name} y [m]"),
    }


def measure_robot(name: str, state: Array, command: LastCommand | None) -> dict[str, float]:
    """Read the columns of a robot from its state (STATE_COLUMNS,) and its last command.

    Without a command the columns of commanded velocities are missing; of an old one they are zero.
    """
    given: tuple[float | None, float | None] = (None, None)
    if command is not None:
        given = (command.forward_mps, command.turn_radps) if command.is_fresh else (0.0, 0.0)
    pairs = [
        (hypot(float(state[7]), float(state[8])), given[0]),
        (float(state[12]), given[1]),
        (float(state[0]), float(state[1])),
    ]
    columns = name_robot_columns(name).values()
    return {
        column: number
        for names, numbers in zip(columns, pairs, strict=True)
        for column, number in zip(names, numbers, strict=True)
        if number is not None
    }


def read_numbers(message: msgspec.Struct) -> dict[str, float]:
    """Read the first `MAX_FIELDS` numbers of a message, without headers and covariances.

    Of a scan it is the nearest distance, of joint states the positions.
    """
    if isinstance(message, LaserScan):
        ranges = np.array(message.ranges, dtype=np.float64)
        hits = ranges[(ranges >= message.range_min) & (ranges <= message.range_max)]
        return {"nearest [m]": float(hits.min(initial=inf))}
    found: Iterator[tuple[str, float]] = _walk(message, "")
    if isinstance(message, JointState):
        found = zip(message.name, message.position, strict=False)
    return {name[:MAX_NAME]: number for name, number in islice(found, MAX_FIELDS)}


def _walk(message: msgspec.Struct, prefix: str) -> Iterator[tuple[str, float]]:
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if name in ("header", "status") or "covariance" in name:
            continue
        if isinstance(value, msgspec.Struct):
            yield from _walk(value, f"{prefix}{name}.")
        elif isinstance(value, float):
            yield prefix + name, value if isfinite(value) else inf
