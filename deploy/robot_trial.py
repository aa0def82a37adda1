"""A robot in a world of its own, without a network: spawn, settle, drive straight, stop, turn.

`python -m zensim.deploy.robot_trial`: a `TrialRequest` on stdin, a `TrialResult` on stdout. The
world is a `zensim.World`, which has the services and drives of a server in lockstep. It needs the
server extra.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.api.api_errors import Error, Timeout
from zensim.api.in_process_world import World
from zensim.api.simulation import fetch_models
from zensim.api.world_host import open_shared_store
from zensim.deploy.robot_checks import DrivenPart, RobotCheck, TrialRequest, TrialResult
from zensim.proto.child_process import STDERR, reserve_stdout
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.exit_codes import format_failure, list_expected_failures
from zensim.proto.messages.drive_messages import COMPATS
from zensim.proto.options.command_options import parse_choice
from zensim.proto.parent_death import die_with_parent
from zensim.proto.rigid_transforms import find_yaw
from zensim.proto.settings.engine_settings import ONE_CELL, EngineKeywords
from zensim.sim_server.description.ground_friction import GroundFriction
from zensim.sim_server.description.motion_prediction import (
    STRAIGHT,
    find_drive_targets,
    find_nominal_twist,
    is_moved_by_twist,
    predict_motion,
    turn_command,
)
from zensim.sim_server.description.pipeline import is_sdf
from zensim.sim_server.description.urdf.independent_reading import (
    find_reading_differences,
    has_other_reader,
)
from zensim.sim_server.world.simulated_world import FROZEN_BY_FAULT, FROZEN_MESSAGE
from zensim.spawner.spawn.description_sources import parse_xacro_arguments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.api.robot import Robot
    from zensim.api.topic import Topic
    from zensim.proto.drives.measured_joints import PlanarTwist
    from zensim.proto.messages.model_messages import Model, ReportEntry, Vec3
    from zensim.proto.messages.telemetry_messages import Event
    from zensim.sim_server.physics.engine import FloatArray

NAME = "robot"
SETTLE_S, DRIVE_S, STOP_S = 2.0, 4.0, 1.0
AT_REST: PlanarTwist[float] = (0.0, 0.0, 0.0)
REST_S = 1.0
"""Counted at the end of settling."""
COUNTED_S = 2.0
"""Counted at the end of each drive."""
REMARK_SUBJECTS = ("driv", "controller ")
"""How subjects of report entries begin that explain how a robot drives."""
REMARK_STATUSES = ("suspicious", "predicted")


def main() -> None:
    """Run one trial; a fault of zensim is a result, too."""
    die_with_parent()
    os.dup2(os.open(os.devnull, os.O_WRONLY), STDERR)
    replies = reserve_stdout()
    request = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=TrialRequest)
    result = run_trial(request)
    with os.fdopen(replies, "wb") as stream:
        stream.write(msgspec.msgpack.encode(result))


def run_trial(request: TrialRequest) -> TrialResult:
    """Read, spawn and drive one robot; an error of any kind is a result."""
    try:
        is_allowed = request.allow_failed_engine
        with open_trial_world(request.engine, allow_failed_engine=is_allowed) as world:
            return _run(request, world)
    except Error as error:
        return TrialResult(error=f"{error.slug}: {error}")
    except list_expected_failures() as error:
        return TrialResult(error=format_failure(error))
    except Exception as error:  # noqa: BLE001  # one robot must not end the checks of others
        return TrialResult(error=f"{type(error).__name__}: {error}", is_fault=True)


def open_trial_world(engine: str, *, allow_failed_engine: bool = False) -> World:
    """Make a world for one robot: ground, no cells.

    Raises:
        Invalid: The engine is unknown, is not installed, or fails its proof.
    """
    chosen: EngineKeywords = {"engine": engine, "allow_failed_engine": allow_failed_engine}
    return World(**(ONE_CELL | chosen))


def _run(request: TrialRequest, world: World) -> TrialResult:
    events = world.events
    robot, model, text = _spawn(request, world)
    rest = drive_robot(world, robot, SETTLE_S, AT_REST)
    result = _describe(request.robot, model, robot.report.entries)
    period_s = world.control_period
    at_rest = measure_rest(rest, period_s)
    result = msgspec.structs.replace(
        result,
        remarks=(*result.remarks, *_compare_readings(text, model)),
        tilt_rad=at_rest.tilt_rad,
        creep_m_s=at_rest.creep_m_s,
        shift=at_rest.shift,
    )
    if model.drive is not None:
        friction = GroundFriction(model, open_shared_store(os.getpid()).vertices)
        straight = drive_robot(world, robot, DRIVE_S, STRAIGHT)
        drive_robot(world, robot, STOP_S, AT_REST)
        command = turn_command(model.drive)
        turn = drive_robot(world, robot, DRIVE_S, command)
        result = msgspec.structs.replace(
            result,
            straight=_make_part(model, measure_twist(straight, period_s), STRAIGHT, friction),
            turn=_make_part(model, measure_twist(turn, period_s), command, friction),
        )
    failures = _list_failures(events)
    return msgspec.structs.replace(
        result,
        has_diverged=any(one.startswith((FROZEN_MESSAGE, FROZEN_BY_FAULT)) for one in failures),
        remarks=(*result.remarks, *failures),
    )


def _list_failures(events: Topic[Event]) -> list[str]:
    """List the warnings on the robot, such as why it was put at rest or frozen."""
    found = []
    with suppress(Timeout):
        while True:
            event = events.read(timeout_s=0.0)
            if event.kind == "warning":
                found.append(event.message)
    return found


def _spawn(request: TrialRequest, world: World) -> tuple[Robot, Model, str]:
    """Spawn the robot of a request; return it, its model, and the text that was parsed."""
    robot = request.robot
    spawned = world.spawn(
        robot.path,
        NAME,
        xacro_args=parse_xacro_arguments(robot.xacro_args),
        package_paths=robot.package_paths,
        controllers=robot.controllers,
        drive=robot.drive,
        dynamics=request.dynamics,
        compat=parse_choice("--compat", request.compat, COMPATS),
        allow_missing=request.allow_missing,
    )
    found = fetch_models(world, (NAME,), wants_descriptions=True)
    entity = found.entities[0]
    return spawned, found.models[entity.model], found.descriptions[entity.description]


def _compare_readings(text: str, model: Model) -> tuple[str, ...]:
    """List where another reader of URDF differs, if it is installed."""
    if is_sdf(text) or not has_other_reader():
        return ()
    return find_reading_differences(text, model)


def drive_robot(
    world: World, robot: Robot, duration_s: float, command: PlanarTwist[float]
) -> FloatArray:
    """Drive for a time; return poses of the root link (n, 7), one per control step.

    Args:
        world: Of the robot.
        robot: With or without a drive.
        duration_s: Simulation time.
        command: Forward and left speed [m/s], turn [rad/s].
    """
    x, y, yaw = command
    if robot.report.drive:
        robot.drive(x, yaw, left=y)
    return np.array([robot.pose for _ in world.steps(seconds=duration_s)])


def _describe(robot: RobotCheck, model: Model, report: Sequence[ReportEntry]) -> TrialResult:
    return TrialResult(
        model=model.name,
        drive=str(model.drive.__struct_config__.tag) if model.drive else "",
        drive_source=_find_drive_source(robot, report) if model.drive else "",
        links=len(model.links),
        mass_kg=model.mass_kg,
        remarks=tuple(
            entry.reason
            for entry in report
            if entry.subject.startswith(REMARK_SUBJECTS) and entry.status in REMARK_STATUSES
        ),
    )


def _find_drive_source(robot: RobotCheck, report: Sequence[ReportEntry]) -> str:
    if robot.drive:
        return "--drive"
    is_controlled = any(
        entry.subject.startswith("controller ") and entry.reason.startswith("drive:")
        for entry in report
    )
    return "controllers" if is_controlled else "plug-in"


@dataclass(frozen=True)
class RestMeasurement:
    """What a robot did while it stood: at the end of it, but for the shift since it was spawned."""

    tilt_rad: float
    creep_m_s: float
    shift: Vec3


def measure_rest(rows: FloatArray, control_s: float) -> RestMeasurement:
    """Measure a robot at rest; arguments as of `measure_twist`."""
    counted = rows[-round(REST_S / control_s) :]
    x, y = counted[-1, 3:5]
    moved = float(np.linalg.norm(counted[-1, :2] - counted[0, :2]))
    dx, dy, dz = (rows[-1, :3] - rows[0, :3]).tolist()
    return RestMeasurement(
        tilt_rad=float(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))),
        creep_m_s=moved / ((len(counted) - 1) * control_s),
        shift=(dx, dy, dz),
    )


def _make_part(
    model: Model, measured: Vec3, command: PlanarTwist[float], friction: GroundFriction
) -> DrivenPart:
    nominal, predicted = command, None
    if not is_moved_by_twist(model):
        nominal = find_nominal_twist(model, find_drive_targets(model, command))
        predicted = _predict(model, command, friction)
    return DrivenPart(nominal if any(nominal) else command, measured, predicted)


def _predict(
    model: Model, command: PlanarTwist[float], friction: GroundFriction
) -> PlanarTwist[float] | None:
    try:
        with np.errstate(all="ignore"):
            motion = predict_motion(model, command, friction)
    except (ArithmeticError, np.linalg.LinAlgError):
        return None
    is_found = motion.ground.rest.is_stable and motion.ground.motion.is_converged
    return motion.twist if is_found else None


def measure_twist(rows: FloatArray, control_s: float) -> Vec3:
    """Measure the mean twist of the root link along its path: vx, vy [m/s], wz [rad/s].

    Args:
        rows: Poses of the root link (n, 7), one per control step; the last `COUNTED_S` count.
        control_s: Time between rows.
    """
    rows = rows[-round(COUNTED_S / control_s) - 1 :]
    qx, qy, qz, qw = rows[:, 3:7].T
    yaw = np.unwrap(find_yaw((qx, qy, qz, qw), ARRAY_MATH))
    middle = (yaw[1:] + yaw[:-1]) / 2.0
    dx, dy = np.diff(rows[:, 0]), np.diff(rows[:, 1])
    duration_s = len(dx) * control_s
    return (
        float((dx * np.cos(middle) + dy * np.sin(middle)).sum()) / duration_s,
        float((dy * np.cos(middle) - dx * np.sin(middle)).sum()) / duration_s,
        float(yaw[-1] - yaw[0]) / duration_s,
    )


if __name__ == "__main__":
    main()
