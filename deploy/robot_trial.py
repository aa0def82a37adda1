"""A robot in a world of its own, without a network: spawn, settle, drive straight, stop, turn.

`python -m zensim.deploy.robot_trial`: a `TrialRequest` on stdin, a `TrialResult` on stdout. World,
spawn handler and drive controller are those of server and agent, in lockstep. It needs the
server extra.
"""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.deploy.robot_checks import DrivenPart, RobotCheck, TrialRequest, TrialResult
from zensim.proto.child_process import STDERR, reserve_stdout
from zensim.proto.cli_options import parse_choice
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.exit_codes import format_failure, list_expected_failures
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.process_limits import die_with_parent
from zensim.proto.rigid_transforms import find_yaw
from zensim.robot_agent.base_controller import BaseController
from zensim.robot_agent.drive_state_decoder import DriveStateLayout
from zensim.sim_server.description.ground_friction import GroundFriction
from zensim.sim_server.description.motion_prediction import (
    STRAIGHT,
    find_drive_targets,
    find_nominal_twist,
    is_moved_by_twist,
    predict_motion,
    turn_command,
)
from zensim.sim_server.description.pipeline import is_sdf, parse_description
from zensim.sim_server.description.urdf.independent_reading import find_reading_differences
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import SimError
from zensim.sim_server.initial_world import load_initial_world, make_initial_world
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.physics.engine_config import EngineOptions, parse_engine_name
from zensim.sim_server.server_config import ServerConfig, validate_config
from zensim.sim_server.service_parts import (
    Bonds,
    CurrentWorld,
    Descriptions,
    Pacing,
    Spawning,
)
from zensim.sim_server.services.spawn_services import spawn_entity
from zensim.spawner.cli.spawn_arguments import COMPATS
from zensim.spawner.spawn.description_sources import parse_xacro_arguments, read_model_argument
from zensim.spawner.spawn.search_paths import collect_search_paths
from zensim.spawner.spawn.spawn_client import SpawnPayload, make_payload

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.proto.drives.measured_joints import PlanarTwist
    from zensim.proto.messages.model_messages import Model, ReportEntry, Vec3
    from zensim.sim_server.parser_process.description_cache import ParseKey
    from zensim.sim_server.parser_process.parser_protocol import ParseRequest, ParseResult
    from zensim.sim_server.physics.engine import FloatArray
    from zensim.sim_server.world.simulated_world import SimulatedWorld

NAME = "robot"
AGENT = "check"
SETTLE_S, DRIVE_S, STOP_S = 2.0, 4.0, 1.0
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
        with ExitStack() as cleanup:
            return _run(request, cleanup)
    except SimError as error:
        return TrialResult(error=str(error))
    except list_expected_failures() as error:
        return TrialResult(error=format_failure(error))
    except Exception as error:  # noqa: BLE001  # one robot must not end the checks of others
        return TrialResult(error=f"{type(error).__name__}: {error}", is_fault=True)


def _run(request: TrialRequest, cleanup: ExitStack) -> TrialResult:
    store = AssetStore()
    cleanup.callback(store.close)
    payload, model = _read_model(request, store)
    world = make_trial_world(EngineOptions(engine=parse_engine_name(request.engine)), store)
    cleanup.callback(world.close)
    report = spawn_on_ground(world, store, model, payload.text)
    trial = LockstepTrial(world)
    rest = trial.drive(SETTLE_S, STRAIGHT, share=0.0)
    result = _describe(request.robot, model, (*model.report, *report))
    result = msgspec.structs.replace(
        result, remarks=(*result.remarks, *_compare_readings(payload.text, model))
    )
    at_rest = measure_rest(rest, trial.control_s)
    result = msgspec.structs.replace(
        result, tilt_rad=at_rest.tilt_rad, creep_m_s=at_rest.creep_m_s, shift=at_rest.shift
    )
    if model.drive is not None:
        friction = GroundFriction(model, store.vertices)
        straight = trial.drive(DRIVE_S, STRAIGHT)
        trial.drive(STOP_S, STRAIGHT, share=0.0)
        command = turn_command(model.drive)
        turn = trial.drive(DRIVE_S, command)
        result = msgspec.structs.replace(
            result,
            straight=_make_part(trial, straight, STRAIGHT, friction),
            turn=_make_part(trial, turn, command, friction),
        )
    return msgspec.structs.replace(
        result,
        has_diverged=world.divergence_guard.is_frozen(NAME),
        remarks=(*result.remarks, *_list_failures(world)),
    )


def _list_failures(world: SimulatedWorld) -> list[str]:
    """List the warnings on the robot, such as why it was put at rest or frozen."""
    return [event.message for event in world.clock.take_events() if event.kind == "warning"]


