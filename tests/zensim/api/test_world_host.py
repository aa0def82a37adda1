"""The server in this process: services, steps, drives, topics."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import zensim
from zensim.api.in_process_world import get_server
from zensim.api.world_host import WorldHost
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.result_messages import ResultCode, ServiceError, SpawnCode
from zensim.proto.messages.simulation_messages import ResetSimulationRequest, SimulateStepsRequest
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
)
from zensim.proto.messages.standard_messages import (
    Odometry,
    Point,
    Pose,
    PoseStamped,
    String,
    Twist,
    Vector3,
)
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.messages.world_messages import LoadWorldRequest
from zensim.proto.service_catalog import (
    DELETE_ENTITY,
    LOAD_WORLD,
    RESET_SIMULATION,
    SIMULATE_STEPS,
    SPAWN_ENTITIES,
    SPAWN_ENTITY,
)
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.start_settings import StartSettings
from zensim.sim_server.server_config import ConfigError, ServerConfig

MUJOCO = ServerConfig(
    settings=ServerSettings(
        start=StartSettings(paused=True), physics=EngineSettings(engine="mujoco", engine_workers=0)
    )
)


@pytest.fixture
def server() -> Iterator[WorldHost]:
    found = WorldHost(MUJOCO)
    yield found
    found.close()


def spawn(server: WorldHost, *names: str) -> None:
    poses = [PoseStamped(pose=Pose(Point(2.0 * row, 0.0, 0.0))) for row in range(len(names))]
    orders = [SpawnEntity(name, initial_pose=pose) for name, pose in zip(names, poses, strict=True)]
    common = SpawnEntityOrder(entity_resource=Resource("box_bot"), snap_to_ground=True)
    server.call(SPAWN_ENTITIES, SpawnEntitiesOrder(tuple(orders), common=common))


def read_base(server: WorldHost) -> np.ndarray:
    return np.frombuffer(server.snapshot().base).reshape(-1, STATE_COLUMNS)


def send_twist(server: WorldHost, name: str, v: float, w: float) -> None:
    message = Twist(Vector3(v), Vector3(0.0, 0.0, w))
    publisher = server.network.advertise(f"{name}/cmd_vel", make_encoding(message, Format.CDR))
    publisher.send(encode(message, Format.CDR))


def test_a_spawned_robot_is_claimed_by_the_pool_at_once(server: WorldHost) -> None:
    spawn(server, "r1", "r2")

    assert server.world.claims.agent_of("r1") == server.world.claims.agent_of("r2") == "pool"


def test_a_robot_drives_as_its_newest_cmd_vel_says_until_the_timeout(server: WorldHost) -> None:
    spawn(server, "r1")
    server.step(120)

    send_twist(server, "r1", 0.3, 0.0)
    server.step(120)
    moved = read_base(server)[0, 0]
    server.step(240)

    assert moved > 0.08
    assert abs(read_base(server)[0, 7]) < 1e-2


def test_requested_steps_are_made_before_the_response(server: WorldHost) -> None:
    response = server.call(SIMULATE_STEPS, SimulateStepsRequest(7))

    assert response.completed_steps == 7
    assert server.world.clock.steps == 7


def test_a_refusal_is_that_of_a_server(server: WorldHost) -> None:
    spawn(server, "r1")
    order = SpawnEntityOrder("r1", entity_resource=Resource("box_bot"))

    with pytest.raises(ServiceError) as refused:
        server.call(SPAWN_ENTITY, order)

    assert refused.value.code == SpawnCode.NAME_NOT_UNIQUE
    assert refused.value.code_name == "NAME_NOT_UNIQUE"


def test_a_request_of_a_wrong_type_is_refused_as_malformed(server: WorldHost) -> None:
    with pytest.raises(ServiceError) as refused:
        server.call(DELETE_ENTITY, DeleteEntityRequest(7))  # type: ignore[arg-type]

    assert refused.value.code == ResultCode.OPERATION_FAILED


def test_deleted_robots_are_not_driven_any_more(server: WorldHost) -> None:
    spawn(server, "r1", "r2")

    server.call(DELETE_ENTITY, DeleteEntityRequest("r1"))
    server.step(6)

    assert server.snapshot().names == ("r2",)
    assert len(server.world.claims) == 1


def test_equal_orders_after_a_reset_give_equal_bytes(server: WorldHost) -> None:
    def run() -> bytes:
        spawn(server, "r1", "r2")
        send_twist(server, "r2", 0.4, 0.5)
        server.step(300)
        return server.snapshot().base

    first = run()
    server.call(RESET_SIMULATION, ResetSimulationRequest())
    second = run()
    other = WorldHost(MUJOCO)
    server, other = other, server
    third = run()
    server.close()

    assert first == second == third


def test_odometry_is_published_to_a_subscriber_in_this_process(server: WorldHost) -> None:
    spawn(server, "r1")
    odom = server.subscribe("r1/odom", 8)
    description = server.subscribe("r1/robot_description", 1)

    send_twist(server, "r1", 0.3, 0.0)
    server.step(60)

    sample = odom.newest()
    assert sample is not None
    assert decode(Odometry, sample.payload, sample.encoding).twist.twist.linear.x > 0.1
    text = description.newest()
    assert text is not None
    assert "box_bot" in decode(String, text.payload, text.encoding).data


def test_events_are_published_to_subscribers_only(server: WorldHost) -> None:
    spawn(server, "r1")
    events = server.network.subscribe("sim/default/events", 16)

    spawn(server, "r2")

    kinds = [decode(Event, one.payload, one.encoding) for one in events.take()]
    known = [(one.kind, one.entity) for one in kinds if one.kind != "warning"]
    assert known == [("spawned", "r2"), ("claimed", "r2")]


def test_another_world_is_loaded_at_once(server: WorldHost) -> None:
    spawn(server, "r1")

    server.call(LOAD_WORLD, LoadWorldRequest(Resource("walls")))

    assert len(server.snapshot().names) > 1
    assert "r1" not in server.snapshot().names


def test_a_world_file_is_loaded_with_its_own_step(tmp_path: Path) -> None:
    file = tmp_path / "slow.sdf"
    file.write_text(
        '<sdf version="1.7"><world name="slow"><physics type="ode">'
        "<max_step_size>0.01</max_step_size></physics></world></sdf>"
    )

    server = WorldHost(
        ServerConfig(
            settings=ServerSettings(
                start=StartSettings(world=str(file), paused=True),
                physics=EngineSettings(engine="mujoco", engine_workers=0),
            )
        )
    )

    assert server.world.clock.step_ns == 10_000_000
    server.close()


def test_an_unknown_world_is_a_wrong_configuration() -> None:
    with pytest.raises(ConfigError):
        WorldHost(ServerConfig(settings=ServerSettings(start=StartSettings(world="no_such_world"))))


def test_a_world_in_process_loads_neither_network_nor_mesh_libraries() -> None:
    program = (
        "import sys\n"
        "from zensim.api.world_host import WorldHost\n"
        "from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder\n"
        "from zensim.proto.service_catalog import SPAWN_ENTITY\n"
        "from zensim.proto.settings.engine_settings import EngineSettings\n"
        "from zensim.proto.settings.server_settings import ServerSettings\n"
        "from zensim.sim_server.server_config import ServerConfig\n"
        "physics = EngineSettings(engine='mujoco', engine_workers=0)\n"
        "config = ServerConfig(settings=ServerSettings(physics=physics))\n"
        "server = WorldHost(config)\n"
        "server.call(SPAWN_ENTITY, SpawnEntityOrder(entity_resource=Resource('box_bot')))\n"
        "print(*sorted({'zenoh', 'scipy', 'trimesh', 'yourdfpy', 'typer', 'pybullet'}"
        " & sys.modules.keys()))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=600
    )

    assert done.stdout.split() == []


def test_callbacks_of_a_world_in_process_start_no_thread() -> None:
    with zensim.World() as world:
        robot = world.spawn("box_bot", name="r1")
        before = threading.active_count()
        seen: list[Odometry] = []
        robot.topic("odom").on(seen.append)
        assert threading.active_count() == before

        world.run_for(0.5)

        assert seen


def test_an_order_between_control_steps_acts_at_the_next_one() -> None:
    def run(wait: int) -> bytes:
        with zensim.World(seed=1) as world:
            world.spawn("box_bot", name="r1")
            world.step(3 + wait)
            world.robots["r1"].drive(0.3, 0.2)
            world.step(12 - wait)
            return get_server(world).snapshot().base

    assert run(1) == run(2)
