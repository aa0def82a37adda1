"""A scenario ends in the same state in process and on a server with an agent process."""

from pathlib import Path

from tests.scenario.scenario_runs import run_alone
from zensim.deploy.scenario_process import RunRequest

TEXT = (
    "zensim: 1\nengine: {use: mujoco}\ntime: {seed: 3}\nrobots:\n"
    "  - {name: r, model: box_bot, count: 3, layout: {spacing: 2 m}}\n"
    "behaviours:\n  - {name: walk, robots: r*, do: random_walk, speed: {uniform: [0.2, 0.4]}}\n"
    "faults:\n"
    "  - {name: jam, at: 0.5, for: 0.5, robots: r0, do: wheel_jam, joint: left_wheel_joint}\n"
    "  - {name: weak, at: 0.7, for: 0.3, robots: r1, do: motor_weak, joint: left_wheel_joint}\n"
    "  - {name: slip, at: 0.8, for: 0.3, robots: r2, do: wheel_slip, joint: left_wheel_joint}\n"
    "  - {name: lost, at: 1.1, for: 0.3, robots: r2, do: link_broken, link: right_wheel}\n"
    "  - {name: slow, at: 1.2, for: 0.2, do: agent_slow, agent: pool, delay: 0.3, jitter: 0.1}\n"
    "  - {name: shove, at: 1, for: 0.2, robots: r1, do: push, x: 20 N}\n"
    "  - {name: move, at: 1.5, robots: r2, do: kidnap, x: 10, y: 10}\n"
    "  - {name: dies, at: 1.6, do: agent_kill, agent: pool}\n"
    "checks:\n  - {name: stops, that: speed, below: 0.02, by: 2.5}\nend: {at: 2.5}\n"
)


def test_scenario_ends_alike_in_process_and_on_a_server(tmp_path: Path) -> None:
    file = tmp_path / "a.scenario.yaml"
    file.write_text(TEXT)

    inside, served = (
        run_alone(RunRequest(str(file), is_served=is_served)) for is_served in (False, True)
    )

    assert (inside.error, served.error) == ("", "")
    assert inside.is_passed
    assert served.state_hash == inside.state_hash
    assert [one.margin for one in served.checks] == [one.margin for one in inside.checks]
