"""`zensim top` with a real server, agents and a sensor process: printed, and on a terminal."""

import json
import signal
from collections.abc import Iterator

import pytest

from tests.integration.processes import (
    Server,
    eventually,
    running,
    serving,
    wait_for_agents,
    zensim,
)
from tests.integration.terminals import on_terminal
from zensim.proto import keys
from zensim.proto.exit_codes import ExitCode

ROBOTS = {"r1": "box_bot", "r2": "box_bot", "car": "car_bot"}


@pytest.fixture(scope="module")
def fleet() -> Iterator[Server]:
    with serving() as server:
        for place, (name, model) in enumerate(ROBOTS.items()):
            server.zensim("spawn", model, "-n", name, "-y", str(3 * place))
        with (
            running("agent", "--pool", "0", "--connect", server.endpoint),
            running("sensors", "run", "--connect", server.endpoint),
        ):
            wait_for_agents(server, tuple(ROBOTS))
            alive = keys.alive_sensors("default", "*")
            eventually(lambda: server.bus.list_tokens(alive), 20.0, "sensors")
            yield server


def test_json_has_processes_and_robots_with_rates(fleet: Server) -> None:
    done = zensim("top", "--json", "--connect", fleet.endpoint)

    found = json.loads(done.stdout)
    processes = {row["kind"]: row for row in found["processes"]}
    robots = {row["name"]: row for row in found["robots"]}
    assert done.returncode == ExitCode.OK
    assert processes.keys() >= {"server", "agent", "sensors"}
    assert processes["server"]["process_id"] == fleet.process.pid
    assert all(processes[kind]["cpu"] > 0.0 for kind in ("server", "agent", "sensors"))
    assert all(processes[kind]["memory_mib"] > 10.0 for kind in ("server", "agent", "sensors"))
    assert processes["agent"]["robots"] == len(ROBOTS)
    assert robots.keys() == ROBOTS.keys()
    assert all(row["odom_hz"] > 1.0 for row in robots.values())
    assert robots["car"]["y"] == pytest.approx(6.0, abs=0.1)


def test_once_prints_tables_of_what_the_filter_leaves(fleet: Server) -> None:
    done = zensim(
        "top", "--once", "--filter", "car_bot", "--rates", "0", "--connect", fleet.endpoint
    )

    assert done.returncode == ExitCode.OK
    assert "real-time factor" in done.stdout
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [words[0] for words in lines if len(words) == 8 and "car_bot" in words] == ["car"]
    assert not any(words and words[0] == "r1" for words in lines)


def test_terminal_shows_the_fleet_until_its_key(fleet: Server) -> None:
    with on_terminal(fleet, "top", "--every", "0.2") as terminal:
        for text in ("real-time", "agent_pool", "sensors_", "car_bot"):
            terminal.wait_for(text)
        terminal.type("q")

        assert terminal.status() == ExitCode.OK


def test_terminal_says_that_the_server_does_not_report(fleet: Server) -> None:
    with on_terminal(fleet, "top", "--every", "0.2") as terminal:
        # Agents may report before the server does.
        terminal.wait_for("real-time factor")
        fleet.process.send_signal(signal.SIGSTOP)
        try:
            terminal.wait_for("NO REPORT")
            terminal.type("q")
            assert terminal.status() == ExitCode.OK
        finally:
            fleet.process.send_signal(signal.SIGCONT)


def test_unknown_column_is_refused(fleet: Server) -> None:
    done = zensim("top", "--once", "--sort", "colour", "--connect", fleet.endpoint)

    assert done.returncode == ExitCode.USAGE
    assert "colour" in done.stderr
