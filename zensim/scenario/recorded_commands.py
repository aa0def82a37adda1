"""Reads recorded commands of robots from a CSV file."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_text_file

FloatArray = npt.NDArray[np.float64]
HEADS = (["time", "v", "w"], ["time", "robot", "v", "w"])


class RecordedCommands(msgspec.Struct, frozen=True):
    """Time [s], speed [m/s] and turn [rad/s] (k, 3) by robot; "" = of all robots."""

    by_robot: Mapping[str, FloatArray]

    def find(self, robot: str) -> FloatArray:
        """Find the commands of a robot; none, if the file has only those of others."""
        found = self.by_robot.get(robot, self.by_robot.get(""))
        return np.zeros((0, 3)) if found is None else found


def read_commands(file: Path, names: Sequence[str]) -> RecordedCommands:
    """Read a file with a head line time,v,w or time,robot,v,w.

    Raises:
        OSError: It cannot be read.
        ValueError: A line is wrong; the message has its number.
    """
    if file.suffix == ".mcap":
        raise ValueError("recordings are not read yet; write its commands as CSV: time,v,w")
    lines = list(csv.reader(read_text_file(file, MAX_OWN_FILE_BYTES).splitlines()))
    head = [word.strip() for word in lines[0]] if lines else []
    if head not in HEADS:
        raise ValueError(f"line 1: the head line is {','.join(head)}; use time,v,w")
    rows: dict[str, list[list[float]]] = {}
    for number, cells in enumerate(lines[1:], start=2):
        if any(cell.strip() for cell in cells):
            robot, row = _read_line(dict(zip(head, cells, strict=False)), number, names)
            _require_later(rows.setdefault(robot, []), row, number)
            rows[robot].append(row)
    return RecordedCommands({robot: np.array(listed) for robot, listed in rows.items()})


def _read_line(
    cells: Mapping[str, str], number: int, names: Sequence[str]
) -> tuple[str, list[float]]:
    robot = cells.get("robot", "").strip()
    if robot and robot not in names:
        raise ValueError(f"line {number}: there is no robot `{robot}`")
    try:
        row = [float(cells[key]) for key in ("time", "v", "w")]
    except (KeyError, ValueError):
        row = [math.nan]
    if not all(map(math.isfinite, row)):
        raise ValueError(f"line {number}: time, v and w have to be finite numbers")
    return robot, row


def _require_later(rows: Sequence[Sequence[float]], row: Sequence[float], number: int) -> None:
    if rows and row[0] <= rows[-1][0]:
        raise ValueError(f"line {number}: time {row[0]:g} is not after {rows[-1][0]:g}")
