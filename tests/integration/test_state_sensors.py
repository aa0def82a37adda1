"""IMU, navsat and bumper of robots over a real network, from single agents and from pools."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.integration.processes import (
    Server,
    agent_of,
    eventually,
    running,
    running_up,
    serving,
    wait_for_agents,
)
from tests.integration.robots import drive_for, robot
from tests.models import POLE_TOPICS, SENSOR_POLE
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.gazebo_messages import ContactsState
from zensim.proto.messages.standard_messages import Imu, NavSatFix, ns_from_time
from zensim.proto.messages.telemetry_messages import Event
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.spawner.client.sim_client import SimClient

GPS = """<gazebo reference="base_link"><sensor type="gps" name="gps"><update_rate>10</update_rate>
<plugin name="gps" filename="libgazebo_ros_gps_sensor.so">
<ros><remapping>~/out:=fix</remapping></ros></plugin></sensor></gazebo></robot>"""
WORLD = """<sdf version="1.10"><world name="field">
<include><uri>model://ground_plane</uri></include>
<spherical_coordinates><latitude_deg>48</latitude_deg><longitude_deg>11</longitude_deg>
</spherical_coordinates>
<model name="wall"><static>true</static><pose>0.7 0 0.1 0 0 0</pose><link name="link">
<collision name="brick"><geometry><box><size>0.2 2 0.2</size></box></geometry></collision>
</link></model></world></sdf>"""
WALL = "wall::link::brick"


@contextmanager
def an_agent(server: Server, kind: str) -> Iterator[None]:
    who = ("--pool", "0", "--name", "p") if kind == "pool" else ("r1",)
    with running("agent", *who, "--connect", server.endpoint):
        eventually(lambda: agent_of(server, "r1"), 20.0, "an agent of r1")
        yield


@pytest.mark.parametrize("kind", [pytest.param("alone", marks=pytest.mark.long_form), "pool"])
def test_robot_feels_itself_and_the_wall_that_it_drives_into(tmp_path: Path, kind: str) -> None:
    model, world = tmp_path / "seeing.urdf", tmp_path / "field.sdf"
    model.write_text(read_builtin_model("box_bot_lidar").replace("</robot>", GPS))
    world.write_text(WORLD)
    with serving("--world", str(world)) as server:
        spawned = server.zensim("spawn", str(model), "--name", "r1", "--json")
        assert spawned.returncode == 0, spawned.stderr
        with an_agent(server, kind):
            imu = server.bus.subscribe("r1/imu", 100_000)
            fix = server.bus.subscribe("r1/fix", 100_000)
            bumper = server.bus.subscribe("r1/bumper_states", 100_000)
            events = server.bus.subscribe("sim/default/events", 1000)
            seen = robot(server.bus, "r1")
            drive_for(server.client, [seen], linear=0.25, angular=0.0, sim_s=4.0)

            felt = [decode(Imu, one.payload, one.encoding) for one in imu.take()]
            places = [decode(NavSatFix, one.payload, one.encoding) for one in fix.take()]
            touched = [decode(ContactsState, one.payload, one.encoding) for one in bumper.take()]
            events_taken = [decode(Event, one.payload, one.encoding) for one in events.take()]

    check_motion(felt, places)
    check_bumper(touched)
    assert [event.entity for event in events_taken if event.kind == "touched"][:1] == ["r1"]


def check_motion(felt: list[Imu], places: list[NavSatFix]) -> None:
    stamps = [ns_from_time(message.header.stamp) * 1e-9 for message in felt]
    assert (len(felt) - 1) / (stamps[-1] - stamps[0]) == pytest.approx(50.0, rel=0.05)
    assert felt[0].header.frame_id == "imu_link"
    up = [message.linear_acceleration.z for message in felt]
    assert sum(up) / len(up) == pytest.approx(9.8, abs=0.1)
    assert felt[0].linear_acceleration_covariance[0] == pytest.approx(4e-4)
    assert places[0].latitude == pytest.approx(48.0, abs=1e-5)
    assert places[-1].longitude > places[0].longitude + 3e-6


def check_bumper(touched: list[ContactsState]) -> None:
    states = [message.states for message in touched]
    assert states[0] == ()
    assert {state.collision2_name for found in states for state in found} == {WALL}
    (pushed, *_) = next(found for found in states if found)
    assert pushed.collision1_name.startswith("r1::base_link::")
    assert pushed.total_wrench.force.x < 0.0


def run_in_lockstep(kind: str) -> dict[str, list[bytes]]:
    """Drive two robots towards each other; return the messages of their IMUs and bumpers."""
    names = ("r1", "r2")
    with serving("--paused", "--lockstep", "--on-miss", "wait", "--seed", "7") as server:
        for x, name in enumerate(names):
            spawned = server.zensim("spawn", "box_bot_lidar", "--name", name, "-x", str(0.3 * x))
            assert spawned.returncode == 0, spawned.stderr
        topics = [
            server.bus.subscribe(f"{name}/{topic}", 100_000)
            for name in names
            for topic in ("imu", "bumper_states")
        ]
        who = ("--pool", "0", "--name", "p") if kind == "pool" else names
        with running("agent", *who, "--cmd-vel-timeout", "0", "--connect", server.endpoint):
            wait_for_agents(server, names)
            fleet = [robot(server.bus, name) for name in names]
            eventually(lambda: len(server.bus.get("*/odom")) == len(names), 20.0, "odometry")
            for one in fleet:
                one.command(0.3)
            # Publishers and contacts are found within this wall time.
            for _ in range(20):
                server.client.simulate_steps(60)
            found: dict[str, list[bytes]] = {}
            for topic in topics:
                for sample in topic.take():
                    found.setdefault(sample.key, []).append(sample.payload)
    return found


def test_imu_and_bumper_give_equal_bytes_in_a_pool_and_alone() -> None:
    runs = [run_in_lockstep(kind) for kind in ("alone", "pool")]

    for key in ("r1/imu", "r2/imu", "r1/bumper_states", "r2/bumper_states"):
        last = [set(run[key][-100:]) for run in runs]
        assert len(last[0]) == 100
        assert last[0] == last[1], key


@pytest.mark.parametrize("agents", ["per-robot", "pooled"])
def test_sensors_without_a_drive_publish_in_deployments(tmp_path: Path, agents: str) -> None:
    model = tmp_path / "pole.urdf"
    model.write_text(SENSOR_POLE)
    options = ("--engine", "mujoco", "--no-viewer", "--sensors", "0")
    with running_up("--robots", "1", "--model", str(model), "--agents", agents, *options) as up:
        bus = up[2]
        client = SimClient(bus)
        (name,) = client.entities()
        namespace = client.entity_model(name).namespace
        queues = {topic: bus.subscribe(f"{namespace}/{topic}", 100) for topic in POLE_TOPICS}
        received = dict.fromkeys(POLE_TOPICS, 0)

        def has_all() -> bool:
            for topic, queue in queues.items():
                received[topic] += len(queue.take())
            return all(received.values())

        eventually(has_all, 30.0, "a message on each topic")
