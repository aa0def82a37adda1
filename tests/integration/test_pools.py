"""Pools of agents in real processes: shares, failures, takeovers, late joiners."""

import signal
from collections import Counter
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING

import psutil
import pytest

from tests.integration.processes import (
    Server,
    agent_of,
    connected,
    eventually,
    read_json_line,
    running,
    serving,
)
from tests.integration.robots import last_motion, robot, speed
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.proto.messages.standard_messages import Odometry

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterator

ROBOTS = 7
NAMES = [f"box_bot{number}" for number in range(ROBOTS)]
MOVING_M_S = 0.05
STOP_STEPS = 120
"""0.5 s at 240 Hz."""
SOON_S = 20.0


@pytest.fixture(scope="module")
def playing() -> "Iterator[Server]":
    with serving() as found:
        yield found


@pytest.fixture
def server(playing: Server) -> Server:
    """The server of all tests, without robots and agents."""
    playing.client.reset(ResetScope.ALL)
    return playing


@contextmanager
def pools(server: Server, *names: str) -> "Iterator[dict[str, subprocess.Popen[str]]]":
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(
                running(*("agent", "--pool", "0", "--name", name, "--connect", server.endpoint))
            )
            for name in names
        }


def spawn(server: Server) -> None:
    layout = ("--robots", str(ROBOTS), "--layout", "grid", "--spacing", "2")
    assert server.zensim("fleet", "box_bot", *layout).returncode == 0


def shares(server: Server) -> list[int]:
    """Count the robots of each agent, in descending order."""
    running_agents = Counter(agent_of(server, name) for name in server.client.entities())
    del running_agents[""]
    return sorted(running_agents.values(), reverse=True)


def wait_for_shares(server: Server, *sizes: int) -> None:
    eventually(lambda: shares(server) == list(sizes), SOON_S, f"shares of {sizes}")


def test_pools_share_robots_evenly_as_robots_and_pools_come_and_go(server: Server) -> None:
    with pools(server, "p", "q"):
        spawn(server)
        wait_for_shares(server, 4, 3)

        with pools(server, "r"):
            wait_for_shares(server, 3, 2, 2)
            for name in NAMES[:4]:
                server.client.delete(name)
            wait_for_shares(server, 1, 1, 1)
        wait_for_shares(server, 2, 1)


def test_robots_of_a_killed_pool_stop_and_move_to_the_other(server: Server) -> None:
    with pools(server, "p", "q") as processes:
        spawn(server)
        wait_for_shares(server, 4, 3)
        drivers = {name: robot(server.bus, name) for name in NAMES}

        def all_move() -> bool:
            for driver in drivers.values():
                driver.command(0.3)
            return all(speed(server, name) > MOVING_M_S for name in NAMES)

        eventually(all_move, SOON_S, "moving")
        orphans = [name for name in NAMES if agent_of(server, name) == "p"]
        processes["p"].kill()
        killed_at = server.steps()
        assert last_motion(server, orphans, least_m_s=MOVING_M_S) - killed_at <= STOP_STEPS

        wait_for_shares(server, ROBOTS)
        eventually(all_move, SOON_S, "moving again")


def test_pool_releases_a_robot_to_the_agent_that_names_it(server: Server) -> None:
    with running("agent", "box_bot3", "--name", "own", "--connect", server.endpoint):
        spawn(server)
        eventually(lambda: agent_of(server, "box_bot3") == "own", SOON_S, "claiming")
        with pools(server, "p"):
            wait_for_shares(server, ROBOTS - 1, 1)

            assert agent_of(server, "box_bot3") == "own"


def test_pool_drives_no_more_than_its_limit(server: Server) -> None:
    with running("agent", "--pool", "2", "--connect", server.endpoint):
        spawn(server)
        wait_for_shares(server, 2)
        with pools(server, "q"):
            wait_for_shares(server, ROBOTS - 2, 2)


