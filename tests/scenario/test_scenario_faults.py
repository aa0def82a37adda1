"""Faults start and end at their control steps, and change commands as they say."""

from pathlib import Path

import numpy as np
import pytest

from zensim.proto.se3 import FloatArray
from zensim.scenario.robot_behaviours import FleetState
from zensim.scenario.scenario_faults import CommandFaults, FaultSchedule
from zensim.scenario.scenario_reader import Scenario, read_scenario

PERIOD = 0.1
HEAD = "zensim: 1\nrobots:\n  - {name: r, model: box_bot, count: 2, layout: {spacing: 5 m}}\n"


def scenario_of(folder: Path, fault: str, more: str = "") -> Scenario:
    file = folder / "f.scenario.yaml"
    file.write_text(f"{HEAD}{more}faults:\n  - {fault}\n")
    return read_scenario(str(file))


def state(now: float, gap: float = 5.0) -> FleetState:
    poses = np.array([[0.0, 0.0, 0.0], [gap, 0.0, 0.0]])
    return FleetState(now, PERIOD, poses, np.zeros((2, 6)))


def events_of(schedule: FaultSchedule, seconds: float) -> list[tuple[float, str]]:
    found: list[tuple[float, str]] = []
    for step in range(round(seconds / PERIOD)):
        for _, event in schedule.update(state(step * PERIOD)):
            found.append((round(event.time, 6), event.kind))
    return found


def sent(folder: Path, fault: str, seconds: float = 1.0, more: str = "") -> FloatArray:
    """Commands of robot r0, whose behaviour commands 1, 2, 3, ... m/s; (steps,)."""
    scenario = scenario_of(folder, fault, more)
    schedule, faults = FaultSchedule(scenario), CommandFaults(scenario)
    found = []
    for step in range(round(seconds / PERIOD)):
        now = step * PERIOD
        schedule.update(state(now))
        commands = np.full((2, 2), step + 1.0)
        found.append(faults.apply(now, commands, schedule.runs)[0, 0])
    return np.array(found)


def test_fault_starts_and_ends_at_its_steps(tmp_path: Path) -> None:
    fault = "{name: f, at: 0.3, for: 0.2, robots: r0, do: command_stuck}"

    events = events_of(FaultSchedule(scenario_of(tmp_path, fault)), 2.0)

    assert events == [(0.3, "start"), (0.5, "end")]


def test_fault_comes_again(tmp_path: Path) -> None:
    fault = "{name: f, at: 0.3, for: 0.2, every: 0.5, robots: r0, do: command_stuck}"

    events = events_of(FaultSchedule(scenario_of(tmp_path, fault)), 1.5)

    assert [time for time, kind in events if kind == "start"] == [0.3, 0.8, 1.3]


def test_fault_of_probability_zero_never_comes(tmp_path: Path) -> None:
    fault = "{name: f, at: 0, for: 0.1, every: 0.2, probability: 0, robots: r0, do: command_stuck}"

    assert events_of(FaultSchedule(scenario_of(tmp_path, fault)), 2.0) == []


def test_fault_of_probability_one_half_comes_sometimes_and_always_alike(tmp_path: Path) -> None:
    fault = (
        "{name: f, at: 0, for: 0.1, every: 0.2, probability: 50 %, robots: r0, do: command_stuck}"
    )

    first, second = (events_of(FaultSchedule(scenario_of(tmp_path, fault)), 8.0) for _ in range(2))

    assert first == second
    assert 8 < len(first) / 2 < 32


def test_fault_waits_until_robots_are_near(tmp_path: Path) -> None:
    fault = "{name: f, when: {near: [r0, r1], below: 1}, robots: r0, do: command_stuck}"
    schedule = FaultSchedule(scenario_of(tmp_path, fault))

    assert schedule.update(state(0.0, gap=2.0)) == []
    assert len(schedule.update(state(0.1, gap=0.9))) == 1
    assert schedule.active == {"f"}
    assert schedule.update(state(0.2, gap=0.5)) == []


def test_kidnap_ends_at_its_own_step(tmp_path: Path) -> None:
    fault = "{name: f, at: 0.2, every: 0.5, robots: r0, do: kidnap, x: 1, y: 2}"

    events = events_of(FaultSchedule(scenario_of(tmp_path, fault)), 1.0)

    assert events == [(0.2, "start"), (0.2, "end"), (0.7, "start"), (0.7, "end")]


def test_stuck_repeats_the_last_command(tmp_path: Path) -> None:
    found = sent(tmp_path, "{name: f, at: 0.3, for: 0.3, robots: r0, do: command_stuck}")

    assert found.tolist() == [1, 2, 3, 3, 3, 3, 7, 8, 9, 10]


def test_delay_sends_earlier_commands(tmp_path: Path) -> None:
    found = sent(tmp_path, "{name: f, at: 0.3, robots: r0, do: command_delay, delay: 0.2}")

    assert found.tolist() == [1, 2, 3, 2, 3, 4, 5, 6, 7, 8]


def test_scale_multiplies(tmp_path: Path) -> None:
    found = sent(
        tmp_path, "{name: f, at: 0.3, for: 0.2, robots: r0, do: command_scale, factor: 0.5}"
    )

    assert found.tolist() == [1, 2, 3, 2.0, 2.5, 6, 7, 8, 9, 10]


def test_lost_commands_are_a_share(tmp_path: Path) -> None:
    found = sent(
        tmp_path, "{name: f, at: 0, robots: r0, do: command_loss, share: 30 %}", seconds=100.0
    )

    lost = np.mean(found != np.arange(1, 1001))
    assert lost == pytest.approx(0.3, abs=0.05)


def test_agent_that_hangs_repeats_and_one_that_is_killed_stops(tmp_path: Path) -> None:
    agents = "agents:\n  - {name: first, drives: r0}\n  - {name: second, drives: r1}\n"
    form = "{{name: f, at: 0.3, for: 0.3, do: {}, agent: {}}}"

    assert sent(tmp_path, form.format("agent_hang", "first"), more=agents)[3:7].tolist() == [
        *(3, 3, 3),
        7,
    ]
    assert sent(tmp_path, form.format("agent_kill", "first"), more=agents)[3:7].tolist() == [
        *(0, 0, 0),
        7,
    ]
    assert sent(tmp_path, form.format("agent_kill", "second"), more=agents)[3] == 4
