"""Robots with lidars, sensor processes, and hashes of what they publish."""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from tests.integration.processes import START_S, Server, eventually, running, serving
from zensim.proto import keys
from zensim.proto.bus.bus_session import BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.spawn_messages import Resource, SpawnEntitiesOrder, SpawnEntity
from zensim.proto.messages.standard_messages import (
    LaserScan,
    Point,
    Pose,
    PoseStamped,
    ns_from_time,
)
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.topic_catalog import SCAN
from zensim.sim_server.description.builtin_models import read_builtin_model

if TYPE_CHECKING:
    import hashlib
    import subprocess

DEPTH = 100_000
LIDAR = """
<gazebo reference="chassis"><sensor name="lidar" type="ray">
  <pose>0.05 0 0 0 0 0</pose><update_rate>10</update_rate>
  <ray>
    <scan><horizontal><samples>360</samples>
      <min_angle>-3.14159</min_angle><max_angle>3.14159</max_angle></horizontal></scan>
    <range><min>0.12</min><max>8</max></range>
    <noise><type>gaussian</type><mean>0</mean><stddev>0.01</stddev></noise>
  </ray>
  <plugin name="lidar" filename="libgazebo_ros_ray_sensor.so">
    <ros><remapping>~/out:=scan</remapping></ros>
    <output_type>sensor_msgs/LaserScan</output_type><frame_name>chassis</frame_name>
  </plugin>
</sensor></gazebo>"""
LOCKSTEP = ("--paused", "--lockstep", "--on-miss", "wait", "--seed", "7", "--world", "warehouse")


def lidar_bot() -> str:
    """Write a box_bot with a noisy lidar of 360 rays at 10 Hz that sees other robots."""
    return re.sub(r"</robot>\s*$", LIDAR + "</robot>", read_builtin_model("box_bot"))


def spawn_lidar_bots(server: Server, count: int) -> list[str]:
    """Spawn robots in a row, and return their names."""
    names = [f"r{number}" for number in range(count)]
    orders = tuple(
        SpawnEntity(
            name=name,
            entity_namespace=name,
            entity_resource=Resource(resource_string=lidar_bot()),
            initial_pose=PoseStamped(pose=Pose(Point(0.7 * (number % 5), 0.7 * (number // 5)))),
        )
        for number, name in enumerate(names)
    )
    server.client.spawn_all(SpawnEntitiesOrder(orders))
    return names


@contextmanager
def running_sensors(
    server: Server, *names: str, options: Sequence[str] = ()
) -> Iterator["list[subprocess.Popen[str]]"]:
    """Run sensor processes, and wait for their tokens."""
    with ExitStack() as stack:
        processes = [
            stack.enter_context(
                running(
                    *("sensors", "run", "--name", name, "--quiet", *options),
                    *("--connect", server.endpoint),
                )
            )
            for name in names
        ]
        pattern = keys.alive_sensors("default", "*")
        eventually(
            lambda: len(server.bus.list_tokens(pattern)) >= len(names), START_S, "sensor processes"
        )
        yield processes


def wait_until_active(server: Server, *names: str) -> None:
    """Wait until exactly these sensor processes are active."""
    wanted = {keys.active_sensors("default", name) for name in names}
    pattern = keys.active_sensors("default", "*")
    eventually(lambda: set(server.bus.list_tokens(pattern)) == wanted, START_S, "active sensors")


def read_stats(server: Server) -> Stats:
    """Get the statistics of a server."""
    (sample,) = server.bus.get("sim/default/stats", START_S)
    return decode(Stats, sample.payload, sample.encoding)


def read_sensor_rows(server: Server) -> list[dict[str, Any]]:
    """Read what `zensim sensors` shows."""
    done = server.zensim("sensors", "list", "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["sensors"]
    assert isinstance(rows, list)
    return rows


class ScanHasher:
    """Hashes scans by robot, and keeps their stamps [ns]."""

    def __init__(self, scans: BusSubscription) -> None:
        self.stamps_ns: dict[str, list[int]] = {}
        self._scans = scans
        self._hashes: dict[str, hashlib._Hash] = {}

    def take(self) -> None:
        for sample in self._scans.take():
            name = sample.key.partition("/")[0]
            scan = decode(LaserScan, sample.payload, sample.encoding)
            self.stamps_ns.setdefault(name, []).append(ns_from_time(scan.header.stamp))
            self._hashes.setdefault(name, sha256()).update(sample.payload)

    @property
    def count(self) -> int:
        return sum(map(len, self.stamps_ns.values()))

    def digests(self) -> dict[str, str]:
        return {name: one.hexdigest() for name, one in sorted(self._hashes.items())}


def record_lockstep_scans(robots: int, steps: int, processes: Sequence[str]) -> ScanHasher:
    """Step robots in lockstep; hash the scans that sensor processes of these names publish."""
    with serving(*LOCKSTEP) as server:
        spawn_lidar_bots(server, robots)
        with running_sensors(server, *processes):
            scans = ScanHasher(server.bus.subscribe(SCAN.key("*"), DEPTH))
            wait_until_active(server, *processes)
            server.client.simulate_steps(steps, on_progress=lambda _: scans.take())
            eventually(lambda: _has_settled(scans, robots, steps), START_S, "the last scans")
    return scans


def _has_settled(scans: ScanHasher, robots: int, steps: int) -> bool:
    scans.take()
    return scans.count >= robots * steps // 24
