"""Runs a scenario on a simulation: behaviours, faults and checks at each control step."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, cast

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Timeout
from zensim.api.closed_on_exit import ClosedOnExit
from zensim.api.fleet import Fleet
from zensim.api.simulation import Simulation, fetch_models
from zensim.api.topic import find_stamp_ns
from zensim.proto.messages.entity_messages import (
    GetEntityBoundsOrder,
    GetEntityInfoRequest,
    SetEntityInfoRequest,
)
from zensim.proto.messages.gazebo_messages import ApplyLinkWrenchRequest
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration, Vector3, Wrench
from zensim.proto.se3 import FloatArray
from zensim.proto.service_catalog import (
    APPLY_LINK_WRENCH,
    GET_ENTITY_BOUNDS,
    GET_ENTITY_INFO,
    SET_ENTITY_INFO,
)
from zensim.scenario.check_monitors import (
    CheckedState,
    CheckMonitor,
    CheckResult,
    Margin,
    MessageCount,
    Outline,
    ScenarioEvent,
    WorldOutlines,
    make_monitor,
    make_outline,
    make_rate_margin,
)
from zensim.scenario.fault_sections import (
    AGENT_FAULTS,
    CommandDelay,
    CommandLoss,
    CommandScale,
    CommandStuck,
    Fault,
    Kidnap,
    Push,
)
from zensim.scenario.robot_behaviours import (
    FleetState,
    PythonController,
    ScheduledMotion,
    load_class,
    make_motions,
)
from zensim.scenario.robot_places import ScenarioRobot
from zensim.scenario.run_host import RunHost
from zensim.scenario.scenario_faults import CommandFaults, FaultRun, FaultSchedule
from zensim.scenario.scenario_format import (
    Check,
    CheckOfRobots,
    NoCollisionCheck,
    PythonBehaviour,
    PythonCheck,
    RateCheck,
    RobotsSection,
)
from zensim.scenario.scenario_reader import Scenario
from zensim.scenario.scenario_recording import ScenarioRecording, find_recording
from zensim.scenario.wall_outlines import Wall, find_walls

if TYPE_CHECKING:
    from zensim.api.spawning import FleetKeywords, SpawnKeywords
    from zensim.proto.messages.model_messages import Dynamics

OF_COMMANDS = (*AGENT_FAULTS, CommandLoss, CommandDelay, CommandStuck, CommandScale)
"""Faults that the runner applies to the commands of behaviours."""
VALUE_KEYS = ("factor", "every_nth", "delay", "share", "deviation", "bias")
"""Keys of faults of which one is the value of a request."""
LOW_M, HIGH_M = 0.02, 1.0
"""Heights between which the world's own entities count as walls."""
DEFAULT_END_S = 10.0
"""Simulated length of a run that says nothing of its end."""


class ScenarioFailed(RuntimeError):
    """A scenario that cannot run: its code raised, or the world refused a part of it."""


class RunReport(msgspec.Struct, frozen=True):
    """What became of one run."""

    name: str
    file: str
    seed: int
    sha256: str
    """Hash of all values of the scenario."""
    checks: tuple[CheckResult, ...] = ()
    events: tuple[ScenarioEvent, ...] = ()
    state_hash: str = ""
    """Hash of the last state; equal runs have equal hashes."""
    sim_time: float = 0.0
    wall_time_s: float = 0.0
    robots: int = 0
    version: str = ""
    error: str = ""
    """Why it did not run to its end; empty if it did."""
    repeat: str = ""
    """Command that repeats the run."""
    recording: str = ""
    """File or folder of its recording, if there is one."""
    cpu_s: float = 0.0
    """CPU time of its process, with reading the file."""
    host: RunHost = RunHost()

    @property
    def is_passed(self) -> bool:
        """Whether it ran to its end and no check failed."""
        return not self.error and not any(check.is_failure for check in self.checks)


