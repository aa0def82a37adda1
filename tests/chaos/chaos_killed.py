"""A server that is killed

A server with a journal holds robots; a client spawns and deletes others, five times a second, each
request under its own id until it gets a reply. At random moments the server is killed with SIGKILL
and restarted. Acknowledged changes must be restored; poses and time may be 0.5 s old.
"""

import random
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from benchmarks.figures import Figure, Limit
from tests.chaos.persistence import ANSWER_S, RestartableServer, ask, run_restartable_server
from tests.integration.processes import START_S, eventually, zensim
from zensim.proto import service_catalog
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus, BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.entity_messages import GetEntitiesRequest
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.topic_catalog import CLOCK
from zensim.spawner.client.sim_client import SimClient

ROUNDS, ROUNDS_WHEN_SHORT = 100, 1
ROBOTS, ROBOTS_WHEN_SHORT = 100, 3
EVERY_S = 0.2
LONGEST_LIFE_S = 2.0
SEED = 23
POLL_S = 0.002


@dataclass
class Churn:
    """A client that spawns and deletes, and records the replies."""

    bus: Bus
    standing: set[str] = field(default_factory=set)
    """Acknowledged spawns without a delete request."""
    gone: set[str] = field(default_factory=set)
    """Acknowledged deletes."""
    stop: threading.Event = field(default_factory=threading.Event)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def run(self) -> None:
        """Run until stopped."""
        number = 0
        while not self.stop.wait(EVERY_S):
            number += 1
            self._spawn(f"c{number}", number)
            if number % 2 == 0:
                self._delete(f"c{number}")

    def acknowledged(self) -> tuple[set[str], set[str]]:
        """Get the existing and deleted entities by all replies so far."""
        with self.lock:
            return set(self.standing), set(self.gone)

    def _spawn(self, name: str, number: int) -> None:
        order = SpawnEntityOrder(name=name, entity_resource=Resource(uri="box_bot"))
        ask(self.bus, service_catalog.SPAWN_ENTITY, order, f"spawn{number}")
        with self.lock:
            self.standing.add(name)

    def _delete(self, name: str) -> None:
        with self.lock:
            self.standing.discard(name)
        ask(self.bus, service_catalog.DELETE_ENTITY, DeleteEntityRequest(name), f"delete{name}")
        with self.lock:
            self.gone.add(name)


@dataclass
class KillCosts:
    """Losses and durations of the kills."""

    lost: int = 0
    undone: int = 0
    back_s: list[float] = field(default_factory=list)
    old_s: list[float] = field(default_factory=list)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill the server, start it again, and compare."""
    toll = _measure_kills(
        ROUNDS_WHEN_SHORT if is_short else ROUNDS, ROBOTS_WHEN_SHORT if is_short else ROBOTS
    )
    for what, count in (("spawns lost", toll.lost), ("deletes undone", toll.undone)):
        yield Figure(
            what=f"acknowledged {what}",
            unit="",
            samples=(float(count),),
            limit=Limit("max", "<=", 0.0),
        )
    yield Figure(
        what="simulation time lost with a kill",
        unit="s",
        samples=tuple(toll.old_s),
        limit=Limit("max", "<=", 0.55, is_timed=True),
    )
    yield Figure(
        what="start to the first list answered",
        unit="s",
        samples=tuple(toll.back_s),
        limit=Limit("max", "<=", 3.0, is_timed=True),
    )


def _measure_kills(rounds: int, robots: int) -> KillCosts:
    moment, toll = random.Random(SEED), KillCosts()
    with run_restartable_server() as (server, bus):
        client = SimClient(bus)
        done = zensim(
            *("fleet", "box_bot", "--robots", str(robots), "--layout", "grid"),
            *("--spacing", "2", "--connect", bus.endpoint),
        )
        assert done.returncode == 0, done.stderr
        clock = bus.subscribe(CLOCK.key("default"), 4096)
        churn = Churn(bus, standing=set(client.entities()))
        worker = threading.Thread(target=churn.run)
        worker.start()
        try:
            for _ in range(rounds):
                time.sleep(moment.uniform(0.2, LONGEST_LIFE_S))
                _kill_once(server, bus, clock, churn, toll)
        finally:
            churn.stop.set()
            worker.join()
        _compare(client.entities(), churn.acknowledged(), churn, toll)
    return toll


def _kill_once(
    server: RestartableServer, bus: Bus, clock: BusSubscription, churn: Churn, toll: KillCosts
) -> None:
    received = eventually(lambda: _clocks(clock) or None, START_S, "a clock")
    server.kill()
    last = [*received, *_clocks(clock)][-1]
    begin_s = time.monotonic()
    before = churn.acknowledged()
    server.restart()
    names = _first_list(bus)
    toll.back_s.append(time.monotonic() - begin_s)
    _compare(names, before, churn, toll)
    received = eventually(
        lambda: [one for one in _clocks(clock) if one.epoch > last.epoch] or None,
        START_S,
        "a new epoch",
    )
    toll.old_s.append(max(0.0, _seconds(last) - _seconds(received[0])))


def _first_list(bus: Bus) -> tuple[str, ...]:
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s:
        with suppress(NoServer, TimeoutError):
            return bus.call(
                service_catalog.GET_ENTITIES,
                GetEntitiesRequest(),
                world="default",
                timeout_s=ANSWER_S,
            ).entities
        time.sleep(POLL_S)
    raise TimeoutError("the server did not come back")


def _compare(
    names: tuple[str, ...], before: tuple[set[str], set[str]], churn: Churn, toll: KillCosts
) -> None:
    """Compare a list with what was acknowledged before its request."""
    standing, gone = before
    # Entities with a later delete request may exist or not.
    toll.lost += len((standing & churn.acknowledged()[0]) - set(names))
    toll.undone += len(gone & set(names))


def _clocks(clock: BusSubscription) -> list[WorldClock]:
    return [decode(WorldClock, one.payload, one.encoding) for one in clock.take()]


def _seconds(clock: WorldClock) -> float:
    return clock.clock.sec + clock.clock.nanosec * 1e-9
