"""Faults: when each starts and ends, and what it does to commands; no clock, no network."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray
from zensim.scenario.check_monitors import ScenarioEvent
from zensim.scenario.fault_sections import (
    AGENT_FAULTS,
    AgentHang,
    AgentKill,
    AgentSlow,
    CommandDelay,
    CommandLoss,
    CommandScale,
    CommandStuck,
    Fault,
    Kidnap,
)
from zensim.scenario.quantities import make_uniforms
from zensim.scenario.robot_behaviours import FleetState
from zensim.scenario.scenario_reader import Scenario

TIME_TOLERANCE_S = 1e-6
HISTORY_S = 60.0
"""Commands that a delay can go back."""


@dataclass
class FaultRun:
    """One fault, with its robots and its state.

    Attributes:
        rows: Of its robots among those of the scenario, (m,).
        own: The fault with the draws of each robot, (m,).
    """

    fault: Fault
    rows: npt.NDArray[np.intp]
    own: Sequence[Fault]
    near: tuple[int, int] | None
    due: float = 0.0
    started: float = math.nan
    count: int = 0
    is_active: bool = False
    held: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def is_instant(self) -> bool:
        """Whether it ends at the step at which it starts."""
        return isinstance(self.fault, Kidnap)


class FaultSchedule:
    """All faults of a run, step by step."""

    def __init__(self, scenario: Scenario) -> None:
        self.runs = [_make_run(scenario, index) for index in range(len(scenario.format.faults))]
        self._scenario = scenario

    @property
    def active(self) -> frozenset[str]:
        """Names of the faults that act."""
        return frozenset(run.fault.name for run in self.runs if run.is_active)

    def update(self, state: FleetState) -> list[tuple[FaultRun, ScenarioEvent]]:
        """Start and end what is due at a control step; ends come first."""
        changes = []
        for run in self.runs:
            if run.is_active and self._is_over(run, state.now):
                run.is_active = False
                changes.append((run, ScenarioEvent(state.now, run.fault.name, "end")))
        for run in self.runs:
            if not run.is_active and self._starts(run, state):
                run.started, run.is_active = state.now, not run.is_instant
                changes.append((run, ScenarioEvent(state.now, run.fault.name, "start")))
                if run.is_instant:
                    changes.append((run, ScenarioEvent(state.now, run.fault.name, "end")))
        return changes

    def _is_over(self, run: FaultRun, now: float) -> bool:
        length = run.fault.duration
        return length is not None and now >= run.started + length - TIME_TOLERANCE_S

    def _starts(self, run: FaultRun, state: FleetState) -> bool:
        if state.now < run.due - TIME_TOLERANCE_S or not _is_true(run, state):
            return False
        every = run.fault.every
        run.due = math.inf if every is None else max(run.due, 0.0) + every
        if run.fault.when is not None and every is not None:
            run.due = state.now + every
        run.count += 1
        key = ("faults", run.fault.name, "start", str(run.count))
        return make_uniforms(self._scenario.seed, *key)[0] < run.fault.probability


def _is_true(run: FaultRun, state: FleetState) -> bool:
    when = run.fault.when
    if when is None or run.near is None:
        return True
    first, second = run.near
    gap = state.poses[first, :2] - state.poses[second, :2]
    return bool(np.hypot(*gap) < when.below)


def _make_run(scenario: Scenario, index: int) -> FaultRun:
    fault = scenario.format.faults[index]
    every = scenario.robot_names
    names = _list_robots(scenario, fault)
    when = fault.when
    near = None if when is None else (every.index(when.near[0]), every.index(when.near[1]))
    return FaultRun(
        fault,
        np.array([every.index(name) for name in names], dtype=np.intp),
        [scenario.resolve_fault(index, name) for name in names],
        near,
        due=fault.at or 0.0,
    )


def _list_robots(scenario: Scenario, fault: Fault) -> list[str]:
    if isinstance(fault, AGENT_FAULTS):
        agents = {one.name: one.drives for one in scenario.format.agents}
        return scenario.select(agents.get(fault.agent, "*"))
    return scenario.select(fault.robots)


class CommandFaults:
    """What faults of agents and commands make of the commands of behaviours."""

    def __init__(self, scenario: Scenario) -> None:
        self._seed = scenario.seed
        self._names = scenario.robot_names
        self._sent = np.zeros((len(self._names), 2))
        self._history: deque[tuple[float, FloatArray]] = deque()
        self._step = 0

    def apply(self, now: float, commands: FloatArray, runs: Sequence[FaultRun]) -> FloatArray:
        """Find what reaches the robots at a control step.

        Args:
            now: Simulated seconds.
            commands: Of the behaviours: speed, turn of each robot, (n, 2).
            runs: All faults.
        """
        self._history.append((now, commands.copy()))
        while now - self._history[0][0] > HISTORY_S:
            self._history.popleft()
        found = commands.copy()
        for run in runs:
            change = _CHANGES.get(type(run.fault))
            if run.is_active and change is not None:
                found[run.rows] = change(self, run, now, found[run.rows])
        self._step += 1
        self._sent = found
        return np.asarray(found)

    def scale(self, run: FaultRun, _now: float, commands: FloatArray) -> FloatArray:
        """Multiply."""
        factors = [one.factor for one in run.own if isinstance(one, CommandScale)]
        return np.asarray(commands * np.array(factors)[:, None])

    def hold(self, run: FaultRun, _now: float, _commands: FloatArray) -> FloatArray:
        """Repeat what was sent last."""
        return np.asarray(self._sent[run.rows], dtype=np.float64)

    def stop(self, _run: FaultRun, _now: float, commands: FloatArray) -> FloatArray:
        """Send no speed: the drive stops the robot."""
        return np.zeros_like(commands)

    def lose(self, run: FaultRun, _now: float, commands: FloatArray) -> FloatArray:
        """Repeat what was sent last for the robots whose command is lost."""
        key, step = ("faults", run.fault.name), str(self._step)
        lost = [
            make_uniforms(self._seed, *key, self._names[row], step)[0] < one.share
            for row, one in zip(run.rows, run.own, strict=True)
            if isinstance(one, CommandLoss)
        ]
        return np.asarray(np.where(np.array(lost)[:, None], self._sent[run.rows], commands))

    def delay(self, run: FaultRun, now: float, commands: FloatArray) -> FloatArray:
        """Send the commands of an earlier step."""
        found = commands.copy()
        for number, (row, one) in enumerate(zip(run.rows, run.own, strict=True)):
            if isinstance(one, CommandDelay):
                found[number] = self._find_earlier(now - one.delay, int(row))
        return np.asarray(found)

    def slow(self, run: FaultRun, now: float, commands: FloatArray) -> FloatArray:
        """Send the commands of an earlier step, whose age is drawn at each step."""
        found = commands.copy()
        key, step = ("faults", run.fault.name), str(self._step)
        for number, (row, one) in enumerate(zip(run.rows, run.own, strict=True)):
            if isinstance(one, AgentSlow):
                age = one.delay + one.jitter * make_uniforms(self._seed, *key, step)[0]
                found[number] = self._find_earlier(now - age, int(row))
        return np.asarray(found)

    def _find_earlier(self, time: float, row: int) -> FloatArray:
        found: FloatArray = np.zeros(2)
        for at, commands in self._history:
            if at > time + TIME_TOLERANCE_S:
                break
            found = np.asarray(commands[row])
        return found


_Change = Callable[[CommandFaults, FaultRun, float, FloatArray], FloatArray]
_CHANGES: Mapping[type, _Change] = {
    CommandScale: CommandFaults.scale,
    CommandStuck: CommandFaults.hold,
    CommandLoss: CommandFaults.lose,
    CommandDelay: CommandFaults.delay,
    AgentHang: CommandFaults.hold,
    AgentKill: CommandFaults.stop,
    AgentSlow: CommandFaults.slow,
}