@dataclass
class ScenarioRun(ClosedOnExit):
    """A scenario on a simulation.

    Attributes:
        commands: Last commanded speed and turn of each robot, (n, 2).
        driven: Robots that a behaviour has driven, (n,).
        owns_world: Whether `close` closes the world.
    """

    scenario: Scenario
    sim: Simulation
    allows_python: bool = True
    owns_world: bool = False
    events: list[ScenarioEvent] = field(default_factory=list)
    fleet: Fleet = field(init=False)
    motions: list[ScheduledMotion] = field(init=False)
    faults: FaultSchedule = field(init=False)
    monitors: list[CheckMonitor] = field(init=False)
    recording: ScenarioRecording | None = field(init=False, default=None)
    commands: FloatArray = field(init=False)
    driven: npt.NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        """Prepare everything but the robots."""
        scenario = self.scenario
        self.faults = FaultSchedule(scenario)
        self._command_faults = CommandFaults(scenario)
        self._acting: set[str] = set()
        self._counts: dict[str, list[MessageCount]] = {}
        self._before: CheckedState | None = None
        self.commands = np.zeros((len(scenario.robots), 2))
        self.driven = np.zeros(len(scenario.robots), dtype=bool)
        self._taken = np.zeros(len(scenario.robots), dtype=bool)
        self._held = np.zeros(len(scenario.robots), dtype=bool)

    def spawn(self) -> None:
        """Spawn the robots, and make behaviours and checks; the recording begins before."""
        if (path := find_recording(self.scenario)) is not None:
            self.recording = ScenarioRecording(self.scenario, self.sim, path)
        with self._ended_by_errors():
            self._spawn_all()

    def _spawn_all(self) -> None:
        for index, group in enumerate(self.scenario.format.robots):
            _spawn_group(self.sim, self.scenario, index, group)
        self.fleet = self.sim.fleet(self.scenario.robot_names)
        self.motions = make_motions(self.scenario, self._make_controller, self._cast_rays)
        self._updated = self._make_monitors()
        made = {monitor.check.name: monitor for monitor in self._updated}
        self.monitors = [made[check.name] for check in self.scenario.format.checks]
        self._start_time = self.sim.time
        self._start_wall_s = time.monotonic()

    def run(self, end: float | None = None) -> RunReport:
        """Run to the end of the scenario, and report.

        Args:
            end: Most simulated seconds; None = as the file says, or 10 s.
        """
        seconds = find_end(self.scenario) if end is None else end
        with self._ended_by_errors():
            self._step_until(seconds)
        self.end_recording(is_passed=self.report().is_passed)
        return self.report()

    def _step_until(self, seconds: float) -> None:
        for _ in self.sim.steps(seconds=seconds if math.isfinite(seconds) else None):
            if self.is_over(self.step()):
                return
        self.check_now()

    def close(self) -> None:
        """End the recording, and close the world, if it belongs to this run."""
        if self.recording is not None and hasattr(self, "monitors"):
            self.end_recording(is_passed=self.report().is_passed)
        if self.owns_world:
            self.sim.close()

    def end_recording(self, *, is_passed: bool) -> None:
        """End the recording, if there is one; may be repeated."""
        if self.recording is not None:
            self.recording.end(is_passed=is_passed)

    @contextmanager
    def _ended_by_errors(self) -> Iterator[None]:
        """End the recording after an error, which is what it is for."""
        try:
            yield
        except BaseException:
            self.end_recording(is_passed=False)
            raise

    def step(self) -> CheckedState:
        """Do all that is due at the present control step, before time advances."""
        fleet_state = self._observe()
        events = [event for run, event in self._apply_faults(fleet_state)]
        events += self._update_behaviours(fleet_state)
        self.events += events
        state = self._check(fleet_state, tuple(events))
        self._drive(fleet_state)
        return state

    def leave(self, names: Iterable[str]) -> None:
        """Leave robots to others that command them, except those of behaviours that hold them."""
        row = {name: number for number, name in enumerate(self.scenario.robot_names)}
        rows = [row[name] for name in names if name in row and not self._taken[row[name]]]
        if rows:
            self._taken[rows] = True
            self.fleet[self._taken & ~self._held].release()

    def check_now(self) -> CheckedState:
        """Look at the present state with all checks, as after the last step."""
        return self._check(self._observe(), ())

    def is_over(self, state: FleetState) -> bool:
        """Whether `end` says that the run is over before its time."""
        end = self.scenario.format.end
        if end.on_failure == "stop" and any(
            one.has_failed(state.now) for one in self.monitors if one.check.severity == "fail"
        ):
            return True
        if end.when is None:
            return False
        passed = {one.check.name for one in self.monitors if one.has_passed(state.now)}
        is_one = bool(passed.intersection(end.when.any))
        return is_one or bool(end.when.all and passed.issuperset(end.when.all))

    def report(self, *, repeat: str = "", error: str = "") -> RunReport:
        """Sum up the run."""
        scenario = self.scenario
        return RunReport(
            scenario.name,
            scenario.file,
            scenario.seed,
            scenario.sha256,
            tuple(monitor.report() for monitor in self.monitors),
            tuple(self.events),
            self.sim.state_hash(),
            self.sim.time - self._start_time,
            time.monotonic() - self._start_wall_s,
            len(scenario.robots),
            version("zensim"),
            error or (self.recording.failure if self.recording is not None else ""),
            repeat,
            self.recording.kept if self.recording is not None else "",
        )

    def _observe(self) -> FleetState:
        poses = self.fleet.poses()
        self._orientations = poses[:, 3:7]
        return FleetState(
            self.sim.time - self._start_time,
            self.sim.control_period,
            self.fleet.poses2d(),
            self.fleet.twists(),
        )

    def _check(self, state: FleetState, events: tuple[ScenarioEvent, ...]) -> CheckedState:
        wall_s = max(time.monotonic() - self._start_wall_s, 1e-9)
        before = self._before
        checked = CheckedState(
            state.now,
            state.period,
            state.poses,
            state.twists,
            self._orientations,
            state.now / wall_s if state.now >= 1.0 else math.inf,
            events,
            self.faults.active | self._acting,
            None if before is None else _forget_before(before),
        )
        for monitor in self._updated:
            monitor.update(checked)
        self._before = checked
        return checked

    def _apply_faults(self, state: FleetState) -> list[tuple[FaultRun, ScenarioEvent]]:
        changes = self.faults.update(state)
        for run, event in changes:
            for row, fault in zip(run.rows, run.own, strict=True):
                robot = self.scenario.robots[row].name
                if event.kind == "start":
                    self._start_fault(robot, fault, int(row))
        return changes

    def _start_fault(self, robot: str, fault: Fault, row: int) -> None:
        """Start a fault that the server applies, and ends by itself."""
        if isinstance(fault, Push):
            self._push(robot, fault)
        elif isinstance(fault, Kidnap):
            self.sim.robots[robot].set_pose(fault.x, fault.y, yaw=fault.yaw)
        elif not isinstance(fault, OF_COMMANDS):
            inject_fault(self.sim, robot, fault, self.scenario.seed + row)

    def _push(self, robot: str, fault: Push) -> None:
        link = fault.link or self._find_root_link(robot)
        request = ApplyLinkWrenchRequest(
            link_name=f"{robot}::{link}",
            wrench=Wrench(force=Vector3(fault.x, fault.y, fault.z)),
            duration=_make_duration(fault),
        )
        self.sim.call(APPLY_LINK_WRENCH, request)

    def _update_behaviours(self, state: FleetState) -> list[ScenarioEvent]:
        events = []
        for one in self.motions:
            is_active = one.is_active(state.now)
            if is_active != (one.name in self._acting):
                (self._acting.add if is_active else self._acting.discard)(one.name)
                kind = "start" if is_active else "end"
                events.append(ScenarioEvent(state.now, one.name, kind))  # type: ignore[arg-type]
        return events

    def _drive(self, state: FleetState) -> None:
        self.commands = np.zeros_like(self.commands)
        for one in self.motions:
            if one.is_active(state.now):
                self.driven[one.rows] = True
                self._held[one.rows] = one.holds
                self.commands[one.rows] = one.motion.command(state)
        sent = self._command_faults.apply(state.now, self.commands, self.faults.runs)
        ours = self.driven & ~(self._taken & ~self._held)
        if ours.all():
            self.fleet.drive(v=sent[:, 0], w=sent[:, 1])
        elif ours.any():
            self.fleet[ours].drive(v=sent[ours, 0], w=sent[ours, 1])

    def _make_controller(
        self, behaviour: PythonBehaviour, names: Sequence[str]
    ) -> PythonController:
        made = self._load(behaviour.call)(self.sim, list(names), **behaviour.args)
        return cast("PythonController", made)

    def _cast_rays(
        self, origins: FloatArray, directions: FloatArray, range_max: float
    ) -> FloatArray:
        return self.sim.cast_rays(origins, directions, range_max=range_max)[0]

    def _load(self, call: str) -> Callable[..., object]:
        if not self.allows_python:
            raise ScenarioFailed(f"`{call}` is code of the file; it was started without `python`")
        return load_class(call, Path(self.scenario.file).parent)

    def _make_monitors(self) -> list[CheckMonitor]:
        """Make the monitors in the order of their updates: what combines others is after them."""
        scenario, made = self.scenario, dict[str, CheckMonitor]()
        row = {name: number for number, name in enumerate(scenario.robot_names)}
        numbered = {check.name: (at, check) for at, check in enumerate(scenario.format.checks)}
        parts = {name: getattr(check, "checks", ()) for name, (_, check) in numbered.items()}
        has_outlines = any(isinstance(one, NoCollisionCheck) for one in scenario.format.checks)
        outlines = WorldOutlines()
        if has_outlines:
            outlines = WorldOutlines(self._find_outlines(), self._find_walls())
        for index, check in map(numbered.__getitem__, TopologicalSorter(parts).static_order()):
            selector = check.robots if isinstance(check, CheckOfRobots) else "*"
            robots = scenario.select(selector) if scenario.robots else []
            place = scenario.find_place(f"checks[{index}]")
            shown = f"{place.file}:{place.line}"
            own = self._make_own_margin(check, robots)
            if own is not None:
                made[check.name] = CheckMonitor(check, own, [""], shown)
                continue
            made[check.name] = make_monitor(
                check,
                robots,
                rows=np.array([row[name] for name in robots], dtype=np.intp),
                place=shown,
                outlines=outlines,
                others=made,
            )
        return list(made.values())

    def _make_own_margin(self, check: Check, robots: Sequence[str]) -> Margin | None:
        """Make the margin of a check that needs more than states."""
        if isinstance(check, PythonCheck):
            return self._make_python_margin(check, robots)
        return self._make_rate_margin(check) if isinstance(check, RateCheck) else None

    def _make_rate_margin(self, check: RateCheck) -> Margin:
        count = MessageCount()
        margin = make_rate_margin(check, count)
        self._counts.setdefault(check.topic, []).append(count)

        def take_and_judge(state: CheckedState) -> FloatArray:
            self._count_messages(check.topic)
            return margin(state)

        self._start_time = self.sim.time
        self._count_messages(check.topic)
        return take_and_judge

    def _count_messages(self, key: str) -> None:
        """Count the messages of a topic since the last call, for all checks of it.

        Not by a callback: its thread would act on a world in process between two steps.
        """
        topic = self.sim.topic(key)
        with suppress(Timeout):
            while True:
                stamp_ns = find_stamp_ns(topic.read(timeout_s=0.0))
                time_s = stamp_ns / NANOSECONDS if stamp_ns else self.sim.time
                for count in self._counts[key]:
                    count.note(time_s - self._start_time)

    def _find_walls(self) -> list[Wall]:
        models = fetch_models(self.sim)
        return find_walls(models, LOW_M, HIGH_M)

    def _make_python_margin(self, check: PythonCheck, robots: Sequence[str]) -> Margin:
        made = self._load(check.call)(list(robots), **check.args)
        update: Callable[[float, CheckedState], float] = getattr(made, "update")  # noqa: B009  of the author's class
        return lambda state: np.array([float(update(state.now, state))])

    def _find_outlines(self) -> dict[str, Outline]:
        """Find the outline of each robot; those of a group are alike."""
        groups: dict[int, Outline] = {}
        for robot in self.scenario.robots:
            if robot.group not in groups:
                found = self.sim.call(GET_ENTITY_BOUNDS, GetEntityBoundsOrder(robot.name))
                points = [(one.x, one.y) for one in found.bounds.points]
                groups[robot.group] = make_outline(points)
        return {robot.name: groups[robot.group] for robot in self.scenario.robots}

    def _find_root_link(self, robot: str) -> str:
        found = fetch_models(self.sim, (robot,))
        return found.models[found.entities[0].model].links[0].name


