"""Many clients under faults

Ten clients spawn, delete and look up the same few names at random, each request under its own id
until it gets a reply, while the server is killed and restarted. The history of each name must be
linearizable.
"""

import random
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from benchmarks.figures import Figure, Limit
from tests.chaos.history import Answer, Kind, Operation, first_fault
from tests.chaos.persistence import POLL_S, RestartableServer, ask, run_restartable_server
from tests.integration.processes import START_S
from zensim.proto import service_catalog
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.messages.entity_messages import GetEntityStateOrder
from zensim.proto.messages.result_messages import ResultCode, ServiceError, SpawnCode
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.spawner.client.sim_client import SimClient

CLIENTS, CLIENTS_WHEN_SHORT = 10, 4
OPERATIONS, OPERATIONS_WHEN_SHORT = 1000, 150
NAMES = tuple(f"n{i}" for i in range(8))
KINDS: tuple[Kind, ...] = ("spawn", "delete", "look")
LIFE_S, LIFE_WHEN_SHORT_S = (1.0, 5.0), (0.2, 0.4)
"""Time from the first reply to the kill."""
KILLS, KILLS_WHEN_SHORT = sys.maxsize, 1
SEED = 31


class KillSchedule(NamedTuple):
    """Range of a server's lifetime, and maximum number of kills."""

    life_s: tuple[float, float]
    kills: int


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Run clients and faults, then check that the histories are linearizable."""
    clients = CLIENTS_WHEN_SHORT if is_short else CLIENTS
    operations = OPERATIONS_WHEN_SHORT if is_short else OPERATIONS
    life_s = LIFE_WHEN_SHORT_S if is_short else LIFE_S
    most = KILLS_WHEN_SHORT if is_short else KILLS
    histories, kills = _run_clients(clients, operations, KillSchedule(life_s, most))
    faults = [name for name, history in histories.items() if first_fault(history) is not None]
    yield Figure(
        what="names whose history nothing explains",
        unit="",
        samples=(float(len(faults)),),
        limit=Limit("max", "<=", 0.0),
    )
    count = sum(map(len, histories.values()))
    yield Figure(
        what="operations answered",
        unit="",
        samples=(float(count),),
        limit=Limit("min", ">=", clients * operations),
    )
    yield Figure(
        what="times that the server was killed meanwhile",
        unit="",
        samples=(float(kills),),
        limit=Limit("min", ">=", 1.0),
    )


def _run_clients(
    clients: int, operations: int, schedule: KillSchedule
) -> tuple[dict[str, list[Operation]], int]:
    histories: dict[str, list[Operation]] = {name: [] for name in NAMES}
    with run_restartable_server() as (server, bus), ThreadPoolExecutor(clients) as pool:
        work = [pool.submit(_client, bus.endpoint, i, operations) for i in range(clients)]
        kills = _kill_until(server, bus, schedule, lambda: all(one.done() for one in work))
        for one in work:
            for name, operation in one.result():
                histories[name].append(operation)
    return histories, kills


def _kill_until(
    server: RestartableServer, bus: Bus, schedule: KillSchedule, is_over: Callable[[], bool]
) -> int:
    """Kill the server repeatedly, each time some time after its first reply."""
    moment, kills = random.Random(SEED), 0
    while kills < schedule.kills and not is_over():
        _wait(moment.uniform(*schedule.life_s), is_over)
        if is_over():
            break
        server.kill()
        kills += 1
        server.restart()
        SimClient(bus).wait_for_server(START_S)
    return kills


def _wait(seconds: float, is_over: Callable[[], bool]) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s and not is_over():
        time.sleep(POLL_S)


def _client(endpoint: str, number: int, operations: int) -> list[tuple[str, Operation]]:
    draw, received = random.Random(SEED + number), []
    with open_bus(BusConfig(connect=(endpoint,))) as bus:
        for i in range(operations):
            name, kind = draw.choice(NAMES), draw.choice(KINDS)
            asked_s = time.monotonic()
            answer = _call(bus, kind, name, f"{number}.{i}")
            received.append((name, Operation(kind, asked_s, time.monotonic(), answer)))
    return received


def _call(bus: Bus, kind: Kind, name: str, request_id: str) -> Answer:
    try:
        if kind == "spawn":
            order = SpawnEntityOrder(name=name, entity_resource=Resource(uri="box_bot"))
            ask(bus, service_catalog.SPAWN_ENTITY, order, request_id)
            return "done"
        if kind == "delete":
            ask(bus, service_catalog.DELETE_ENTITY, DeleteEntityRequest(name), request_id)
            return "done"
        ask(bus, service_catalog.GET_ENTITY_STATE, GetEntityStateOrder(name), request_id)
    except ServiceError as error:
        if error.code == SpawnCode.NAME_NOT_UNIQUE:
            return "taken"
        if error.code == ResultCode.NOT_FOUND:
            return "missing"
        raise
    return "there"
