"""Runs of ROS nodes in lockstep: robots with lidars, a controller for each, and the state hash."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np

from tests.integration.processes import (
    START_S,
    Server,
    end,
    eventually,
    read_json_line,
    running,
    serving,
)
from tests.integration.repeatable_run import state_hash
from tests.integration.sensor_runs import (
    read_stats,
    running_sensors,
    spawn_lidar_bots,
    wait_until_active,
)
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Snapshot, Stats

WAIT = ("--paused", "--seed", "7", "--world", "warehouse", "--on-miss", "wait")
"""Without `--lockstep`: the nodes ask for it."""


@dataclass(frozen=True)
class NodeRun:
    """Result of a run: hash of the last state, least way of a robot [m], and statistics."""

    state: str
    way_m: float
    stats: Stats


@contextmanager
def running_controllers(
    server: Server, names: Sequence[str], delay_s: float = 0.0
) -> Iterator["subprocess.Popen[str]"]:
    """Run a program with a controller for each robot, until the block ends."""
    module = "tests.integration.ros_controllers"
    command = (sys.executable, "-m", module, server.endpoint, str(delay_s), *names)
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert read_json_line(process)["ready"]
            # A sensor process is active when its scans have a subscriber.
            wait_until_active(server, "s1")
            yield process
        finally:
            end(process)


@contextmanager
def lidar_fleet(robots: int, options: Sequence[str]) -> Iterator[tuple[Server, list[str]]]:
    """Run a paused world with robots that a pool drives, and a sensor process."""
    with ExitStack() as stack:
        server = stack.enter_context(serving(*options))
        names = spawn_lidar_bots(server, robots)
        pool = ("agent", "--pool", "0", "--quiet", "--connect", server.endpoint)
        stack.enter_context(running(*pool))
        stack.enter_context(running_sensors(server, "s1"))
        eventually(lambda: server.client.info().claimed >= robots, START_S, "claims")
        yield server, names


def run_nodes(robots: int, steps: int, delay_s: float = 0.0) -> NodeRun:
    """Let controllers drive for some steps."""
    with lidar_fleet(robots, WAIT) as (server, names), running_controllers(server, names, delay_s):
        before = read_places(server, names)
        server.client.simulate_steps(steps)
        ways_m = np.linalg.norm(read_places(server, names) - before, axis=1)
        return NodeRun(state_hash(server.bus), float(ways_m.min()), read_stats(server))


def read_places(
    server: Server, names: Sequence[str]
) -> "np.ndarray[tuple[int, ...], np.dtype[np.float64]]":
    """Get the places of robots, (n, 2) [m]."""
    (sample,) = server.bus.get("sim/default/snapshot", START_S)
    snapshot = decode(Snapshot, sample.payload, sample.encoding)
    rows = [snapshot.names.index(name) for name in names]
    return np.frombuffer(snapshot.base, dtype="<f8").reshape(-1, 13)[rows, :2]
