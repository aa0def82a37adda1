"""Processes of ROS 2 over DDS, and the bridge between them and a server, on loopback only."""

import json
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.integration.processes import START_S, Server, end, eventually, running, serving
from tests.integration.sensor_runs import running_sensors
from tests.interop.foreign_peers import MARGIN_S
from tests.interop.ros_build import find_bridge, find_ros_python, prepare_ros
from zensim.proto.messages.spawn_messages import Resource, SpawnEntitiesOrder, SpawnEntity
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.parent_death import PARENT_PID_VARIABLE

FIRST_DOMAIN, DOMAINS = 40, 60
"""Domains of DDS whose ports are below those of clients."""
PROGRAMS = Path(__file__).with_name("ros_programs")
"""Scripts that the interpreter with rclpy runs; they import nothing of zensim."""
PEER, DDS_CLIENT = PROGRAMS / "rclpy_peer.py", PROGRAMS / "dds_client.py"
LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
BRIDGED = ("--ros-bridge",)


@dataclass(frozen=True)
class RosNetwork:
    """What processes of ROS 2 need, and the router that they see through the bridge."""

    endpoint: str
    folder: Path
    domain: int = field(default_factory=lambda: FIRST_DOMAIN + os.getpid() % DOMAINS)

    @property
    def variables(self) -> dict[str, str]:
        """Variables of their environment."""
        return {
            "CYCLONEDDS_URI": LOOPBACK,
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DISTRO": "jazzy",
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_HOME": str(self.folder),
            PARENT_PID_VARIABLE: str(os.getpid()),
        }

    @contextmanager
    def running(self, *command: str) -> Iterator["subprocess.Popen[str]"]:
        """Run a program until the block ends."""
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **self.variables},
        )
        try:
            yield process
        finally:
            end(process)

    def python(self, script: Path, *arguments: str) -> tuple[str, ...]:
        """Make the command of a script that imports rclpy or cyclonedds."""
        return (str(find_ros_python()), str(script), *arguments)

    def run(self, script: Path, *arguments: str) -> dict[str, Any]:
        """Run a script to its end; return the object that it prints."""
        with self.running(*self.python(script, *arguments)) as process:
            printed, errors = process.communicate(timeout=MARGIN_S + START_S)
        assert process.returncode == 0, f"{arguments}: {errors[-2000:]}"
        found: dict[str, Any] = json.loads(printed.splitlines()[-1])
        return found

    @contextmanager
    def bridge(self) -> Iterator["subprocess.Popen[str]"]:
        """Run the bridge as a client of the router, until the block ends."""
        settings = {
            "mode": "client",
            "connect": {"endpoints": [self.endpoint]},
            "scouting": {"multicast": {"enabled": False}},
            # As zenoh-bridge-ros2dds sets it: its latched topics need it.
            "timestamping": {"enabled": True},
            "plugins": {"ros2dds": {"domain": self.domain}},
        }
        path = self.folder / "bridge.json5"
        path.write_text(json.dumps(settings), encoding="utf-8")
        with self.running(str(find_bridge()), str(path)) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process


@dataclass(frozen=True, kw_only=True)
class RosHost(RosNetwork):
    """The same, and processes of zensim."""

    server: Server
    pool: "subprocess.Popen[str]"


@contextmanager
def ros_host(
    *options: str, agent_options: Sequence[str] = (), is_short: bool = False
) -> Iterator[RosHost]:
    """Run a server with an agent for all robots and a sensor process, without a bridge.

    Raises:
        PeersMissing: rclpy or the bridge cannot be had.
    """
    prepare_ros(is_short=is_short)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        server = stack.enter_context(serving(*BRIDGED, *options))
        pool = stack.enter_context(running_pool(server, *agent_options))
        stack.enter_context(running_sensors(server, "s1", options=BRIDGED))
        yield RosHost(server.endpoint, folder, server=server, pool=pool)


@contextmanager
def running_pool(server: Server, *options: str) -> Iterator["subprocess.Popen[str]"]:
    """Run an agent for all robots."""
    pool = ("agent", "--pool", "0", "--quiet", *BRIDGED, *options)
    with running(*pool, "--connect", server.endpoint) as process:
        yield process


def spawn_lidar_robots(server: Server, count: int) -> list[str]:
    """Spawn robots with lidars in rows; return their names."""
    names = [f"box_bot{number}" for number in range(count)]
    orders = [
        SpawnEntity(
            name=name,
            entity_namespace=name,
            entity_resource=Resource("box_bot_lidar"),
            initial_pose=PoseStamped(pose=Pose(Point(2.0 * (number % 5), 2.0 * (number // 5)))),
        )
        for number, name in enumerate(names)
    ]
    server.client.spawn_all(SpawnEntitiesOrder(tuple(orders)))
    wait_until_driven(server, count)
    return names


def wait_until_driven(server: Server, robots: int) -> None:
    """Wait until agents drive that many robots."""
    eventually(lambda: server.client.info().claimed >= robots, START_S, "claiming")


def read_ready(process: "subprocess.Popen[str]") -> bool:
    """Wait until a script says whether it is ready."""
    return bool(json.loads(read_line(process))["ready"])


def read_line(process: "subprocess.Popen[str]") -> str:
    """Wait for the next line that a script prints."""
    assert process.stdout is not None
    return process.stdout.readline().strip()
