"""A server with a fleet driving in circles, played and paused in short turns."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import msgspec
import psutil

from benchmarks.machine import ROOT, used_s
from benchmarks.pybullet_floor import Turn
from benchmarks.ten_robots import spawn
from benchmarks.watched_server import Usage, mark
from tests.integration.processes import connected, end, free_endpoint
from zensim.proto.messages.simulation_messages import State
from zensim.proto.parent_death import PARENT_PID_VARIABLE
from zensim.spawner.client.sim_client import SimClient

PATIENCE_S = 120.0
"""Servers start slowly on a busy machine."""
CALL_TIMEOUT_S = 60.0
"""Calls wait for steps, which are long for large fleets."""


@dataclass(frozen=True)
class Spent(Turn):
    """Resources used by the steps of a turn."""

    process_cpu_s: float
    """Including the router's threads."""
    children_cpu_s: float
    """CPU time of child processes, including cell workers."""


class FleetServer:
    """A server that reports its resource usage."""

    def __init__(self, process: "subprocess.Popen[str]", client: SimClient, endpoint: str) -> None:
        self.process, self.endpoint = process, endpoint
        self.client = client

    def turn(self, seconds: float) -> Spent:
        """Play for some wall time."""
        used_before_s = self._children_used_s()
        before = self._enter(State.PLAYING)
        time.sleep(seconds)
        after = self._enter(State.PAUSED)
        return Spent(
            steps=after.steps - before.steps,
            wall_s=after.wall_s - before.wall_s,
            cpu_s=after.loop_cpu_s - before.loop_cpu_s,
            process_cpu_s=after.process_cpu_s - before.process_cpu_s,
            children_cpu_s=self._children_used_s() - used_before_s,
        )

    def speeds(self) -> list[float]:
        """Get the speed of each robot [m/s]."""
        linear = [state.twist.linear for state in self.client.entity_states().values()]
        return [math.hypot(one.x, one.y) for one in linear]

    def _children_used_s(self) -> float:
        children = psutil.Process(self.process.pid).children(recursive=True)
        return sum(used_s(child.pid) for child in children)

    def _enter(self, state: State) -> Usage:
        self.client.set_simulation_state(state)
        line = line_with(mark(state), self.process)
        return msgspec.json.decode(line.removeprefix(mark(state)), type=Usage)


@contextmanager
def run_fleet_server(count: int, *serve_arguments: str) -> Iterator[FleetServer]:
    """Run a paused server with robots far apart and one process that drives them all."""
    endpoint = free_endpoint()
    arguments = ("--paused", "--rtf", "0", "--listen", endpoint, *serve_arguments)
    with ExitStack() as stack:
        process = stack.enter_context(program("watched_server", *arguments))
        bus = stack.enter_context(connected(endpoint, process))
        found = FleetServer(process, SimClient(bus, timeout_s=CALL_TIMEOUT_S), endpoint)
        found.client.wait_for_server(PATIENCE_S)
        spawn(found.client, count)
        driver = stack.enter_context(program("circling_driver", endpoint, str(count)))
        line_with(f"claimed {count}", driver)
        yield found


@contextmanager
def program(name: str, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a benchmark program until the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", f"benchmarks.{name}", *arguments],
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )
    try:
        yield process
    finally:
        end(process)


def line_with(beginning: str, process: "subprocess.Popen[str]") -> str:
    """Read lines until one has this prefix.

    Raises:
        RuntimeError: The process exited before.
    """
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(beginning):
            return line
    raise RuntimeError(f"no '{beginning}' came from {process.args!r}")
