"""`zensim vda5050` between a world and a real broker, with masters that share no code with it."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zensim as api
from tests.contract.repository import ROOT
from tests.integration.brokers import WITHIN_S, Broker, Master, State, serving_broker
from tests.integration.processes import eventually, kill, read_json_line, running
from tests.node_peers.foxglove_peer import FoxglovePeer
from tests.node_peers.node_packages import FOLDER, start_script
from tests.zensim.vda5050.orders import action, edge, header, node, order
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.messages.vehicle_messages import FleetStatus, VehicleStatus
from zensim.proto.topic_catalog import VEHICLES
from zensim.spawner.client.topic_reader import read_topic
from zensim.vda5050.broker_links import BrokerLinks, parse_broker

NUMBERS = count()


@pytest.fixture(scope="module")
def sim() -> Iterator[api.Sim]:
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        for number in range(1, 4):
            sim.spawn("box_bot", name=f"r{number}", y=2.0 * number)
        sim.play()
        yield sim


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    with serving_broker(tmp_path_factory.mktemp("broker")) as broker:
        yield broker


@contextmanager
def vehicles(sim: api.Sim, broker: Broker, *options: str) -> Iterator["subprocess.Popen[str]"]:
    connections = ("--broker", broker.url, "--connect", sim.endpoint, "--json")
    with running("vda5050", *connections, *options) as process:
        read_json_line(process)
        yield process


@contextmanager
def connected(broker: Broker, root: str = "uagv/v2/zensim") -> Iterator[Master]:
    master = Master(broker, root)
    try:
        yield master
    finally:
        master.close()


def find_place(state: State) -> tuple[float, float]:
    where = state.get("agvPosition") or state["mobileRobotPosition"]
    return where["x"], where["y"]


def make_way(state: State, *ways: float, major: int = 2) -> dict[str, Any]:
    """Make an order from where a vehicle is, with a node after each way along x [m]."""
    x, y = find_place(state)
    nodes = [node(0, (x, y)), *(node(2 * at, (x + way, y)) for at, way in enumerate(ways, 1))]
    edges = [edge(2 * at - 1) for at in range(1, len(ways) + 1)]
    return order(nodes, edges, f"order{next(NUMBERS)}", major=major)


def is_done(given: dict[str, Any]) -> Callable[[State], bool]:
    return lambda state: (
        state["orderId"] == given["orderId"]
        and not state["nodeStates"]
        and not state["driving"]
        and all(one["actionStatus"] in ("FINISHED", "FAILED") for one in state["actionStates"])
    )


def is_of(name: str, event: dict[str, Any]) -> bool:
    return bool(event["robot"] == name)


def instant(name: str, major: int = 2, **parameters: object) -> dict[str, Any]:
    return header(major) | {
        "actions": [action(name, f"instant{next(NUMBERS)}", "NONE", **parameters)]
    }


@pytest.mark.parametrize(
    ("standard", "root", "position"),
    [("2.1", "uagv/v2/zensim", "agvPosition"), ("3.0", "vda5050/v3/zensim", "mobileRobotPosition")],
)
def test_vehicle_drives_an_order_with_an_update_and_an_action(
    sim: api.Sim, broker: Broker, standard: str, root: str, position: str
) -> None:
    major = int(standard[0])
    with connected(broker, root) as master, vehicles(sim, broker, "--standard", standard):
        first = master.wait("r1", lambda _: True)
        given = make_way(first, 0.6, 1.2, major=major)
        given["nodes"][1]["actions"] = [action("wait", "w", duration=0.3)]
        given["nodes"][2]["released"] = given["edges"][1]["released"] = False
        master.send("r1", "order", given)
        waiting = master.wait("r1", lambda one: one["newBaseRequest"] and not one["driving"])
        update = given | {"orderUpdateId": 1}
        update |= {"nodes": [dict(one, released=True) for one in given["nodes"][1:]]}
        update["edges"] = [given["edges"][1] | {"released": True}]
        master.send("r1", "order", update)
        done = master.wait("r1", is_done(given))

    assert waiting["errors"] == done["errors"] == []
    assert done["lastNodeId"] == "n4"
    assert find_place(done)[0] == pytest.approx(find_place(first)[0] + 1.2, abs=0.05)
    assert [one["actionStatus"] for one in done["actionStates"]] == ["FINISHED"]
    numbers = [one["headerId"] for one in master.list("r1")]
    assert numbers == list(range(len(numbers)))
    assert {"version", "manufacturer", "serialNumber", "timestamp", position} <= set(done)
    assert re.fullmatch(r"\d{4}(-\d\d){2}T\d\d(:\d\d){2}\.\d{3}Z", done["timestamp"])
    assert [one["connectionState"] for one in master.list("r1", "connection")][-1] == "OFFLINE"


def test_a_command_by_hand_takes_over_until_the_fleet_manager_goes_on(
    sim: api.Sim, broker: Broker
) -> None:
    with connected(broker) as master, vehicles(sim, broker):
        master.send("r2", "order", make_way(master.wait("r2", lambda _: True), 5.0))
        master.wait("r2", lambda one: one["driving"])
        sim.robots["r2"].topic("cmd_vel").put(Twist())
        master.wait("r2", lambda one: one["paused"] and not one["driving"])
        since = len(master.list("r2"))
        master.send("r2", "instantActions", instant("stopPause"))
        gone_on = master.wait("r2", lambda one: one["driving"], since=since)
        master.send("r2", "instantActions", instant("cancelOrder"))
        master.wait("r2", lambda one: not one["driving"], since=since)

    assert (gone_on["operatingMode"], gone_on["paused"]) == ("AUTOMATIC", False)


def test_vehicle_is_paused_and_canceled(sim: api.Sim, broker: Broker) -> None:
    with connected(broker) as master, vehicles(sim, broker):
        given = make_way(master.wait("r2", lambda _: True), 5.0)
        master.send("r2", "order", given)
        master.wait("r2", lambda one: one["driving"])
        master.send("r2", "instantActions", instant("startPause"))
        paused = master.wait("r2", lambda one: one["paused"] and not one["driving"])
        master.send("r2", "instantActions", instant("stopPause"))
        since = len(master.list("r2"))
        master.wait("r2", lambda one: one["driving"], since=since)
        cancel = instant("cancelOrder")
        master.send("r2", "instantActions", cancel)
        number = cancel["actions"][0]["actionId"]
        done = master.wait(
            "r2", lambda one: _status(one, number) == "FINISHED" and not one["driving"]
        )
        master.send("r2", "instantActions", again := instant("cancelOrder"))
        number = again["actions"][0]["actionId"]
        refused = master.wait("r2", lambda one: _status(one, number) == "FAILED")

    assert [one["nodeId"] for one in paused["nodeStates"]] == ["n2"]
    assert (done["nodeStates"], done["edgeStates"], done["driving"]) == ([], [], False)
    assert find_place(done)[0] < 4.0
    assert [one["errorType"] for one in refused["errors"]] == ["noOrderToCancel"]


def _status(state: State, number: str) -> str:
    found = {one["actionId"]: one["actionStatus"] for one in state["actionStates"]}
    return str(found.get(number))


def test_wrong_messages_are_reported_and_change_nothing(sim: api.Sim, broker: Broker) -> None:
    with connected(broker) as master, vehicles(sim, broker):
        first = master.wait("r3", lambda _: True)
        far = make_way(first, 1.0)
        far["nodes"][0]["nodePosition"]["x"] += 9.0
        found = []
        for wrong in (b"\xff{", b"[" * 100_000, far, make_way(first, 1.0) | {"nodes": []}):
            known = len(master.list("r3"))
            master.send("r3", "order", wrong)
            state = master.wait("r3", lambda one: one["errors"], since=known)
            found.append((state["errors"][-1]["errorType"], state["errors"][-1]["errorLevel"]))
        master.send("r3", "order", good := make_way(first, 0.3))
        done = master.wait("r3", is_done(good))

    types = ["validationError", "validationError", "noRouteError", "validationError"]
    assert found == [(one, "WARNING") for one in types]
    assert done["errors"] == []


def test_order_outlives_a_broker_and_a_killed_program(
    sim: api.Sim, broker: Broker, tmp_path: Path
) -> None:
    file = ("--state", str(tmp_path / "vehicles.db"))
    with vehicles(sim, broker, *file) as process, connected(broker) as master:
        first = master.wait("r1", lambda _: True)
        given = make_way(first, -0.4, -1.2)
        given["nodes"][1]["actions"] = [action("wait", "once", duration=0.2)]
        master.send("r1", "order", given)
        master.wait("r1", lambda one: one["driving"])
        broker.kill()
        broker.start()
        master.wait("r1", lambda one: one["lastNodeId"] == "n2")
        kill(process.pid, signal.SIGKILL)
        process.wait()
    with connected(broker) as master:
        broken = master.wait("r1", lambda _: True, "connection")
        with vehicles(sim, broker, *file):
            master.send("r1", "order", given)
            done = master.wait("r1", is_done(given))
            master.send("r1", "order", given)
            master.send("r1", "instantActions", asked := instant("stateRequest"))
            number = asked["actions"][0]["actionId"]
            after = master.wait("r1", lambda one: _status(one, number) == "FINISHED")

    assert broken["connectionState"] == "CONNECTIONBROKEN"
    assert done["lastNodeId"] == after["lastNodeId"] == "n4"
    runs = [_status(one, "once") for one in master.list("r1")]
    assert set(runs) <= {"RUNNING", "FINISHED"}
    assert find_place(after)[0] == pytest.approx(find_place(first)[0] - 1.2, abs=0.06)
    assert not after["driving"]


def test_who_looks_at_the_world_hears_what_vehicles_do(sim: api.Sim, broker: Broker) -> None:
    with (
        open_bus(BusConfig(connect=(sim.endpoint,))) as bus,
        closing(read_topic(bus, VEHICLES.key("default"), FleetStatus, 64)) as reports,
        connected(broker) as master,
        vehicles(sim, broker),
    ):
        first = master.wait("r1", lambda _: True)
        given = make_way(first, 0.6)
        master.send("r1", "order", given)

        def find(task: str) -> Callable[[], VehicleStatus | None]:
            return lambda: next(
                (
                    one
                    for fleet in reports.take()
                    for one in fleet.vehicles
                    if (one.entity, one.task, one.order) == ("r1", task, given["orderId"])
                ),
                None,
            )

        driving = eventually(find("driving"), WITHIN_S)
        arrived = eventually(find("idle"), WITHIN_S)

    route = np.frombuffer(driving.route, "<f4").reshape(-1, 2)
    last = given["nodes"][-1]
    assert driving.goal == last["nodeId"]
    place = last["nodePosition"]
    assert route[-1] == pytest.approx([place["x"], place["y"]], abs=1e-3)
    assert (arrived.last_node, arrived.goal, arrived.route) == (last["nodeId"], "", b"")


def test_unchanged_master_control_drives_vehicles(sim: api.Sim, broker: Broker) -> None:
    with (
        connected(broker) as master,
        start_script(FOLDER / "master_control.cjs", broker.url, "uagv") as process,
    ):
        peer = FoxglovePeer(process)
        peer.wait("ready")
        with vehicles(sim, broker, "--standard", "2.0"):
            first = {name: master.wait(name, lambda _: True) for name in ("r2", "r3")}
            for name, state in first.items():
                given = make_way(state, 0.4, 0.8)
                given["nodes"][1]["actions"] = [action("wait", f"{name}w", duration=0.1)]
                peer.do("order", robot=name, order=given | {"serialNumber": name})
            seen = [peer.wait("processed", partial(is_of, name)) for name in first]
            peer.wait("tracked", lambda one: one["robot"] == "r2")
            long = make_way(master.list("r2")[-1], 5.0)
            peer.do("order", robot="r2", order=long | {"serialNumber": "r2"})
            eventually(lambda: master.list("r2")[-1]["driving"], WITHIN_S)
            peer.do("instant", robot="r2", actions=[action("cancelOrder", "gone", "NONE")])
            ended = peer.wait(
                "action", lambda one: one["status"] == "FINISHED" and one["action"] == "gone"
            )

    assert [one["error"] for one in seen] == [None, None]
    assert ended["robot"] == "r2"


def test_manager_of_the_tutorial_moves_every_robot(
    sim: api.Sim, broker: Broker, tmp_path: Path
) -> None:
    text = (ROOT / "docs" / "vda5050.md").read_text()
    settings = re.search(r"```json\n(.*?)```", text, re.DOTALL)
    assert settings is not None
    (file := tmp_path / "vehicles.json").write_text(settings.group(1))

    with (
        subprocess.Popen(
            [sys.executable, ROOT / "examples" / "fleet_manager.py", str(broker.port)],
            stdout=subprocess.PIPE,
            text=True,
        ) as manager,
        vehicles(sim, broker, "--vehicles", str(file)),
    ):
        assert manager.stdout is not None
        lines = [manager.stdout.readline().split()[0] for _ in range(3)]
        manager.kill()

    assert sorted(lines) == ["r1", "r2", "r3"]
    assert set(json.loads(file.read_text())) >= {"max_speed", "battery"}


def test_line_says_that_the_broker_is_back(broker: Broker) -> None:
    notes: list[str] = []
    address = parse_broker(broker.url)
    links = BrokerLinks(address, topic_root="uagv/v2/notes", version="2.1.0", note=notes.append)
    links.add("r1")

    def connects() -> bool:
        links.poll(0.01)
        return bool(links.take_connected())

    with closing(links):
        eventually(connects, WITHIN_S)
        assert notes == []
        broker.kill()
        eventually(lambda: bool(links.poll(0.01) or notes), WITHIN_S)
        broker.start()
        eventually(connects, WITHIN_S)

    assert len(notes) > 1
    assert "connected again" in notes[-1]
