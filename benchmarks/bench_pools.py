"""Pools

CPU time of the thread that drives N box_bots for one drive state: replying with targets, and
publishing odometry and tf of every robot. A separate router forwards everything to a subscriber in
this process that discards it. Floor: as many prepared payloads on publishers; and agents of single
robots in one process.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from benchmarks.drive_states import make_claims, make_drive_states
from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import MILLISECONDS
from tests.integration.processes import connected, free_endpoint, running
from zensim.proto.bus import Bus
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.standard_messages import Odometry, Twist, Vector3
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robots import IndividualRobots

__all__ = ["rows", "table"]

SIZES = (100, 1000)
ROUNDS, ROUNDS_WHEN_SHORT = 60, 2
SINGLE = 100
"""Robots with single agents."""
TOPICS = ("odom", "tf")
DECLARED_IN = 400
"""Rounds until all publishers are declared."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure pools of several sizes, and single agents."""
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    for robots in (10,) if is_short else SIZES:
        with make_buses() as (bus, listener):
            yield from _pool_figures(bus, listener, robots, rounds)
    with make_buses() as (bus, _):
        fleet = IndividualRobots(bus, 0)
        fleet.add_claims(make_claims(5 if is_short else SINGLE))
        states = make_drive_states(5 if is_short else SINGLE)
        took = measure_cpu_ms(rounds, lambda: fleet.advance(next(states)))
        yield _figure(f"{SINGLE} robots one by one: a state answered", took)


def _pool_figures(bus: Bus, listener: Bus, robots: int, rounds: int) -> Iterator[Figure]:
    pool, states = PooledRobots(bus, 0), make_drive_states(robots)
    pool.add_claims(make_claims(robots))
    commands = [
        bus.advertise(f"r{number}/cmd_vel", make_encoding(Twist, Format.CDR))
        for number in range(robots)
    ]
    twist = encode(Twist(Vector3(0.2), Vector3(z=0.5)), Format.CDR)

    def command_all() -> None:
        for one in commands:
            one.send(twist)

    pool.advance(next(states))
    name = f"{robots} robots: "
    answered = measure_cpu_ms(rounds, lambda: pool.advance(next(states)))
    yield _figure(f"{name}a state answered", answered)
    received = measure_cpu_ms(rounds, lambda: pool.advance(next(states)), before=command_all)
    yield _figure(f"{name}a state answered, each robot has a new command", received)
    without_subscribers = measure_cpu_ms(
        rounds, pool.publish, before=lambda: pool.advance(next(states))
    )
    yield _figure(f"{name}odometry and tf, no subscriber", without_subscribers)
    heard_by = [listener.subscribe(f"*/{topic}", 8) for topic in TOPICS]
    for _ in range(DECLARED_IN):
        pool.reply_to_queries()
        time.sleep(0.001)
    received, floor = _interleaved(bus, robots, rounds, pool, states)
    limit = Limit("median", "<=", 5.0) if robots == max(SIZES) else None
    yield _figure(f"{name}odometry and tf, one subscriber", received)
    yield _figure(f"{name}floor, as many ready payloads put", floor)
    extra = tuple(one - other for one, other in zip(received, floor, strict=True))
    yield _figure(f"{name}publishing, beyond its floor", extra, limit)
    for one in heard_by:
        one.close()


def _interleaved(
    bus: Bus, robots: int, rounds: int, pool: PooledRobots, states: Iterator[DriveState]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Publish telemetry and prepared payloads in turns."""
    payload = encode(Odometry(), Format.CDR)
    encoding = make_encoding(Odometry, Format.CDR)
    puts = [bus.advertise(f"f{number}/odom", encoding) for number in range(robots)]

    def put_all() -> None:
        for _ in TOPICS:
            for one in puts:
                one.send(payload)

    received: list[float] = []
    floor: list[float] = []
    for _ in range(rounds):
        received += measure_cpu_ms(1, pool.publish, before=lambda: pool.advance(next(states)))
        floor += measure_cpu_ms(1, put_all)
        # So that messages of one do not delay the other.
        time.sleep(0.02)
    return tuple(received), tuple(floor)


@contextmanager
def make_buses() -> Iterator[tuple[Bus, Bus]]:
    """Run a router; open a session that publishes, and one that subscribes."""
    endpoint = free_endpoint()
    with (
        running("router", "--listen", endpoint) as process,
        connected(endpoint, process) as bus,
        connected(endpoint) as listener,
    ):
        yield bus, listener


def measure_cpu_ms(
    rounds: int, act: Callable[[], object], before: Callable[[], object] | None = None
) -> tuple[float, ...]:
    """Call repeatedly; return the CPU time [ms] of this thread per call."""
    took = []
    for _ in range(rounds):
        if before is not None:
            before()
        began_s = time.thread_time()
        act()
        took.append((time.thread_time() - began_s) * MILLISECONDS)
    return tuple(took)


def _figure(what: str, samples: tuple[float, ...], limit: Limit | None = None) -> Figure:
    return Figure(what=what, unit="CPU ms", samples=samples, limit=limit)
