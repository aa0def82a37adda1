"""Checks of robot descriptions: what to spawn and drive, each in a process, and the verdicts."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from zensim.proto.bounded_files import MAX_TEXT_FILE_BYTES, open_regular_file, read_file
from zensim.proto.child_process import SINGLE_THREADED, make_module_command, run_process
from zensim.proto.messages.model_messages import Dynamics, Vec3

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

TRIAL_COMMAND = make_module_command("zensim.deploy.robot_trial")
DESCRIPTION_SUFFIXES = (".urdf", ".sdf", ".xacro")
LIST_SUFFIX = ".json"
ROOT_BYTES = 65536
"""Bytes of a file in which its root tag is searched."""
MAX_TILT_RAD = math.radians(5.0)
MAX_CREEP_M_S = 1e-3
MAX_DRIFT_RAD_S = 0.02
PREDICTION_TOLERANCE = 0.1
"""Largest deviation from the prediction, as a share of the command."""
FALLS = ("it falls", "it sinks")
"""How remarks begin that predict that a robot does not stand."""
MIN_FALL_M = 0.05
"""Least distance by which a robot comes down that was predicted to fall."""
FALLEN_RAD = math.pi / 4.0
"""Tilt of a robot that has fallen over."""
MAX_SHIFT_M = 3.0
"""Largest distance from its place of a robot that nothing drives."""
MAX_HEIGHT_M = 1.0
"""Largest rise of such a robot."""

Verdict = Literal[
    "ok", "stands", "predicted", "off", "no drive", "unstable", "refused", "crashed", "timeout"
]
PASSED: tuple[Verdict, ...] = ("ok", "stands")


class RobotCheck(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One description, and how to read it."""

    path: str
    name: str = ""
    """Name in the table; empty = the name of the model."""
    source: str = ""
    """Where the description comes from."""
    xacro_args: tuple[str, ...] = ()
    package_paths: tuple[str, ...] = ()
    controllers: tuple[str, ...] = ()
    """Parameter files of ros2_controllers or ros_control."""
    drive: str = ""
    """Drive as in `zensim spawn --drive`."""
    remark: str = ""


class TrialRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A robot to spawn and drive in an engine."""

    robot: RobotCheck
    engine: str
    allow_missing: bool = False
    compat: str = "fixed"
    """Mode as in `zensim spawn --compat`."""
    dynamics: Dynamics = "full"
    """Tier as in `zensim spawn --dynamics`."""
    allow_failed_engine: bool = False

    @property
    def engine_label(self) -> str:
        """The engine in the table: the kinematic tier computes without one."""
        return self.dynamics if self.dynamics == "kinematic" else self.engine


class DrivenPart(msgspec.Struct, frozen=True):
    """Mean motion of the base under one command, after it has settled.

    Twists are vx, vy [m/s] and wz [rad/s] in the base.
    """

    commanded: Vec3
    """What the drive's own sizes make of the command."""
    measured: Vec3
    predicted: Vec3 | None = None
    """What friction and geometry allow; None = not predicted."""


class TrialResult(msgspec.Struct, frozen=True):
    """What a robot did."""

    model: str = ""
    error: str = ""
    """Why it was refused; empty if it was spawned."""
    is_fault: bool = False
    """Whether the error is one of zensim, not of the description."""
    drive: str = ""
    """Kind of its drive; empty = none."""
    drive_source: str = ""
    """plug-in, controllers or option."""
    links: int = 0
    mass_kg: float = 0.0
    tilt_rad: float = 0.0
    """Tilt of the base at rest, from upright."""
    creep_m_s: float = 0.0
    """Speed of the base at rest."""
    shift: Vec3 = (0.0, 0.0, 0.0)
    """Shift of the base from its place to rest [m]."""
    has_diverged: bool = False
    """Whether a state was not finite or out of range."""
    straight: DrivenPart | None = None
    turn: DrivenPart | None = None
    remarks: tuple[str, ...] = ()


class CheckRow(msgspec.Struct, frozen=True):
    """One row of the table."""

    robot: RobotCheck
    engine: str
    verdict: Verdict
    result: TrialResult
    reason: str = ""
    """Why the verdict is not ok."""

    @property
    def name(self) -> str:
        """Name in the table."""
        return self.robot.name or self.result.model or Path(self.robot.path).name

    @property
    def is_passed(self) -> bool:
        """Whether the robot drives as commanded, or has nothing to drive."""
        return self.verdict in PASSED


