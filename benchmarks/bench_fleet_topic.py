"""Odometry of a fleet in few messages

`zensim up` with kinematic box_bots, steps and drive states at 20 Hz, two pools, without ROS 2; all
robots drive a circle by one order. One more process reads the odometry of all robots from the
topics of the pools, and copies the rows of all into arrays 50 times a second. Floor: the same fleet
before there is a reader, when nothing is published. CPU is in cores, of all threads of a program; a
sample of a rate is a robot: its rows from one step to another, by simulation time. `commands` are
the drive commands that the server took of those due.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_server import line_with, program
from benchmarks.machine import used_s
from benchmarks.odometry_reader import OdometryTally
from benchmarks.ten_robots import CIRCLE, MILLISECONDS, poll_until
from benchmarks.up_programs import find_programs
from tests.integration.processes import running_up
from zensim.proto.bus import Bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import TwistCommands, split_orders
from zensim.proto.topic_catalog import TWISTS
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

CONTROL_HZ = 20
ROBOTS, ROBOTS_WHEN_SHORT = (1000, 10_000), (20,)
SECONDS, SECONDS_WHEN_SHORT = 30.0, 1.0
SPACING_M = 3.0
MANY = 10_000
RATE = Limit("min", ">=", 19.5, is_timed=True)
CORES = Limit("median", "<=", 1.3, is_timed=True)


@dataclass(frozen=True)
class Spell:
    """A time of a fleet: CPU by program, and commands."""

    cores: dict[str, float]
    taken_share: float
    real_time_factor: float


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure fleets of several sizes."""
    for count in ROBOTS_WHEN_SHORT if is_short else ROBOTS:
        yield from _measure(count, SECONDS_WHEN_SHORT if is_short else SECONDS)


def _measure(count: int, seconds: float) -> Iterator[Figure]:
    arguments = (
        *("--robots", str(count), "--dynamics", "kinematic", "--layout", "grid"),
        *("--spacing", f"{SPACING_M:g}", "--step-hz", str(CONTROL_HZ)),
        *("--control-hz", str(CONTROL_HZ), "--agents", "pooled", "--ros-domain", "off"),
        *("--no-viewer", "--behaviour", "none"),
    )
    with running_up(*arguments) as (up, _, bus):
        client = SimClient(bus)
        programs = find_programs(up)
        _drive(bus, count)
        idle = _spend(client, programs, seconds)
        with program("odometry_reader", bus.endpoint, str(count), f"{seconds:g}") as process:
            line_with("all robots", process)
            read = _spend(client, programs, seconds)
            tally = msgspec.json.decode(line_with("{", process), type=OdometryTally)
    yield from _make_figures(count, idle, read, tally)


def _drive(bus: Bus, count: int) -> None:
    """Order all robots to drive in circles."""
    names = tuple(f"box_bot{number}" for number in range(count))
    publisher = bus.advertise(TWISTS.key("default"), TWISTS.encoding)
    poll_until(lambda: publisher.is_matched or None)
    twists = np.tile([*CIRCLE[:1], 0.0, *CIRCLE[1:]], (count, 1)).astype("<f8").tobytes()
    for part in split_orders(TwistCommands("", names, twists)):
        publisher.send(encode(part, Format.MSGPACK))


def _spend(client: SimClient, pids: dict[str, tuple[int, ...]], seconds: float) -> Spell:
    def read_cpu() -> dict[str, float]:
        return {name: sum(map(used_s, listed)) for name, listed in pids.items() if listed}

    before, began, began_s = read_cpu(), client.stats(), time.monotonic()
    time.sleep(seconds)
    after, ended, spent_s = read_cpu(), client.stats(), time.monotonic() - began_s
    due = sum(one.due for one in ended.agent_commands.values())
    due -= sum(one.due for one in began.agent_commands.values())
    taken = sum(one.taken for one in ended.agent_commands.values())
    taken -= sum(one.taken for one in began.agent_commands.values())
    return Spell(
        {name: (after[name] - before[name]) / spent_s for name in before},
        taken / max(due, 1),
        (ended.sim_time_s - began.sim_time_s) / spent_s,
    )


def _make_figures(count: int, idle: Spell, read: Spell, tally: OdometryTally) -> Iterator[Figure]:
    name, is_many = f"{count} robots", count >= MANY
    for when, spell in (("no reader", idle), ("one reader", read)):
        yield Figure(
            what=f"{name}, {when}: real-time factor", unit="", samples=(spell.real_time_factor,)
        )
        yield Figure(what=f"{name}, {when}: commands", unit="", samples=(spell.taken_share,))
        for program_name, cores in spell.cores.items():
            yield Figure(
                what=f"{name}, {when}: CPU, {program_name}", unit="cores", samples=(cores,)
            )
    yield Figure(what=f"{name}: CPU, the reader", unit="cores", samples=(tally.cpu_cores,))
    yield Figure(
        what=f"{name}: CPU, all with the reader",
        unit="cores",
        samples=(sum(read.cores.values()) + tally.cpu_cores,),
        limit=CORES if is_many else None,
    )
    yield Figure(
        what=f"{name}: odometry of each robot",
        unit="Hz",
        samples=tally.rates_hz,
        limit=RATE if is_many else None,
    )
    yield Figure(
        what=f"{name}: longest gap of each robot",
        unit="ms",
        samples=tuple(gap_s * MILLISECONDS for gap_s in tally.longest_gaps_s),
    )
    yield Figure(what=f"{name}: received", unit="MiB/s", samples=(tally.mib_per_s,))