def _make_duration(fault: Fault) -> Duration:
    """Make the length of a fault; negative = to the end."""
    length = -1.0 if fault.duration is None else fault.duration
    return Duration(*divmod(round(length * NANOSECONDS), NANOSECONDS))


def inject_fault(sim: Simulation, robot: str, fault: Fault, seed: int) -> None:
    """Start a fault of a body or a sensor, which ends by itself."""
    parts = (getattr(fault, key, "") for key in ("joint", "link", "sensor"))
    numbers = (getattr(fault, key, None) for key in VALUE_KEYS)
    sim.inject(
        robot,
        str(type(fault).__struct_config__.tag),  # type: ignore[arg-type]  # of such a fault
        next(filter(None, parts)),
        value=float(next((one for one in numbers if one is not None), 0.0)),
        low=getattr(fault, "low", 0.0),
        high=getattr(fault, "high", 0.0),
        seconds=fault.duration,
        seed=seed,
    )


def _forget_before(state: CheckedState) -> CheckedState:
    """Cut the chain of earlier states."""
    return CheckedState(state.now, state.period, state.poses, state.twists, state.orientations)


def _spawn_group(sim: Simulation, scenario: Scenario, index: int, group: RobotsSection) -> None:
    robots = [robot for robot in scenario.robots if robot.group == index]
    file = scenario.find_file(f"robots[{index}].model", group.model)
    model = str(file) if file.is_file() else group.model
    agent = "external" if group.agent == "none" else ""
    # "full" is the default of every world; naming it would forbid what a model asks for.
    dynamics: Dynamics = (
        "" if scenario.format.engine.dynamics == "full" else (scenario.format.engine.dynamics)
    )
    names = [f"{group.name}{number}" for number in range(len(robots))]
    is_plain = all(one.z is None and one.roll == one.pitch == 0.0 for one in robots)
    controllers = [
        scenario.find_file(f"robots[{index}].controllers", one) for one in group.controllers
    ]
    described: dict[str, object] = {
        "xacro_args": group.xacro,
        "package_paths": [
            scenario.find_file(f"robots[{index}].package_paths", one) for one in group.package_paths
        ],
        "controllers": controllers,
        "drive": group.drive,
        "dynamics": dynamics,
        "compat": group.compat,
        "strict": group.strict,
        "allow_missing": group.allow_missing,
        "agent": agent,
    }
    if is_plain and len(robots) > 1 and [one.name for one in robots] == names:
        poses = [(one.x, one.y, one.yaw) for one in robots]
        options = cast("FleetKeywords", {**described, "poses": poses, "prefix": group.name})
        sim.spawn_fleet(model, **options)
    else:
        for one in robots:
            own = cast("SpawnKeywords", {**described, "namespace": group.namespace})
            _spawn_alone(sim, model, one, own)
    if group.tags:
        for one in robots:
            _add_tags(sim, one.name, group.tags)


