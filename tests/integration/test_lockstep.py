"""Lockstep with agents in other processes: repeatable runs, and agents that join and leave."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from ipaddress import IPv4Address, IPv4Network

import pytest

from tests.integration.processes import (
    START_S,
    Server,
    eventually,
    free_endpoint,
    running_agents,
    serving,
)
from tests.integration.repeatable_run import RunResult, drive, run_lockstep_fleet
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.messages.telemetry_messages import Stats

ROBOTS = 3
STEPS = 480
PERIOD = 3
"""Steps between two drive states, at 240 Hz."""
SOON_S = 20.0
BOX_BOT = Resource("box_bot")
TEST_NETWORK = IPv4Network("198.18.0.0/15")
"""Address range reserved for benchmarks, RFC 2544."""


def run(*, processes: int = 0, endpoint: str = "", prefix: tuple[str, ...] = ()) -> RunResult:
    with run_lockstep_fleet(
        ROBOTS, processes=processes, endpoint=endpoint, prefix=prefix
    ) as server:
        return drive(server, ROBOTS, STEPS)


def run_pooled() -> RunResult:
    with run_lockstep_fleet(ROBOTS, is_pooled=True) as server:
        return drive(server, ROBOTS, STEPS)


@pytest.fixture(scope="module")
def message() -> RunResult:
    """Drive each robot by a separate agent."""
    found = run()
    assert set(found.odoms.values()) == {STEPS // PERIOD}
    return found


@contextmanager
def make_remote_host() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Make a network namespace linked to this one; return our address and a command prefix."""
    tag, (ours, theirs) = f"zl{os.getpid()}", find_free_addresses(os.getpid())
    with ExitStack() as stack:
        _ip("netns", "add", tag)
        stack.callback(_ip, "netns", "del", tag)
        _ip("link", "add", tag, "type", "veth", "peer", tag, "netns", tag)
        _ip("addr", "add", f"{ours}/30", "dev", tag)
        _ip("link", "set", tag, "up")
        _ip("-n", tag, "addr", "add", f"{theirs}/30", "dev", tag)
        _ip("-n", tag, "link", "set", tag, "up")
        yield str(ours), ("ip", "netns", "exec", tag)


def find_free_addresses(number: int) -> tuple[IPv4Address, IPv4Address]:
    """Find two unused addresses in the reserved range."""
    first = TEST_NETWORK.network_address + number % (TEST_NETWORK.num_addresses // 4) * 4
    return first + 1, first + 2


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


def test_same_requests_give_the_same_bytes_when_one_agent_drives_all(message: RunResult) -> None:
    assert run(processes=1) == message


def test_same_requests_give_the_same_bytes_when_a_pool_drives_all(message: RunResult) -> None:
    one, other = run_pooled(), run_pooled()

    assert one == other
    assert (one.odoms, one.state) == (message.odoms, message.state)


@pytest.mark.root
def test_same_requests_give_the_same_bytes_when_the_agents_are_on_another_host(
    message: RunResult,
) -> None:
    with make_remote_host() as (address, prefix):
        endpoint = free_endpoint(host=address)

        assert run(endpoint=endpoint, prefix=prefix) == message


@contextmanager
def locked(on_miss: str, *names: str, timeout_s: float = 0.5) -> Iterator[Server]:
    """Run a world in lockstep with robots at rest, at eight times real time."""
    options = ("--lockstep", "--on-miss", on_miss, "--lockstep-timeout", str(timeout_s))
    # As fast as possible would take the core that agents start on.
    with serving(*options, "--rtf", "8") as server:
        for number, name in enumerate(names):
            at = PoseStamped(pose=Pose(Point(y=float(number))))
            server.client.spawn(
                SpawnEntityOrder(
                    name, entity_resource=BOX_BOT, entity_namespace=name, initial_pose=at
                )
            )
        yield server


def goes_on(server: Server) -> bool:
    """Whether time passes for several control periods."""
    before = server.steps()
    eventually(lambda: server.steps() > before + 10 * PERIOD, SOON_S, "time")
    return True


def stats(server: Server) -> Stats:
    (sample,) = server.bus.get("sim/default/stats", START_S)
    return decode(Stats, sample.payload, sample.encoding)


def awaits_only(server: Server, stem: str) -> bool:
    awaited = stats(server).awaited
    return len(awaited) == 1 and awaited[0].startswith(stem)


@pytest.mark.parametrize("on_miss", ["wait", "hold"])
def test_run_continues_while_agents_join_die_and_return(on_miss: str) -> None:
    with locked(on_miss, "r1", "r2") as server:
        assert goes_on(server)
        with running_agents(server, "r1"):
            assert goes_on(server)
            with running_agents(server, "r2") as late:
                assert goes_on(server)
                late["r2"].kill()
                assert goes_on(server)
            with running_agents(server, "r2"):
                assert goes_on(server)
                server.client.delete("r2")
                assert goes_on(server)
        assert goes_on(server)
        assert server.client.info().state == "playing"


def test_waiting_server_blocks_for_a_suspended_agent_until_its_lease_expires() -> None:
    with locked("wait", "r1", "r2") as server, running_agents(server, "r1", "r2") as agents:
        agents["r1"].send_signal(signal.SIGSTOP)

        eventually(lambda: awaits_only(server, "agent_r1"), SOON_S, "waiting")

        assert goes_on(server)
        agents["r1"].send_signal(signal.SIGCONT)
        eventually(lambda: server.client.entity_model("r1").agent, SOON_S, "claiming again")
        assert goes_on(server)


def test_holding_server_counts_what_a_stopped_agent_misses() -> None:
    with locked("hold", "r1", timeout_s=0.05) as server, running_agents(server, "r1") as agents:
        agents["r1"].send_signal(signal.SIGSTOP)

        misses = eventually(lambda: stats(server).misses or None, SOON_S, "missing")

        assert next(iter(misses)).startswith("agent_r1")
        assert goes_on(server)
        agents["r1"].send_signal(signal.SIGCONT)


def test_failing_server_pauses_and_plays_on_request() -> None:
    with locked("fail", "r1", timeout_s=0.3) as server, running_agents(server, "r1") as agents:
        events = server.bus.subscribe("sim/default/events", 256)
        agents["r1"].send_signal(signal.SIGSTOP)

        eventually(lambda: server.client.info().state == "paused", SOON_S, "pausing")

        agents["r1"].send_signal(signal.SIGCONT)
        before = server.steps()

        def plays() -> bool:
            # On a busy machine an agent may be late again.
            if server.client.info().state == "paused":
                server.client.set_simulation_state(State.PLAYING)
            return server.steps() > before + 10 * PERIOD

        eventually(plays, SOON_S, "time")
        eventually(
            lambda: any(b"missed" in sample.payload for sample in events.take()), SOON_S, "an event"
        )
