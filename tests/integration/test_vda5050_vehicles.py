"""`zensim vda5050` with vehicles of each drive, obstacles, loads, and a server that is killed."""

from collections.abc import Iterator
from pathlib import Path

import pytest

import zensim as api
from tests.integration.brokers import Broker, Master, State, serving_broker
from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import free_endpoint, read_json_line, running, running_agents
from tests.zensim.vda5050.orders import action, edge, node, order

DRIVES = ("skid_bot", "omni_bot", "car_bot", "trike_bot")
BOX = """<robot name="crate"><link name="crate"><inertial><mass value="0.2"/>
<inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
<visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual></link></robot>"""


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with serving_broker(tmp_path) as broker:
        yield broker


@pytest.fixture
def master(broker: Broker) -> Iterator[Master]:
    master = Master(broker)
    yield master
    master.close()


def find_place(state: State) -> tuple[float, float]:
    return state["agvPosition"]["x"], state["agvPosition"]["y"]


def make_order(state: State, *ways: tuple[float, float], name: str = "o1") -> State:
    """Make an order with a node at each way from where a vehicle is [m]."""
    x, y = find_place(state)
    places = [(x, y), *((x + ahead, y + left) for ahead, left in ways)]
    nodes = [node(2 * at, place) for at, place in enumerate(places)]
    return order(nodes, [edge(2 * at + 1) for at in range(len(ways))], name)


def test_vehicles_of_each_drive_follow_their_orders(broker: Broker, master: Master) -> None:
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        for number, model in enumerate(DRIVES):
            sim.spawn(model, name=model, y=5.0 * number)
        sim.play()
        with running("vda5050", "--broker", broker.url, "--connect", sim.endpoint):
            begins = {name: master.wait(name, lambda _: True) for name in DRIVES}
            for name, state in begins.items():
                given = make_order(state, (1.5, 0.0), (2.5, 0.3), (4.0, 0.3), name=name)
                master.send(name, "order", given)
            ends = {
                name: master.wait(name, lambda one: one["lastNodeId"] == "n6") for name in DRIVES
            }

    for name, end in ends.items():
        x, y = find_place(begins[name])
        assert find_place(end) == pytest.approx((x + 4.0, y + 0.3), abs=0.12), name
        assert end["errors"] == [], name
    kinds = [
        master.list(name, "factsheet")[0]["typeSpecification"]["agvKinematic"] for name in DRIVES
    ]
    assert kinds == ["DIFF", "OMNI", "THREEWHEEL", "THREEWHEEL"]


def test_vehicle_stops_before_another_and_goes_on_when_it_is_gone(
    broker: Broker, master: Master
) -> None:
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        sim.spawn("box_bot", name="r1")
        other = sim.spawn("box_bot", name="other", x=2.5)
        sim.play()
        options = ("--avoid", "stop", "--robots", "r*")
        with running("vda5050", "--broker", broker.url, "--connect", sim.endpoint, *options):
            begin = master.wait("r1", lambda _: True)
            master.send("r1", "order", make_order(begin, (4.0, 0.0)))
            stopped = master.wait(
                "r1", lambda one: one["safetyState"]["fieldViolation"] and not one["driving"]
            )
            other.delete()
            done = master.wait("r1", lambda one: one["lastNodeId"] == "n2" and not one["driving"])

    assert 1.0 < find_place(stopped)[0] < 2.2
    assert find_place(done)[0] == pytest.approx(4.0, abs=0.06)
    assert not done["safetyState"]["fieldViolation"]
    assert master.list("other") == []


def test_vehicle_carries_a_load(broker: Broker, master: Master, tmp_path: Path) -> None:
    (crate := tmp_path / "crate.urdf").write_text(BOX)
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        sim.spawn("box_bot", name="r1")
        sim.spawn(crate, name="crate", x=-1.0, z=0.1)
        sim.play()
        with running("vda5050", "--broker", broker.url, "--connect", sim.endpoint):
            begin = master.wait("r1", lambda _: True)
            given = make_order(begin, (2.0, 0.0))
            given["nodes"][0]["actions"] = [action("pick", "p", loadId="crate")]
            given["nodes"][1]["actions"] = [action("drop", "d")]
            master.send("r1", "order", given)
            carried = master.wait("r1", lambda one: one["loads"] and one["lastNodeId"] == "n2")
            on_top = sim.entities["crate"].pose
            done = master.wait("r1", lambda one: one["lastNodeId"] == "n2" and not one["loads"])
            sim.run_for(1.0)
            put_down = sim.entities["crate"].pose

    assert carried["loads"] == [{"loadId": "crate"}]
    assert {one["actionStatus"] for one in done["actionStates"]} == {"FINISHED"}
    assert on_top.z > 0.15
    assert on_top.x == pytest.approx(2.0, abs=0.3)
    assert put_down.x == pytest.approx(1.6, abs=0.3)
    assert put_down.z == pytest.approx(0.1, abs=0.05)


def test_order_outlives_a_killed_server(broker: Broker, master: Master, tmp_path: Path) -> None:
    endpoint, journal = free_endpoint(), tmp_path / "journal"
    with serving_with_journal(journal, endpoint) as server:
        assert server.zensim("spawn", "box_bot", "--name", "r1").returncode == 0
        with (
            running_agents(server, "r1"),
            running("vda5050", "--broker", broker.url, "--connect", endpoint, "--json") as program,
        ):
            read_json_line(program)
            begin = master.wait("r1", lambda _: True)
            master.send("r1", "order", make_order(begin, (0.5, 0.0), (2.0, 0.0)))
            master.wait("r1", lambda one: one["lastNodeId"] == "n2")
            kill_hard(server)
            lost = master.wait("r1", lambda one: one["errors"])
            with serving_with_journal(journal, endpoint):
                done = master.wait("r1", lambda one: one["lastNodeId"] == "n4")

    assert [one["errorType"] for one in lost["errors"]] == ["localizationError"]
    assert find_place(done)[0] == pytest.approx(2.0, abs=0.06)
    assert done["errors"] == []