def test_late_joiners_discover_the_robots_of_every_pool(server: Server) -> None:
    with pools(server, "p", "q"):
        spawn(server)
        wait_for_shares(server, 4, 3)
        listener = server.bus.subscribe("*/tf_static", 100)

        for topic in ("odom", "tf", "tf_static", "joint_states", "robot_description"):
            every = [f"{name}/{topic}" for name in NAMES]
            eventually(partial(_are_told, server, every), SOON_S, f"answers to */{topic}")
            responses = [server.bus.get(key, SOON_S) for key in every]
            assert [one.key for (one,) in responses] == every
        parse_publisher_token: Counter[str] = Counter()

        def all_announced() -> bool:
            parse_publisher_token.update(sample.key for sample in listener.take())
            return len(parse_publisher_token) == ROBOTS

        eventually(all_announced, SOON_S, "announcements")
        assert set(parse_publisher_token.values()) == {1}


def _are_told(server: Server, every: list[str]) -> bool:
    topic = every[0].partition("/")[2]
    return sorted(sample.key for sample in server.bus.get(f"*/{topic}")) == every


def test_pool_publishes_odometry_at_the_given_rate() -> None:
    rates = ("--odom-hz", "20", "--tf-hz", "10")
    with (
        # As fast as possible would take the core that the agent starts on.
        serving("--rtf", "0", "--lockstep", "--paused") as server,
        running("agent", "--pool", "0", *rates, "--connect", server.endpoint),
    ):
        spawn(server)
        wait_for_shares(server, ROBOTS)
        server.client.set_simulation_state(State.PLAYING)
        received = robot(server.bus, NAMES[0])
        begin = received.now()
        found: list[Odometry] = []
        tf = server.bus.subscribe(f"{NAMES[0]}/tf", 10_000)

        def long_enough() -> bool:
            found.extend(received.read())
            return bool(found) and _seconds(found[-1]) - _seconds(begin) > 10.0

        eventually(long_enough, SOON_S, "ten simulated seconds")
        span_s = _seconds(found[-1]) - _seconds(found[0])
        assert 0.9 <= (len(found) - 1) / span_s / 20.0 <= 1.01
        assert 0.4 <= len(tf.take()) / len(found) <= 0.6


def _seconds(odom: Odometry) -> float:
    return odom.header.stamp.sec + odom.header.stamp.nanosec * 1e-9


def test_pool_continues_in_lockstep_when_another_joins_and_dies() -> None:
    options = ("--lockstep", "--on-miss", "wait", "--rtf", "8")
    with serving(*options) as server, pools(server, "p"):
        spawn(server)
        wait_for_shares(server, ROBOTS)
        with pools(server, "q") as second:
            wait_for_shares(server, 4, 3)
            before = server.steps()
            eventually(lambda: server.steps() > before + 30, SOON_S, "time")
            second["q"].send_signal(signal.SIGKILL)
        wait_for_shares(server, ROBOTS)
        before = server.steps()
        eventually(lambda: server.steps() > before + 30, SOON_S, "time")


def test_pools_rejoin_a_restarted_server() -> None:
    with serving() as first, pools(first, "p") as processes:
        endpoint = first.endpoint
        spawn(first)
        wait_for_shares(first, ROBOTS)
        first.process.kill()
        first.process.wait()
        with serving(endpoint=endpoint) as second:
            spawn(second)
            wait_for_shares(second, ROBOTS)
        assert processes["p"].poll() is None


def test_up_pooled_starts_all_robots_and_restarts_a_dead_pool() -> None:
    options = ("--agents", "pooled", "--robots", str(ROBOTS), "--odom-hz", "20")
    with running(*("up", "--json", "--no-viewer", "--listen", "tcp/127.0.0.1:0", *options)) as up:
        ready = read_json_line(up)
        assert ready["robots"] == ROBOTS
        family = psutil.Process(up.pid).children()
        assert len(family) == 2  # a pool and the server
        pool = next(process for process in family if "agent" in process.cmdline())
        pool.kill()

        assert up.stderr is not None
        message = eventually(up.stderr.readline, 10.0, "a note")
        while "-9" not in message:
            message = up.stderr.readline()
        with connected(str(ready["endpoint"])) as bus:
            odom = bus.subscribe("*/odom", 1000)
            received: set[str] = set()

            def all_tell() -> bool:
                for sample in odom.take():
                    decode(Odometry, sample.payload, sample.encoding)
                    received.add(sample.key)
                return len(received) == ROBOTS

            eventually(all_tell, SOON_S, "odometry of all")
