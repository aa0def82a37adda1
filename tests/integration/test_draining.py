"""SIGTERM ends a server in order: not ready, requests finished, journal written, status 0."""

import json
import signal
from contextlib import suppress
from pathlib import Path
from threading import Thread

from tests.integration.processes import eventually, running, serving, zensim
from tests.integration.scraping import find_free_port, probe
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.simulation_messages import SimulateStepsRequest
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.service_catalog import SIMULATE_STEPS, SPAWN_ENTITY

WITHIN_S = 30.0
STEPS, MANY_STEPS, MANY = 1_000, 10_000_000, 10_000


def simulate(endpoint: str, steps: int, results: list[int]) -> None:
    """Advance by steps, and append the result code, if there is a reply."""
    with open_bus(BusConfig(connect=(endpoint,))) as bus, suppress(BusError, TimeoutError):
        request = SimulateStepsRequest(steps=steps)
        found = bus.call(SIMULATE_STEPS, request, world="default", timeout_s=WITHIN_S)
        results.append(found.result.result)


def test_accepted_request_is_finished_before_the_end() -> None:
    results: list[int] = []
    with serving("--paused") as server:
        caller = Thread(target=simulate, args=(server.endpoint, STEPS, results))
        caller.start()
        eventually(lambda: server.steps() > 0, WITHIN_S, "steps")
        server.process.send_signal(signal.SIGTERM)
        caller.join(WITHIN_S)

        assert server.process.wait(WITHIN_S) == ExitCode.OK
    assert results == [ResultCode.OK]


def test_draining_server_is_alive_not_ready_and_ends_at_a_second_signal() -> None:
    port = find_free_port()
    with serving("--metrics", port, "--paused") as server:
        caller = Thread(target=simulate, args=(server.endpoint, MANY_STEPS, []), daemon=True)
        caller.start()
        eventually(lambda: server.steps() > 0, WITHIN_S, "steps")
        server.process.send_signal(signal.SIGTERM)
        eventually(lambda: probe(port, "/readyz") == 503, WITHIN_S, "draining")
        is_alive = probe(port, "/livez") == 200
        server.process.send_signal(signal.SIGTERM)
        status = server.process.wait(WITHIN_S)
        caller.join(WITHIN_S)

    assert (is_alive, status) == (True, ExitCode.OK)


def make_order(number: int) -> SpawnEntityOrder:
    """Make the order of a robot, 1 m from the last."""
    pose = PoseStamped(pose=Pose(position=Point(x=float(number))))
    resource = Resource(uri="box_bot")
    return SpawnEntityOrder(name=f"r{number}", entity_resource=resource, initial_pose=pose)


def spawn_until_refused(endpoint: str, acknowledged: list[str]) -> None:
    """Spawn robots one by one, and append the names of those that the server acknowledges."""
    ended = suppress(ServiceError, BusError, TimeoutError)
    with open_bus(BusConfig(connect=(endpoint,))) as bus, ended:
        for number in range(MANY):
            order = make_order(number)
            bus.call(SPAWN_ENTITY, order, world="default", timeout_s=20.0)
            acknowledged.append(order.name)


def test_no_acknowledged_spawn_is_lost(tmp_path: Path) -> None:
    journal = ("--journal", str(tmp_path / "journal"))
    acknowledged: list[str] = []
    with serving(*journal) as server:
        spawner = Thread(target=spawn_until_refused, args=(server.endpoint, acknowledged))
        spawner.start()
        eventually(lambda: len(acknowledged) > 5, WITHIN_S, "spawns")
        server.process.send_signal(signal.SIGTERM)
        status = server.process.wait(WITHIN_S)
        spawner.join(WITHIN_S)

    with serving(*journal) as server:
        restored = set(server.client.entities())

    assert status == ExitCode.OK
    assert set(acknowledged) <= restored


def test_programs_log_json_when_it_is_asked_for() -> None:
    with serving("--log-format", "json", "-v") as server:
        server.zensim("spawn", "box_bot", "--name", "r1")
        with running("agent", "r1", "--log-format", "json", "--connect", server.endpoint) as agent:
            assert agent.stderr is not None
            claimed = json.loads(agent.stderr.readline())
        assert server.process.stderr is not None
        texts = [server.process.stderr.readline() for _ in range(4)]
    lines = [json.loads(text) for text in texts if text.startswith("{")]

    assert (claimed["event"], claimed["level"]) == ("claimed", "INFO")
    assert claimed["world"] == "default"
    assert {"serving", "event"} <= {line["event"] for line in lines}
    assert {line["world"] for line in lines} == {"default"}
    assert all(line["ts"].endswith("Z") and line["logger"] for line in lines)


def test_unknown_log_format_is_refused() -> None:
    done = zensim("serve", "--log-format", "xml")

    assert done.returncode == ExitCode.USAGE
    assert len(done.stderr.splitlines()) == 1