def find_robots(paths: Sequence[Path], excluded: Sequence[str]) -> list[RobotCheck]:
    """Find the descriptions of files, list files and folders, sorted by path within a folder.

    Args:
        paths: Files are taken whatever their suffix; folders are searched.
        excluded: Patterns of paths to leave out, as `Path.match` reads them.

    Raises:
        FileNotFoundError: A path does not exist.
        ValueError: A list file is not valid.
    """
    found: dict[tuple[str, ...], RobotCheck] = {}
    for path in paths:
        for robot in _expand_path(path):
            if not any(_matches(Path(robot.path), pattern) for pattern in excluded):
                options = (*robot.xacro_args, *robot.controllers, robot.drive)
                found.setdefault((robot.path, *options), robot)
    return list(found.values())


def _expand_path(path: Path) -> Iterator[RobotCheck]:
    if path.is_dir():
        yield from (RobotCheck(str(file)) for file in _search_folder(path))
    elif not path.is_file():
        raise FileNotFoundError(2, "no such file or folder", str(path))
    elif path.suffix == LIST_SUFFIX:
        yield from read_robot_list(path)
    else:
        yield RobotCheck(str(path))


def _matches(path: Path, pattern: str) -> bool:
    return path.match(pattern) or any(parent.match(pattern) for parent in path.parents)


def _search_folder(folder: Path) -> list[Path]:
    """Find robots below a folder: files that xacro includes define no robot, and are left out."""
    files = []
    for parent, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        files += [Path(parent) / name for name in sorted(names)]
    return [file for file in files if file.suffix in DESCRIPTION_SUFFIXES and _is_robot(file)]


def _is_robot(file: Path) -> bool:
    try:
        with open_regular_file(file) as stream:
            head = stream.read(ROOT_BYTES)
    except OSError:
        return False
    if file.suffix == ".sdf":
        return b"<model" in head and b"<world" not in head
    # A file for inclusion has a root without a name.
    root = head.partition(b"<robot")[2].partition(b">")[0]
    return b" name" in root or b"\nname" in root or b"\tname" in root


def read_robot_list(file: Path) -> tuple[RobotCheck, ...]:
    """Read a list of robots: a JSON array of objects with the fields of `RobotCheck`.

    Paths are relative to the folder of the list.

    Raises:
        ValueError: It is not JSON, or has fields of other names or types.
    """
    try:
        robots = msgspec.json.decode(
            read_file(file, MAX_TEXT_FILE_BYTES), type=tuple[RobotCheck, ...]
        )
    except msgspec.DecodeError as error:
        raise ValueError(f"{file} is not a list of robots: {error}") from error

    def place(path: str) -> str:
        return str(file.parent / path)

    return tuple(
        msgspec.structs.replace(
            robot,
            path=place(robot.path),
            package_paths=tuple(map(place, robot.package_paths)),
            controllers=tuple(map(place, robot.controllers)),
        )
        for robot in robots
    )


def run_checks(
    requests: Sequence[TrialRequest],
    run: Callable[[TrialRequest], TrialResult | int],
    *,
    jobs: int,
    tolerance: float,
    on_row: Callable[[CheckRow], None],
) -> list[CheckRow]:
    """Run trials, several at once, and judge them; rows are in the order of the requests.

    Args:
        requests: Robots and engines.
        run: As `run_trial_process` with a timeout; called in threads.
        jobs: Number of trials at once.
        tolerance: Largest deviation from the command, as a share of it.
        on_row: Called in order, as soon as possible.
    """
    rows = []
    with ThreadPoolExecutor(jobs) as pool:
        outcomes = [pool.submit(run, one) for one in requests]
        try:
            for request, outcome in zip(requests, outcomes, strict=True):
                rows.append(make_row(request, outcome.result(), tolerance))
                on_row(rows[-1])
        finally:
            pool.shutdown(cancel_futures=True)
    return rows


def run_trial_process(request: TrialRequest, timeout_s: float) -> TrialResult | int:
    """Run a trial in a process; return its exit status if it fails, 0 if it takes too long."""
    outcome = run_process(
        TRIAL_COMMAND,
        msgspec.msgpack.encode(request),
        timeout_s=timeout_s,
        environment=SINGLE_THREADED,
    )
    if outcome.is_out_of_time:
        return 0
    if outcome.status:
        return outcome.status
    return msgspec.msgpack.decode(outcome.output, type=TrialResult)


