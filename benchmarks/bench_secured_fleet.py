"""Secured fleets

Start: from the exec of `zensim up` with two robots to its line that says that they are ready, in
turn open, secured for the first time (certificates and users are made), and secured again. Then a
hundred robots of pools drive circles, in turn open and secured; one stands, and the time from its
`cmd_vel` to moving odometry is measured. Last, a user of the secured fleet is revoked, which opens
the router again: a session of that user ends, the others are back, and no robot jumps.
"""

import math
import random
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise

from benchmarks.figures import Figure, quantile, table
from benchmarks.motion import SPEED, response_ms, stop
from benchmarks.secured_server import Deployment, deployed, make_up_words, state_folder
from benchmarks.ten_robots import CIRCLE, milliseconds, poll_until
from tests.integration.processes import read_json_line, running
from tests.integration.robots import place, robot, stamp_s
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.endpoints import with_free_port
from zensim.proto.messages.standard_messages import Odometry, Twist, Vector3
from zensim.proto.network_protocols import Sample
from zensim.proto.security.roles import User
from zensim.proto.topic_catalog import CMD_VEL, ODOM

__all__ = ["rows", "table"]

STARTS = 5
STARTED_ROBOTS = 2
ROBOTS, ROBOTS_WHEN_SHORT = 100, 3
TURNS, TURNS_WHEN_SHORT = 2, 1
SAMPLES, SAMPLES_WHEN_SHORT = 60, 2
PACED_S, PACED_WHEN_SHORT_S = 10.0, 1.0
COMMAND_EVERY_S = 0.2
JOINS, JOINS_WHEN_SHORT = 20, 2
REVOCATIONS, REVOCATIONS_WHEN_SHORT = 5, 1
SETTLED_S = 5.0
BACK_S = 30.0
SEED = 17


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure starts, a fleet, and revocation."""
    if not is_short:  # what is compared starts in the same ways
        yield from _start(STARTS)
    yield from _compare(is_short=is_short)


def _start(runs: int) -> Iterator[Figure]:
    took: list[tuple[float, float, float]] = []
    for _ in range(runs):
        with state_folder():
            took.append(
                (_start_s(is_secure=False), _start_s(is_secure=True), _start_s(is_secure=True))
            )
    yield Figure(what="zensim up, open: exec to ready", unit="s", samples=_column(took, 0))
    for number, what in enumerate(("first start", "later start"), 1):
        yield Figure(
            what=f"zensim up --secure, {what}: more than open",
            unit="s",
            samples=tuple(one[number] - one[0] for one in took),
        )


def _column(rows_: list[tuple[float, float, float]], number: int) -> tuple[float, ...]:
    return tuple(row[number] for row in rows_)


def _start_s(*, is_secure: bool) -> float:
    endpoint = with_free_port(f"{'tls' if is_secure else 'tcp'}/127.0.0.1:0")
    began_s = time.perf_counter()
    with running(*make_up_words(STARTED_ROBOTS, endpoint, is_secure=is_secure)) as process:
        read_json_line(process)
        return time.perf_counter() - began_s


def _compare(*, is_short: bool) -> Iterator[Figure]:
    factors: dict[bool, list[float]] = {False: [], True: []}
    response: dict[bool, list[float]] = {False: [], True: []}
    for turn in range(TURNS_WHEN_SHORT if is_short else TURNS):
        for is_secure in (False, True):
            robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
            with (
                state_folder(),
                deployed(robots, is_secure=is_secure) as found,
                _circling(found, robots),
            ):
                factors[is_secure].append(_find_factor(found, is_short=is_short))
                response[is_secure] += _find_response(found, is_short=is_short)
                if is_secure and not turn:
                    yield from _join(found, JOINS_WHEN_SHORT if is_short else JOINS)
                    yield from _revoke(found, robots, is_short=is_short)
    count = f"{ROBOTS_WHEN_SHORT if is_short else ROBOTS} robots"
    for is_secure, word in ((False, "open"), (True, "secured")):
        yield Figure(
            what=f"{count}, {word}: real-time factor", unit="", samples=tuple(factors[is_secure])
        )
        yield Figure(
            what=f"{count}, {word}: cmd_vel to odom that moves",
            unit="ms",
            samples=tuple(response[is_secure]),
        )
    yield Figure(
        what=f"{count}: real-time factor, open - secured",
        unit="",
        samples=tuple(a - b for a, b in zip(factors[False], factors[True], strict=True)),
    )
    p99 = [quantile(sorted(response[is_secure]), 0.99) for is_secure in (False, True)]
    yield Figure(
        what=f"{count}: p99 of cmd_vel to odom, secured / open", unit="", samples=(p99[1] / p99[0],)
    )


@contextmanager
def _circling(found: Deployment, robots: int) -> Iterator[None]:
    """Command all robots but the first to drive circles."""
    linear, angular = CIRCLE
    payload = encode(Twist(Vector3(x=linear), Vector3(z=angular)), Format.CDR)
    is_over = threading.Event()

    def command() -> None:
        with found.bus.open_session() as bus:
            publishers = [
                bus.advertise(CMD_VEL.key(f"box_bot{i}"), CMD_VEL.encoding)
                for i in range(1, robots)
            ]
            while not is_over.wait(COMMAND_EVERY_S):
                for publisher in publishers:
                    publisher.send(payload)

    thread = threading.Thread(target=command)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def _find_factor(found: Deployment, *, is_short: bool) -> float:
    began, began_s = found.client.info(), time.perf_counter()
    time.sleep(PACED_WHEN_SHORT_S if is_short else PACED_S)
    ended, ended_s = found.client.info(), time.perf_counter()
    return (ended.sim_time_s - began.sim_time_s) / (ended_s - began_s)


def _find_response(found: Deployment, *, is_short: bool) -> list[float]:
    phase, first = random.Random(SEED), robot(found.bus, "box_bot0")
    stop(first)
    count = SAMPLES_WHEN_SHORT if is_short else SAMPLES
    took = [response_ms(first, phase, (-1) ** i * SPEED) for i in range(count)]
    first.odom.close()
    first.cmd_vel.close()
    return took


def _join(found: Deployment, count: int) -> Iterator[Figure]:
    token = found.token("observer")
    yield Figure(
        what="join by a token, with both handshakes",
        unit="ms",
        samples=tuple(milliseconds(lambda: _open_and_close(token)) for _ in range(count)),
    )


def _open_and_close(address: str) -> None:
    open_bus(BusConfig(connect=(address,))).close()


@dataclass(frozen=True)
class Revocation:
    """What one revocation did to its user and to the others."""

    ended_s: float
    back_s: float
    gap_s: float
    jump_m: float
    factor: float


def _revoke(found: Deployment, robots: int, *, is_short: bool) -> Iterator[Figure]:
    count = REVOCATIONS_WHEN_SHORT if is_short else REVOCATIONS
    settled_s = 0.0 if is_short else SETTLED_S
    seen = [_revoke_user(found, f"guest{number}", settled_s) for number in range(count)]
    yield Figure(
        what="revoked user: its session has ended",
        unit="s",
        samples=tuple(one.ended_s for one in seen),
    )
    yield Figure(
        what="an operator's call is answered again",
        unit="s",
        samples=tuple(one.back_s for one in seen),
    )
    yield Figure(
        what=f"longest gap in a robot's odometry meanwhile, of {robots}",
        unit="s",
        samples=tuple(one.gap_s for one in seen),
    )
    yield Figure(
        what="longest way of a robot in that gap, more than at its speed",
        unit="m",
        samples=tuple(one.jump_m for one in seen),
    )
    yield Figure(
        what="real-time factor meanwhile", unit="", samples=tuple(one.factor for one in seen)
    )


def _revoke_user(found: Deployment, user: str, settled_s: float) -> Revocation:
    folder = found.folder
    assert folder is not None
    folder.add([User(user, "observer")])
    _wait_for_reply(found.bus)
    time.sleep(settled_s)
    with _open_when_admitted(found.token(user)) as guest:
        poll_until(lambda: _is_answered(guest) or None)
        with closing(found.bus.subscribe(ODOM.key("*"), 100_000)) as odometry:
            began, began_s = found.client.info(), time.perf_counter()
            folder.revoke(user)
            poll_until(lambda: not _is_answered(guest) or None, BACK_S)
            ended_s = time.perf_counter() - began_s
            _wait_for_reply(found.bus)
            back_s = time.perf_counter() - began_s
            time.sleep(settled_s)
            simulated_s = found.client.info().sim_time_s - began.sim_time_s
            lasted_s = time.perf_counter() - began_s
            gap_s, jump_m = _find_gaps(odometry.take())
    return Revocation(ended_s, back_s, gap_s, jump_m, simulated_s / lasted_s)


def _open_when_admitted(address: str) -> Bus:
    """Open a session of a user that is new: the router opens again meanwhile."""

    def attempt() -> Bus | None:
        with suppress(BusError):
            return open_bus(BusConfig(connect=(address,)))
        return None

    return poll_until(attempt, BACK_S)


def _is_answered(bus: Bus) -> bool:
    return bool(bus.get(keys.service("default", "info", bus.user), timeout_s=0.5))


def _wait_for_reply(bus: Bus) -> None:
    def is_answered() -> bool | None:
        with suppress(BusError, TimeoutError):
            return _is_answered(bus) or None
        return None

    poll_until(is_answered, BACK_S)


def _find_gaps(samples: list[Sample]) -> tuple[float, float]:
    """Find the longest gap between stamps of a robot [s], and how far one jumped in a gap [m]."""
    by_robot: dict[str, list[Odometry]] = {}
    for sample in samples:
        odom = decode(Odometry, sample.payload, sample.encoding)
        by_robot.setdefault(sample.key, []).append(odom)
    gaps, jumps = [0.0], [0.0]
    for found in by_robot.values():
        for before, after in pairwise(found):
            gap_s = stamp_s(after) - stamp_s(before)
            gaps.append(gap_s)
            jumps.append(math.dist(place(before), place(after)) - CIRCLE[0] * gap_s)
    return max(gaps), max(jumps)