def _add_tags(sim: Simulation, robot: str, tags: tuple[str, ...]) -> None:
    info = sim.call(GET_ENTITY_INFO, GetEntityInfoRequest(robot)).info
    info = msgspec.structs.replace(info, tags=(*info.tags, *tags))
    sim.call(SET_ENTITY_INFO, SetEntityInfoRequest(robot, info))


def _spawn_alone(
    sim: Simulation, model: str, robot: ScenarioRobot, options: "SpawnKeywords"
) -> None:
    options["x"], options["y"] = robot.x, robot.y
    options["roll"], options["pitch"], options["yaw"] = robot.roll, robot.pitch, robot.yaw
    if robot.z is not None:
        options["z"] = robot.z
    sim.spawn(model, robot.name, **options)


def find_end(scenario: Scenario, default: float = DEFAULT_END_S) -> float:
    """Find the simulated length of a run [s]."""
    at = scenario.format.end.at
    return default if at is None else at


def run_scenario(
    scenario: Scenario, sim: Simulation, *, allows_python: bool = True, repeat: str = ""
) -> RunReport:
    """Run a scenario to its end.

    Raises:
        ScenarioFailed: Its code raised.
        Error: The world refused a part of it.
    """
    run = ScenarioRun(scenario, sim, allows_python=allows_python)
    run.spawn()
    run.run()
    return run.report(repeat=repeat)
