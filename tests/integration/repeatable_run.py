"""Repeatable runs in lockstep, and hashes of the published odometry."""

import random
import struct
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING

from tests.integration.processes import (
    START_S,
    Server,
    eventually,
    running,
    serving,
    wait_for_agents,
)
from tests.integration.robots import Robot, robot
from zensim.proto.bus.bus_session import Bus, BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Snapshot
from zensim.proto.topic_catalog import ODOM

if TYPE_CHECKING:
    import hashlib

SEED = 7
CHUNK = 240
"""Steps per set of commands."""
SPACING_M = "0.4"
"""Close enough for collisions: contacts are most sensitive to differences."""
DEPTH = 200_000
LOCKSTEP = ("--paused", "--lockstep", "--on-miss", "wait", "--seed", str(SEED))


@dataclass(frozen=True)
class RunResult:
    """Result of one run.

    Attributes:
        odoms: Odometry messages of each robot.
        digests: Hash of the odometry bytes of each robot, in order of arrival.
        state: Hash of the last snapshot.
    """

    odoms: dict[str, int]
    digests: dict[str, str]
    state: str

    @property
    def hash(self) -> str:
        """Hash of all digests."""
        whole = sha256(self.state.encode())
        for name in sorted(self.digests):
            whole.update(f"{name}={self.digests[name]}".encode())
        return whole.hexdigest()


@contextmanager
def run_lockstep_fleet(
    robots: int,
    *,
    processes: int = 0,
    endpoint: str = "",
    prefix: Sequence[str] = (),
    is_pooled: bool = False,
) -> Iterator[Server]:
    """Run a paused world in lockstep, with robots and their agents.

    Args:
        robots: Number of robots.
        processes: Number of agents; 0 = one per robot.
        endpoint: Endpoint of the server; defaults to loopback.
        prefix: Command prefix of the agents.
        is_pooled: Use one pool for all robots.
    """
    names = [f"box_bot{i}" for i in range(robots)]
    with serving(*LOCKSTEP, endpoint=endpoint) as server, ExitStack() as stack:
        layout = ("--robots", str(robots), "--layout", "grid", "--spacing", SPACING_M)
        done = server.zensim("fleet", "box_bot", *layout)
        assert done.returncode == 0, done.stderr
        joining = ("--connect", server.endpoint, "--quiet", "--cmd-vel-timeout", "0")
        parts = 1 if is_pooled else processes or robots
        for part in range(parts):
            mine = ["--pool", "0"] if is_pooled else names[part::parts]
            stack.enter_context(running("agent", *mine, *joining, prefix=prefix))
        wait_for_agents(server, names)
        yield server


def drive(server: Server, robots: int, steps: int) -> RunResult:
    """Drive all robots with different commands; hash their odometry."""
    odom = server.bus.subscribe(ODOM.key("*"), DEPTH)
    fleet = [robot(server.bus, f"box_bot{i}") for i in range(robots)]
    # An agent that replies has matched the subscriber and published the initial pose.
    eventually(lambda: len(server.bus.get(ODOM.key("*"))) == robots, START_S, "odometry")
    odom.take()
    received = OdometryHasher(odom)
    draws = random.Random(SEED)
    for begin in range(0, steps, CHUNK):
        _command(fleet, draws)
        server.client.simulate_steps(
            min(CHUNK, steps - begin), on_progress=lambda _: received.take()
        )
        received.take()
    return RunResult(dict(received.counts), received.digests(), state_hash(server.bus))


def state_hash(bus: Bus) -> str:
    """Hash epoch, step, time, and the states of all entities and joints."""
    (sample,) = bus.get("sim/default/snapshot", START_S)
    now = decode(Snapshot, sample.payload, sample.encoding)
    whole = struct.pack("<3Q", now.epoch, now.step, now.time_ns) + now.base + now.joint_positions
    return sha256(whole).hexdigest()


def _command(fleet: list[Robot], draws: random.Random) -> None:
    for found in fleet:
        found.command(draws.uniform(-0.3, 0.6), draws.uniform(-1.0, 1.0))


class OdometryHasher:
    """Hashes messages on arrival."""

    def __init__(self, odom: BusSubscription) -> None:
        self.counts: dict[str, int] = {}
        self._odom = odom
        self._hashes: dict[str, hashlib._Hash] = {}

    def take(self) -> None:
        for sample in self._odom.take():
            name = sample.key.partition("/")[0]
            self.counts[name] = self.counts.get(name, 0) + 1
            self._hashes.setdefault(name, sha256()).update(sample.payload)

    def digests(self) -> dict[str, str]:
        return {name: one.hexdigest() for name, one in self._hashes.items()}