def _read_model(request: TrialRequest, store: AssetStore) -> tuple[SpawnPayload, Model]:
    """Read the description as `zensim spawn` and the server's parser process do."""
    robot = request.robot
    paths = collect_search_paths([Path(one) for one in robot.package_paths], os.environ)
    arguments = parse_xacro_arguments(robot.xacro_args)
    description = read_model_argument(robot.path, arguments, paths)
    payload = make_payload(
        description,
        paths,
        allow_missing=request.allow_missing,
        controllers=[Path(one) for one in robot.controllers],
    )
    files = {file.sha256: file.path.read_bytes() for file in payload.bundle.files}
    parsed = parse_description(
        payload.text,
        assets={ref.uri: (ref.sha256, files[ref.sha256]) for ref in payload.bundle.refs},
        allow_missing=request.allow_missing,
        compat=parse_choice("--compat", request.compat, COMPATS),
        controllers=payload.controllers.texts,
        drive=parse_drive_order(robot.drive),
    )
    for sha256, data in parsed.meshes.items():
        store.add(sha256, data)
    return payload, msgspec.structs.replace(parsed.model, dynamics=request.dynamics)


def _compare_readings(text: str, model: Model) -> tuple[str, ...]:
    """List where another reader of URDF differs."""
    if is_sdf(text):
        return ()
    return find_reading_differences(text, model)


def make_trial_world(options: EngineOptions, store: AssetStore) -> SimulatedWorld:
    """Make a world for one robot: ground, no cells and no workers."""
    physics = msgspec.structs.replace(options, clusters="off", workers=0)
    config = validate_config(ServerConfig(physics=physics))
    loaded, config = load_initial_world(config, None)
    return make_initial_world(config, loaded, store)


@dataclass(frozen=True)
class ParsedDescription:
    """A provider of one model that is parsed."""

    parsed: Model
    text: str

    def is_parsed(self, order: SpawnEntityOrder) -> bool:  # noqa: ARG002
        """See `DescriptionProvider`."""
        return True

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:  # noqa: ARG002
        """See `DescriptionProvider`."""
        return self.parsed, self.text

    def poll(self) -> bool:
        """See `DescriptionProvider`."""
        return False

    def find_parse_key(self, model: Model) -> ParseKey | None:  # noqa: ARG002
        """See `DescriptionProvider`."""
        return None

    def remember(self, key: ParseKey, model: Model) -> None:
        """See `DescriptionProvider`."""

    def parse(self, request: ParseRequest, on_parsed: Callable[[ParseResult], None]) -> None:
        """See `DescriptionProvider`."""


def spawn_on_ground(
    world: SimulatedWorld, store: AssetStore, model: Model, text: str
) -> tuple[ReportEntry, ...]:
    """Spawn a model, read from a text, on the ground with the server's handler."""
    while not world.prepare(model):
        pass
    spawning = Spawning(
        world,
        Descriptions(ParsedDescription(model, text), store),
        Bonds(world),
        Pacing(lambda: 0, LoopStats(0)),
        CurrentWorld(WorldModel("empty")),
    )
    order = SpawnEntityOrder(
        NAME, entity_resource=Resource(resource_string=text), snap_to_ground=True
    )
    return spawn_entity(spawning, order).report


class LockstepTrial:
    """The only robot of a world and its drive controller, stepped together."""

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self.model = world.entities.find(NAME).model
        self._controller: BaseController | None = None
        if self.model.drive is not None:
            world.claim(AGENT, (NAME,), "stop")
            self._controller = BaseController(self.model)
        self._layout = DriveStateLayout([len(self.model.joints)])
        self.control_s = world.clock.step_ns * world.control_steps * 1e-9

    def drive(
        self, duration_s: float, command: PlanarTwist[float], share: float = 1.0
    ) -> FloatArray:
        """Drive for a time; return root states (n, 13), one per control step.

        Args:
            duration_s: Simulation time.
            command: Forward and left speed [m/s], turn [rad/s].
            share: Of the command; 0 = stop.
        """
        x, y, yaw = (share * one for one in command)
        twist = Twist(Vector3(x, y), Vector3(0.0, 0.0, yaw))
        rows = []
        for _ in range(round(duration_s / self.control_s)):
            rows.append(self._world.state_of(NAME).copy())
            self._command(twist)
            for _ in range(self._world.control_steps):
                self._world.step()
        return np.array(rows)

    def _command(self, twist: Twist) -> None:
        if self._controller is None:
            return
        for agent, state in self._world.drive_states():
            # Without claims when the robot was frozen.
            for own in self._layout.split(state) if state.claims else ():
                self._controller.update(own, twist)
                targets = np.array(self._controller.targets).tobytes()
                self._world.command(
                    agent, DriveCommand(state.epoch, state.step, state.claims, targets)
                )


def _describe(robot: RobotCheck, model: Model, report: Sequence[ReportEntry]) -> TrialResult:
    has_drive = model.drive is not None
    return TrialResult(
        model=model.name,
        drive=str(model.drive.__struct_config__.tag) if model.drive else "",
        drive_source=_find_drive_source(robot, report) if has_drive else "",
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
    trial: LockstepTrial, rows: FloatArray, command: PlanarTwist[float], friction: GroundFriction
) -> DrivenPart:
    model = trial.model
    measured = measure_twist(rows, trial.control_s)
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
        rows: Root states (n, 13), one per control step; the last `COUNTED_S` count.
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
