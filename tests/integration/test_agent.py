"""Life cycle of an agent process: waiting, recovery, exit."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import psutil
import pytest

from tests.integration.processes import (
    END_S,
    Server,
    agent_of,
    connected,
    eventually,
    free_endpoint,
    running,
    running_agents,
    serving,
    wait_for_agents,
)
from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import JointState, Odometry, String, TFMessage
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    import subprocess

    import msgspec

MAX_MEMORY_BYTES = 70 * 1024 * 1024


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """Run one server for all tests; each test has its own entities."""
    with serving() as server:
        for name in ("r1", "r2", "r3", "r4"):
            server.zensim("spawn", "box_bot", "-n", name, "-y", name[1:])
        yield server


def agents_up(bus: Bus) -> list[str]:
    return [keys.parse_agent(key) for key in bus.list_tokens(keys.alive_agents("default"))]


@contextmanager
def paused(server: Server) -> Iterator[None]:
    """Pause simulation time, so that a slow agent on a busy host does not count as hung."""
    server.client.set_simulation_state(State.PAUSED)
    yield
    server.client.set_simulation_state(State.PLAYING)


def status_after(process: "subprocess.Popen[str]", number: signal.Signals) -> int:
    process.send_signal(number)
    return process.wait(END_S)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_agent_exits_with_0_when_terminated(server: Server, number: signal.Signals) -> None:
    with running_agents(server, "r1") as agents:
        name = agent_of(server, "r1")

        assert status_after(agents["r1"], number) == 0

        eventually(lambda: name not in agents_up(server.bus), 2.0, "withdrawing the token")
        eventually(lambda: not agent_of(server, "r1"), 2.0, "releasing the entity")


def test_agent_exits_while_it_waits_for_its_entity(server: Server) -> None:
    with running("agent", "r9", "--name", "patient", "--connect", server.endpoint) as waiting:
        eventually(lambda: "patient" in agents_up(server.bus), 10.0, "joining")

        assert status_after(waiting, signal.SIGTERM) == 0


def test_agent_exits_while_it_waits_for_a_server() -> None:
    with running("agent", "r1", "--connect", free_endpoint()) as waiting:
        eventually(lambda: psutil.Process(waiting.pid).num_threads() > 1, 10.0, "joining")

        # The second during the start of the interpreter.
        assert status_after(waiting, signal.SIGINT) in (ExitCode.INTERRUPTED, -signal.SIGINT)


def test_agent_names_the_missing_entity_after_its_timeout(server: Server) -> None:
    done = server.zensim("agent", "r9", "--wait", "0.3")

    last = done.stderr.splitlines()[-1]
    assert done.returncode == 3
    assert last.startswith("zensim agent: ")
    assert "'r9'" in last


def test_agent_is_refused_an_entity_with_another_agent(server: Server) -> None:
    with paused(server), running_agents(server, "r2"):
        done = server.zensim("agent", "r2", "--wait", "0.3")

    assert done.returncode == 1
    assert "'r2'" in done.stderr.splitlines()[-1]


def test_agent_claims_an_entity_again_after_deletion_and_spawn(server: Server) -> None:
    with running_agents(server, "r3"):
        server.zensim("delete", "r3")
        eventually(lambda: server.bus.get("r3/odom") == [], 5.0, "falling silent")

        server.zensim("spawn", "box_bot", "-n", "r3", "-y", "3")

        wait_for_agents(server, ["r3"])
        eventually(lambda: server.bus.get("r3/odom") != [], 5.0, "odometry")


def test_agent_publishes_to_late_joiners_within_its_memory_limit(server: Server) -> None:
    kinds: dict[str, type[msgspec.Struct]] = {
        "r4/odom": Odometry,
        "r4/tf": TFMessage,
        "r4/tf_static": TFMessage,
        "r4/joint_states": JointState,
        "r4/robot_description": String,
    }
    with running_agents(server, "r4") as agents:
        listener = server.bus.subscribe("r4/tf_static")

        eventually(lambda: server.bus.get("r4/odom") != [], 5.0, "odometry")
        responses = server.bus.get("r4/*", END_S)
        parse_publisher_token = eventually(listener.newest, 5.0, "tf_static")
        memory_bytes = psutil.Process(agents["r4"].pid).memory_info().rss

    assert {response.key for response in responses} == set(kinds)
    for sample in (parse_publisher_token, *responses):
        decode(kinds[sample.key], sample.payload, sample.encoding)
    assert memory_bytes < MAX_MEMORY_BYTES


def test_agent_survives_its_server_and_may_start_before_it() -> None:
    endpoint = free_endpoint()
    with running("agent", "r1", "--connect", endpoint) as agent:
        for _ in range(2):
            with (
                running("serve", "--listen", endpoint) as process,
                connected(endpoint, process) as bus,
            ):
                server = Server(process, endpoint, bus, SimClient(bus))
                server.zensim("spawn", "box_bot", "-n", "r1")
                wait_for_agents(server, ["r1"])
                process.kill()
                process.wait()
        assert agent.poll() is None
