"""Killed agents, killed spawners, terminated servers."""

import signal
import subprocess
from collections.abc import Iterator

import psutil
import pytest

from tests.integration.processes import (
    END_S,
    Server,
    agent_of,
    command_line,
    eventually,
    kill,
    running,
    running_agents,
    serving,
    wait_for_agents,
    zensim,
)
from tests.integration.robots import last_motion, robot, speed
from zensim.proto.messages.simulation_messages import ResetScope

MOVING_M_S = 0.05
STOP_STEPS = 120
"""0.5 s at 240 Hz."""


@pytest.fixture(scope="module")
def playing() -> Iterator[Server]:
    with serving() as found:
        yield found


@pytest.fixture
def server(playing: Server) -> Server:
    """The server of all tests that leave it running, without robots."""
    playing.client.reset(ResetScope.ALL)
    return playing


def test_robot_stops_and_can_be_claimed_when_its_agent_is_killed(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    with running_agents(server, "r1") as agents:
        driver = robot(server.bus, "r1")

        def is_moving() -> bool:
            driver.command(0.3)
            return speed(server, "r1") > MOVING_M_S

        eventually(is_moving, 10.0, "moving")
        agents["r1"].kill()
        killed_at = server.steps()
        assert last_motion(server, ["r1"], least_m_s=0.01) - killed_at <= STOP_STEPS

    with running_agents(server, "r1"):
        driver = robot(server.bus, "r1")
        eventually(is_moving, 10.0, "moving again")


def test_server_keeps_running_when_a_spawner_is_killed_during_a_call(server: Server) -> None:
    for delay_s in (0.15, 0.2, 0.25, 0.3, 0.35, 0.4):
        spawn = subprocess.Popen(
            command_line(["spawn", "box_bot", "-n", "r", "--connect", server.endpoint]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            spawn.wait(delay_s)
        except subprocess.TimeoutExpired:
            spawn.kill()
        spawn.wait()

    before = server.steps()
    eventually(lambda: server.steps() > before + 24, 5.0, "stepping")
    assert len(server.client.entities()) <= 1
    assert server.zensim("spawn", "box_bot", "-n", "after").returncode == 0


def test_agent_claims_again_when_its_entity_is_spawned_again(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    with running_agents(server, "r1"):
        server.client.delete("r1")
        server.zensim("spawn", "box_bot", "--name", "r1")

        wait_for_agents(server, ["r1"])


def test_second_agent_is_refused_when_a_robot_is_driven(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    with running_agents(server, "r1"):
        first = agent_of(server, "r1")

        second = server.zensim("agent", "r1", "--wait", "1")

        assert second.returncode == 1
        assert second.stderr.strip().splitlines()[-1].startswith("zensim agent: ")
        assert agent_of(server, "r1") == first


def test_server_exits_cleanly_when_interrupted() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        with serving() as server:
            server.process.send_signal(number)

            assert server.process.wait(END_S) == 0


def test_up_starts_ten_robots_and_leaves_no_process_when_interrupted() -> None:
    with running("up", "--json", "--no-viewer", "--listen", "tcp/127.0.0.1:0") as up:
        assert up.stdout is not None
        ready = up.stdout.readline()
        family = psutil.Process(up.pid).children(recursive=True)
        up.send_signal(signal.SIGINT)

        assert up.wait(END_S) == 0
        assert '"robots":10' in ready
        # Ten agents, the server and its parser process.
        assert len(family) == 12
        assert not [process for process in family if process.is_running()]
        assert '"real_time_factor"' in up.stdout.readline()


def test_up_ends_all_its_processes_when_killed() -> None:
    with running(
        "up", "--json", "--no-viewer", "--robots", "2", "--listen", "tcp/127.0.0.1:0"
    ) as up:
        assert up.stdout is not None
        up.stdout.readline()
        family = psutil.Process(up.pid).children(recursive=True)
        kill(up.pid, signal.SIGKILL)

        eventually(lambda: not any(process.is_running() for process in family), 5.0, "ending")


def test_up_restarts_an_agent_that_died() -> None:
    with running(
        "up", "--json", "--no-viewer", "--robots", "1", "--listen", "tcp/127.0.0.1:0"
    ) as up:
        assert up.stdout is not None
        up.stdout.readline()

        def find_agent() -> psutil.Process | None:
            family = psutil.Process(up.pid).children()
            return next((one for one in family if "agent" in one.cmdline()), None)

        # On a busy machine the first may have ended by itself, and be started again.
        eventually(find_agent, 10.0, "an agent").kill()

        assert up.stderr is not None
        message = eventually(up.stderr.readline, 10.0, "a note")
        while "-9" not in message:
            message = up.stderr.readline()
        eventually(lambda: len(psutil.Process(up.pid).children()) == 2, 10.0, "coming back")


def test_up_exits_when_its_duration_is_over() -> None:
    done = zensim(
        *("up", "--json", "--no-viewer", "--robots", "1", "--duration", "0.5"),
        *("--listen", "tcp/127.0.0.1:0"),
    )

    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 2
