"""Scenarios run in a world of this process: behaviours, faults at their steps, and checks."""

from pathlib import Path

import numpy as np
import pytest

import zensim
from zensim.scenario.scenario_loading import load, open_world
from zensim.scenario.scenario_reader import Scenario, read_scenario
from zensim.scenario.scenario_runner import RunReport, ScenarioRun, find_end, run_scenario

HEAD = "zensim: 1\nrobots:\n  - {name: r, model: box_bot, count: 2, layout: {spacing: 3 m}}\n"
AHEAD = "behaviours:\n  - {name: go, robots: r*, do: drive, v: 0.3}\n"


def read(folder: Path, text: str, head: str = HEAD) -> Scenario:
    file = folder / "run.scenario.yaml"
    file.write_text(head + text, encoding="utf-8")
    return read_scenario(str(file))


def run(scenario: Scenario) -> RunReport:
    with zensim.World(scenario.format.world.load, seed=scenario.seed) as world:
        return run_scenario(scenario, world)


def verdicts(report: RunReport) -> dict[str, str]:
    return {check.name: check.verdict for check in report.checks}


def track(scenario: Scenario, robot: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Time, x, y, heading and speed of a robot at each control step, (steps, 5)."""
    rows = []
    with zensim.World(scenario.format.world.load) as world:
        own = ScenarioRun(scenario, world)
        own.spawn()
        for _ in world.steps(seconds=find_end(scenario)):
            state = own.step()
            rows.append([state.now, *state.poses[robot], state.twists[robot, 0]])
    return np.array(rows)


def test_checks_pass_and_fail_with_their_margins(tmp_path: Path) -> None:
    checks = (
        "checks:\n  - {name: far, that: distance, above: 2.5}\n"
        "  - {name: fast, robots: r0, that: speed, above: 1, from: 1}\n"
        "  - {name: there, robots: r0, that: reached, point: [0.45, 0], by: 2}\nend: {at: 2}\n"
    )

    report = run(read(tmp_path, AHEAD + checks))

    assert verdicts(report) == {"far": "passed", "fast": "failed", "there": "passed"}
    assert not report.is_passed
    assert report.checks[0].margin == pytest.approx(0.5, abs=0.01)
    assert report.checks[1].margin == pytest.approx(-0.7, abs=0.05)
    assert report.checks[1].place.endswith("run.scenario.yaml:8")


def test_combined_checks_combine_later_ones_at_the_same_step(tmp_path: Path) -> None:
    checks = (
        "checks:\n  - {name: top, that: any_of, checks: [middle]}\n"
        "  - {name: middle, that: all_of, checks: [far]}\n"
        "  - {name: far, robots: r0, that: outside, polygon: [[0, -1], [1, -1], [1, 1]]}\n"
    )

    report = run(read(tmp_path, AHEAD + checks + "end: {at: 1}\n"))

    assert [check.name for check in report.checks] == ["top", "middle", "far"]
    assert len({check.margin for check in report.checks}) == 1


def test_equal_runs_end_in_equal_states(tmp_path: Path) -> None:
    text = (
        "behaviours:\n  - {name: walk, robots: r*, do: random_walk, speed: {uniform: [0.1, 0.3]}}\n"
        "end: {at: 2}\n"
    )
    scenario = read(tmp_path, text)
    other = read(tmp_path, text + "time: {seed: 5}\n")

    first, second, third = run(scenario), run(scenario), run(other)

    assert first.state_hash == second.state_hash
    assert first.state_hash != third.state_hash


def test_agents_of_the_file_set_the_rates_of_their_robots_in_process(tmp_path: Path) -> None:
    text = "agents:\n  - {name: slow, drives: r0, odom_rate: 5 Hz}\n"
    received: dict[str, list[object]] = {"r0": [], "r1": []}

    with open_world(read(tmp_path, text)) as world:
        run = load(tmp_path / "run.scenario.yaml", sim=world)
        for name, messages in received.items():
            world.topic(f"{name}/odom").on(messages.append, queue=100)
        world.run_for(2.0)
        run.close()

    assert len(received["r0"]) == 10
    assert len(received["r1"]) > 50


def test_end_comes_when_the_goal_is_reached(tmp_path: Path) -> None:
    text = (
        "checks:\n  - {name: there, robots: r0, that: reached, point: [0.3, 0], by: 9}\n"
        "end: {at: 9, when: {all: [there]}}\n"
    )

    report = run(read(tmp_path, AHEAD + text))

    assert report.is_passed
    assert report.sim_time < 2.0


def test_run_stops_at_a_failure_if_wanted(tmp_path: Path) -> None:
    text = "checks:\n  - {name: slow, that: speed, below: 0.1}\nend: {at: 9, on_failure: stop}\n"

    report = run(read(tmp_path, AHEAD + text))

    assert not report.is_passed
    assert report.sim_time < 1.0


@pytest.mark.parametrize(
    "fault",
    [
        "{name: f, at: 1, for: 0.5, robots: r0, do: command_scale, factor: 0}",
        "{name: f, at: 1, for: 0.5, do: agent_kill, agent: pool}",
        "{name: f, at: 1, for: 0.5, robots: r0, do: wheel_jam, joint: left_wheel_joint}",
        "{name: f, at: 1, for: 0.5, robots: r0, do: joint_lock, joint: left_wheel_joint}",
        "{name: f, at: 1, for: 0.5, robots: r0, do: link_broken, link: left_wheel}",
        "{name: f, at: 1, for: 0.5, do: agent_slow, agent: pool, delay: 1.5}",
        "{name: f, at: 1, for: 0.2, robots: r0, do: push, x: -30 N}",
        "{name: f, at: 1, robots: r0, do: kidnap, x: 5, y: 5}",
    ],
)
def test_fault_acts_from_its_control_step_on(fault: str, tmp_path: Path) -> None:
    quiet = track(read(tmp_path, AHEAD + "end: {at: 1.3}\n"), 0)

    faulty = track(read(tmp_path, f"{AHEAD}faults:\n  - {fault}\nend: {{at: 1.3}}\n"), 0)

    differs = np.flatnonzero(np.abs(faulty - quiet).max(axis=1) > 1e-9)
    start = np.flatnonzero(quiet[:, 0] >= 1.0 - 1e-6)[0]
    assert differs[0] == start + 1
    assert np.abs(faulty[-1, 1:] - quiet[-1, 1:]).max() > 0.01


def test_jammed_wheel_turns_again_after_its_fault(tmp_path: Path) -> None:
    fault = "{name: f, at: 1, for: 1, robots: r0, do: wheel_jam, joint: left_wheel_joint}"

    found = track(read(tmp_path, f"{AHEAD}faults:\n  - {fault}\nend: {{at: 4}}\n"), 0)

    time, speed = found[:, 0], found[:, 4]
    assert np.abs(np.diff(found[(time > 1.3) & (time < 1.9), 3])).min() > 1e-3
    assert speed[time > 3.0] == pytest.approx(0.3, abs=0.02)


def test_fault_has_its_two_events(tmp_path: Path) -> None:
    text = (
        "faults:\n  - {name: f, at: 0.5, for: 0.25, robots: r0, do: command_stuck}\nend: {at: 1}\n"
    )

    report = run(read(tmp_path, AHEAD + text))

    own = [(round(one.time, 2), one.kind) for one in report.events if one.name == "f"]
    assert own == [(0.5, "start"), (0.75, "end")]


def test_code_of_the_author_drives_and_checks(tmp_path: Path) -> None:
    (tmp_path / "authors_code.py").write_text(
        "class Control:\n"
        "    def __init__(self, sim, robots, speed):\n"
        "        self.count, self.speed = len(robots), speed\n"
        "    def step(self, now, state):\n"
        "        return [[self.speed, 0.0]] * self.count\n"
        "class Limit:\n"
        "    def __init__(self, robots, most):\n"
        "        self.most = most\n"
        "    def update(self, now, state):\n"
        "        return self.most - state.poses[:, 0].max()\n"
    )
    text = (
        "behaviours:\n"
        "  - {name: b, robots: r0, do: python, call: 'authors_code:Control', args: {speed: 0.2}}\n"
        "checks:\n  - {name: c, that: python, call: 'authors_code:Limit', args: {most: 3.5}}\n"
        "  - {name: m, robots: r0, that: reached, point: [0.2, 0], by: 2}\nend: {at: 2}\n"
    )

    report = run(read(tmp_path, text))

    assert verdicts(report) == {"c": "passed", "m": "passed"}


def test_code_of_the_author_can_be_refused(tmp_path: Path) -> None:
    text = "behaviours:\n  - {name: b, robots: r0, do: python, call: 'authors_code:Control'}\n"
    scenario = read(tmp_path, text)

    with zensim.World() as world, pytest.raises(RuntimeError):
        run_scenario(scenario, world, allows_python=False)


def test_looking_at_topics_does_not_change_the_run(tmp_path: Path) -> None:
    head = HEAD.replace("box_bot,", "box_bot_lidar,")
    text = (
        AHEAD + "faults:\n  - {name: dies, at: 0.4, for: 0.3, do: agent_kill, agent: pool}\n"
        "end: {at: 1}\n"
    )
    look = "checks:\n  - {name: c, that: rate, topic: r0/scan, above: 1, window: 0.5}\n"

    blind = run(read(tmp_path, text, head)).state_hash

    for _ in range(4):
        assert run(read(tmp_path, text + look, head)).state_hash == blind


RECORDED = (
    AHEAD
    + "checks:\n  - {name: fast, robots: r0, that: speed, above: 1, from: 0.5}\nend: {at: 1}\n"
)


@pytest.mark.parametrize("keep", ["always", "on_failure"])
def test_run_that_fails_is_recorded_from_its_first_spawn(tmp_path: Path, keep: str) -> None:
    section = (
        "record:\n  to: 'runs/{name}-{seed}.mcap'\n  topics: ['*/odom', 'sim/**']\n"
        f"  keep: {keep}\n"
    )

    report = run(read(tmp_path, RECORDED + section))

    file = tmp_path / "runs" / "run-0.mcap"
    assert not report.is_passed
    assert report.recording == str(file)
    recording = zensim.Recording(file)
    assert recording.counts["/r0/odom"] == recording.counts["/r1/odom"] > 50
    events = [message.data.data for message in recording.messages("sim/default/events")]  # type: ignore[attr-defined]
    assert sum('"spawned"' in one for one in events) == 2


def test_recording_of_a_run_that_passed_is_kept_only_if_wanted(tmp_path: Path) -> None:
    section = "record: {to: run.mcap, keep: on_failure}\nend: {at: 0.2}\n"

    report = run(read(tmp_path, AHEAD + section))

    assert report.is_passed
    assert report.recording == ""
    assert sorted(one.name for one in tmp_path.iterdir()) == ["run.scenario.yaml"]


def test_equal_runs_replace_their_recording_by_an_equal_one(tmp_path: Path) -> None:
    scenario = read(tmp_path, AHEAD + "record: {to: run.mcap}\nend: {at: 0.5}\n")

    run(scenario)
    first = (tmp_path / "run.mcap").read_bytes()
    run(scenario)

    assert (tmp_path / "run.mcap").read_bytes() == first
    assert zensim.Recording(tmp_path / "run.mcap").is_closed


def test_recording_of_a_run_that_raises_is_whole(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "class Fails:\n"
        "    def __init__(self, robots): pass\n"
        "    def update(self, now, state):\n"
        "        if now > 0.3: raise RuntimeError('enough')\n"
        "        return 1.0\n"
    )
    check = "checks:\n  - {name: own, that: python, call: 'own:Fails'}\n"
    scenario = read(tmp_path, check + "record: {to: run.mcap, keep: on_failure}\nend: {at: 1}\n")

    with zensim.World() as world, pytest.raises(RuntimeError):
        run_scenario(scenario, world)

    assert zensim.Recording(tmp_path / "run.mcap").is_closed


def test_run_that_cannot_be_recorded_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    scenario = read(tmp_path, "record: {to: runs/run.mcap}\nend: {at: 1}\n")

    with pytest.raises(zensim.Error) as refused:
        run(scenario)

    assert refused.value.slug == "no_recorder"


def test_scenario_that_is_not_there_is_not_found() -> None:
    with pytest.raises(zensim.NotFound, match="first_minutes"):
        zensim.load("nope")
