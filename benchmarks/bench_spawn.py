"""Spawning while others drive

A box_bot is spawned far away and deleted again, at random moments, while ten robots drive circles.
The server reports each second how late its latest step began, how long its longest engine step
took, and for how long the loop's own work delayed a step (CPU time: the rest is due to other
programs): first without spawns, then with them. Floor: the same description parsed and added to
PyBullet in this process, among as many bodies. Last: 2000 `spawn_entity` calls, each with a text of
its own, 16 outstanding, while one process drives a hundred robots at real-time factor 1 and 240 Hz;
the same floor as a rate, what PyBullet alone takes of a core to step, command and read the hundred,
and of CPU time to make another world, as a spawn needs when a cell is full.
"""

import random
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import msgspec

from benchmarks.bodies import Bodies, standing_at
from benchmarks.figures import Figure, table
from benchmarks.fleet_server import run_fleet_server
from benchmarks.ten_robots import (
    MILLISECONDS,
    ROBOTS,
    ROBOTS_WHEN_SHORT,
    fleet,
    latest_steps,
    longest_work,
    milliseconds,
    observe,
    poll_until,
    stats_of,
)
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.topic_catalog import STATS
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_client import make_resource, read_payload

__all__ = ["rows", "table"]

SPAWNS = 200
SPAWNS_WHEN_SHORT = 3
LONGEST_PAUSE_S = 0.1
"""Pause before a spawn and before a delete: a pair every 0.1 s."""
FAR_M = 1000.0
SEED = 5
DRIVEN, DRIVEN_WHEN_SHORT = 100, 2
MANY, MANY_WHEN_SHORT = 2000, 10
OUTSTANDING = 16
COLUMNS, APART_M = 50, 3.0
WARM_S = 1.0


class Spawner:
    """Spawns and deletes at random moments, and records the durations."""

    def __init__(self, client: SimClient) -> None:
        self.spawn_ms: list[float] = []
        self.delete_ms: list[float] = []
        self._client = client
        self._phase = random.Random(SEED)

    def work(self, count: int) -> None:
        """Spawn and delete alternately."""
        for number in range(count):
            order = an_order(number)
            self._pause()
            self.spawn_ms.append(milliseconds(partial(self._client.spawn, order)))
            self._pause()
            self.delete_ms.append(milliseconds(partial(self._client.delete, order.name)))

    def _pause(self) -> None:
        time.sleep(self._phase.uniform(0.0, LONGEST_PAUSE_S))


def an_order(number: int) -> SpawnEntityOrder:
    """Make the request of `zensim spawn`."""
    name = f"far{number}"
    return SpawnEntityOrder(
        name,
        entity_resource=make_resource("box_bot", read_payload("box_bot").text, name),
        entity_namespace=name,
        initial_pose=PoseStamped(pose=Pose(Point(FAR_M + number, FAR_M, 0.0))),
        snap_to_ground=True,
    )


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure spawns, deletes, and the resulting delays of steps."""
    count = SPAWNS_WHEN_SHORT if is_short else SPAWNS
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    with fleet(robots) as found:
        found.circle()
        spawner = Spawner(found.server.client)
        stats = stats_of(found)
        quiet = observe(stats, lambda: time.sleep(count * LONGEST_PAUSE_S))
        busy = observe(stats, lambda: spawner.work(count))
    yield Figure(what="spawn request to reply", unit="ms", samples=tuple(spawner.spawn_ms))
    yield _floor(robots, count)
    yield Figure(what="delete request to reply", unit="ms", samples=tuple(spawner.delete_ms))
    yield from _steps("without spawns", quiet)
    yield from _steps("with spawns", busy)
    yield from _rates(is_short=is_short)


@dataclass(frozen=True)
class SpawnRun:
    """Many spawns in a row: their rate, and what the world and the loop did meanwhile."""

    rate_hz: float
    factor: float
    stats: list[Stats]


def _rates(*, is_short: bool) -> Iterator[Figure]:
    count = MANY_WHEN_SHORT if is_short else MANY
    driven = DRIVEN_WHEN_SHORT if is_short else DRIVEN
    for dynamics in ("auto", "full")[: 1 if is_short else 2]:
        run = _spawn_many_singly(driven, count, dynamics)
        label = f"{count} single spawns beside {driven} driven robots, {dynamics}"
        yield Figure(what=label, unit="1/s", samples=(run.rate_hz,))
        what = f"{label}: real-time factor"
        yield Figure(what=what, unit="", samples=(run.factor,))
        yield longest_work(label, run.stats)
    floor = _floor(driven, count)
    rate_hz = 1e3 * len(floor.samples) / sum(floor.samples)
    yield Figure(what="floor: read, and put into PyBullet, rate", unit="1/s", samples=(rate_hz,))


def _spawn_many_singly(driven: int, count: int, dynamics: str) -> SpawnRun:
    orders = [_place(an_order(number), number) for number in range(count)]
    with run_fleet_server(driven, "--rtf", "1", "--dynamics", dynamics) as server:
        client = server.client
        stats = client.bus.subscribe(STATS.key("default"), 4096)
        client.set_simulation_state(State.PLAYING)
        time.sleep(WARM_S)
        stats.take()
        before, start_s = client.info(), time.monotonic()
        with ThreadPoolExecutor(OUTSTANDING) as threads:
            for report in threads.map(client.spawn, orders):
                assert report.entity_name
        took_s = time.monotonic() - start_s
        after, wall_s = client.info(), time.monotonic() - start_s
        # Statistics come once a second: the last ones are about the last spawns.
        seen = stats.take()
        seen += poll_until(lambda: stats.take() or None)
    found = [decode(Stats, one.payload, one.encoding) for one in seen]
    factor = (after.sim_time_s - before.sim_time_s) / wall_s
    return SpawnRun(count / took_s, factor, found)


def _place(order: SpawnEntityOrder, number: int) -> SpawnEntityOrder:
    """Place a robot of many on a grid."""
    row, column = divmod(number, COLUMNS)
    point = Point(FAR_M + column * APART_M, FAR_M + row * APART_M, 0.0)
    return msgspec.structs.replace(order, initial_pose=PoseStamped(pose=Pose(point)))


def _steps(when: str, seen: list[Stats]) -> Iterator[Figure]:
    yield longest_work(when, seen)
    yield latest_steps(when, seen)
    yield Figure(
        what=f"longest step of each second, {when}",
        unit="ms",
        samples=tuple(stats.step_time_max_s * MILLISECONDS for stats in seen),
    )


def _floor(robots: int, count: int) -> Figure:
    bodies = Bodies(robots)
    texts = [an_order(i).entity_resource.resource_string for i in range(count)]
    samples = tuple(_add_ms(bodies.engine, text) for text in texts)
    bodies.engine.close()
    return Figure(what="floor: read, and put into PyBullet", unit="ms", samples=samples)


def _add_ms(engine: PyBulletEngine, text: str) -> float:
    start_s = time.perf_counter()
    body = engine.add(read_urdf(text), standing_at(FAR_M))
    took_s = time.perf_counter() - start_s
    engine.remove(body)
    return took_s * MILLISECONDS