def make_row(request: TrialRequest, outcome: TrialResult | int, tolerance: float) -> CheckRow:
    """Judge an outcome of `run_trial_process`."""
    if isinstance(outcome, int):
        verdict: Verdict = "crashed" if outcome else "timeout"
        reason = f"its process ended with status {outcome}" if outcome else "it takes too long"
        return CheckRow(request.robot, request.engine_label, verdict, TrialResult(), reason)
    verdict, reason = judge(outcome, tolerance)
    return CheckRow(request.robot, request.engine_label, verdict, outcome, reason)


def judge(result: TrialResult, tolerance: float) -> tuple[Verdict, str]:
    """Choose the verdict; a verdict other than ok has a reason.

    Args:
        result: Of a trial that ended.
        tolerance: Largest deviation from the command, as a share of it.
    """
    if result.error:
        return ("crashed" if result.is_fault else "refused"), result.error
    if result.has_diverged:
        return "unstable", "its state is not finite or out of range"
    if result.straight is None or result.turn is None:
        return _judge_undriven(result)
    faults = list(_list_faults(result, result.straight, result.turn, tolerance))
    if not faults:
        return "ok", ""
    reason = ", ".join(faults)
    drives = _is_predicted(result.straight) and _is_predicted(result.turn)
    if _falls_as_predicted(result) or (drives and "rests" not in reason):
        return "predicted", reason
    return "off", reason


def _falls_as_predicted(result: TrialResult) -> bool:
    is_down = result.tilt_rad > MAX_TILT_RAD or result.shift[2] < -MIN_FALL_M
    return is_down and any(remark.startswith(FALLS) for remark in result.remarks)


def _judge_undriven(result: TrialResult) -> tuple[Verdict, str]:
    x, y, z = result.shift
    if max(math.hypot(x, y), -z) > MAX_SHIFT_M or z > MAX_HEIGHT_M:
        return "unstable", f"nothing drives it, and it moves to x {x:.2f}, y {y:.2f}, z {z:.2f} m"
    wheels = next((remark for remark in result.remarks if remark.startswith("no drive")), "")
    if wheels:
        return "no drive", wheels
    if result.tilt_rad > FALLEN_RAD:
        fallen = f"rests tilted by {math.degrees(result.tilt_rad):.0f} degrees"
        return "predicted", f"it falls over, as nothing balances it: {fallen}"
    return "stands", ""


def _list_faults(
    result: TrialResult, straight: DrivenPart, turn: DrivenPart, tolerance: float
) -> Iterator[str]:
    if result.tilt_rad > MAX_TILT_RAD:
        yield f"rests tilted by {math.degrees(result.tilt_rad):.1f} degrees"
    if result.creep_m_s > MAX_CREEP_M_S:
        yield f"moves at {result.creep_m_s * 1e3:.1f} mm/s at rest"
    if (speed := find_ratio(straight, 0)) is not None and abs(speed - 1.0) > tolerance:
        yield f"drives at {speed:.2f} of the command"
    if abs(straight.measured[2] - straight.commanded[2]) > MAX_DRIFT_RAD_S:
        yield f"turns at {straight.measured[2]:.3f} rad/s when it is commanded straight"
    if (rate := find_ratio(turn, 2)) is not None and abs(rate - 1.0) > tolerance:
        yield f"turns at {rate:.2f} of the command"


def find_ratio(part: DrivenPart, axis: int) -> float | None:
    """Find measured / commanded along vx (0), vy (1) or wz (2); None if nothing is commanded."""
    commanded = part.commanded[axis]
    return part.measured[axis] / commanded if commanded else None


def _is_predicted(part: DrivenPart) -> bool:
    """Whether speed and turn are about the predicted ones."""
    if part.predicted is None:
        return False
    scales = (0.2, 0.5)
    return all(
        abs(part.measured[axis] - part.predicted[axis]) <= PREDICTION_TOLERANCE * scale
        for axis, scale in zip((0, 2), scales, strict=True)
    )


def count_verdicts(rows: Iterable[CheckRow]) -> Mapping[str, int]:
    """Count the rows by verdict, in order of first appearance."""
    counts: dict[str, int] = {}
    for row in rows:
        counts[row.verdict] = counts.get(row.verdict, 0) + 1
    return counts
