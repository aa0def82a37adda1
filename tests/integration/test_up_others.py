"""Robots that others spawn into `zensim up`: by ROS 2, by a command, by the Python client."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

import zensim as api
from tests.integration import ros_interfaces as ros
from tests.integration.processes import (
    Server,
    agent_of,
    children,
    connected,
    eventually,
    free_endpoint,
    read_json_line,
    run_in_process,
    running,
)
from tests.integration.robots import robot, speed
from tests.integration.ros_client_process import make_service_call, run_observer
from zensim.proto.exit_codes import ExitCode
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.spawner.client.sim_client import SimClient

MOVING_M_S = 0.05
SOON_S = 30.0
SMALL = ("--engine", "mujoco", "--no-viewer", "--behaviour", "none")


@dataclass(frozen=True)
class RunningUp(Server):
    """`zensim up`."""

    ready: dict[str, object]

    def list_pools(self) -> list[int]:
        """List the process ids of its pools."""
        return [pid for pid in children(self.process.pid) if is_pool(pid)]


def is_pool(pid: int) -> bool:
    try:
        return '"pool_limit":0' in " ".join(psutil.Process(pid).cmdline())
    except psutil.NoSuchProcess:
        return False


@contextmanager
def up(*arguments: str) -> Iterator[RunningUp]:
    endpoint = free_endpoint()
    given = ("--json", "--listen", endpoint, *SMALL, *arguments)
    with running("up", *given) as process, connected(endpoint, process) as bus:
        ready = read_json_line(process)
        yield RunningUp(process, endpoint, bus, SimClient(bus), ready)


@pytest.fixture(autouse=True)
def own_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the records of these runs apart from those of the user."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def moves_when_commanded(server: RunningUp, name: str) -> bool:
    driver = robot(server.bus, name)

    def moves() -> bool:
        driver.command(0.3)
        return speed(server, name) > MOVING_M_S

    return eventually(moves, SOON_S, f"motion of {name}")


def spawn_by_command(server: RunningUp, name: str) -> None:
    place = ("-x", "3.0", "--connect", server.endpoint)
    assert run_in_process("spawn", "box_bot", "--name", name, *place).returncode == ExitCode.OK


def spawn_by_python(server: RunningUp, name: str) -> None:
    with api.connect(server.endpoint) as sim:
        sim.spawn("box_bot", name, x=6.0)


def spawn_by_ros(server: RunningUp, name: str) -> None:
    with run_observer(server, 0, ros.OF_HUMBLE) as observe:
        reply = make_service_call(observe)(
            "/spawn_entity",
            "gazebo_msgs/srv/SpawnEntity",
            ros.OF_HUMBLE,
            name=name,
            xml=read_builtin_model("box_bot"),
            robot_namespace=name,
            initial_pose={"position": {"x": 9.0, "z": 0.06}, "orientation": {"w": 1.0}},
        )
    assert reply is not None
    assert reply["success"], reply


@pytest.mark.parametrize("robots", [0, 1])
def test_robots_that_others_spawn_drive_and_one_pool_drives_them_all(robots: int) -> None:
    with up("--robots", str(robots), "--ros-domain", "0", "--ros-distro", "humble") as server:
        assert server.list_pools() == []

        spawn_by_ros(server, "from_ros")
        assert moves_when_commanded(server, "from_ros")
        spawn_by_command(server, "from_command")
        spawn_by_python(server, "from_python")
        assert moves_when_commanded(server, "from_command")
        assert moves_when_commanded(server, "from_python")

        others = {agent_of(server, name) for name in ("from_ros", "from_command", "from_python")}
        assert len(others) == 1
        assert len(server.list_pools()) == 1
        if robots:
            assert agent_of(server, "box_bot0").startswith("agent_box_bot0")
    assert server.ready["drives_others"] is True


def test_robot_of_another_drives_again_when_it_was_deleted_and_spawned_anew() -> None:
    with up("--robots", "0") as server:
        for _ in range(2):
            spawn_by_command(server, "again")
            assert moves_when_commanded(server, "again")
            server.client.delete("again")


def test_deleted_robot_of_up_goes_back_to_its_own_agent_beside_a_pool() -> None:
    with up("--robots", "1") as server:
        spawn_by_command(server, "other")
        assert moves_when_commanded(server, "other")
        server.client.delete("box_bot0")

        spawn_by_command(server, "box_bot0")

        own = "agent_box_bot0"
        eventually(lambda: agent_of(server, "box_bot0").startswith(own), SOON_S, "its agent")
        assert moves_when_commanded(server, "box_bot0")
        assert agent_of(server, "box_bot0").startswith(own)


def test_agent_that_names_a_robot_takes_it_from_the_pool_and_leaves_it_to_the_pool() -> None:
    with up("--robots", "0") as server:
        spawn_by_command(server, "r1")
        pool = eventually(lambda: agent_of(server, "r1") or None, SOON_S, "a pool")

        with running("agent", "r1", "--name", "own", "--connect", server.endpoint):
            eventually(lambda: agent_of(server, "r1") == "own", SOON_S, "its own agent")
            assert moves_when_commanded(server, "r1")

        eventually(lambda: agent_of(server, "r1") == pool, SOON_S, "the pool")


def test_nothing_drives_robots_of_others_if_an_option_says_so() -> None:
    with up("--robots", "1", "--no-drive-others") as server:
        spawn_by_command(server, "from_command")
        with running("agent", "from_command", "--name", "own", "--connect", server.endpoint):
            eventually(lambda: agent_of(server, "from_command") == "own", SOON_S, "its agent")

        assert server.list_pools() == []
    assert server.ready["drives_others"] is False


def test_secured_up_drives_robots_of_others_by_a_pool_with_a_token_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with running(
        "up", "--secure", "--json", "--listen", free_endpoint(), "--robots", "1", *SMALL
    ) as process:
        read_json_line(process)
        join = ("--join", f"@{tmp_path / 'zensim' / 'default' / 'operator.token'}")
        done = run_in_process("spawn", "box_bot", "--name", "r1", "-x", "3.0", *join)
        assert done.returncode == ExitCode.OK, done.stderr

        def find_agent() -> str | None:
            listed = json.loads(run_in_process("list", "--json", *join).stdout)
            return next((one["agent"] for one in listed if one["name"] == "r1"), "") or None

        assert eventually(find_agent, SOON_S, "a pool") == "pool"


def test_pools_of_all_robots_cannot_leave_those_of_others_alone() -> None:
    done = run_in_process("up", "--agents", "pooled", "--no-drive-others", *SMALL)

    assert done.returncode == ExitCode.USAGE
    assert "per-robot" in done.stderr
