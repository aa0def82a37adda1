"""One name for many

A hundred clients spawn an entity of the same name simultaneously: one succeeds, the others get
NAME_NOT_UNIQUE.
"""

import threading
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from benchmarks.figures import Figure, Limit
from tests.integration.processes import serving
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.spawner.client.sim_client import SimClient

CLIENTS, CLIENTS_WHEN_SHORT = 100, 8
ROUNDS, ROUNDS_WHEN_SHORT = 10, 1


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Spawn one name many times simultaneously."""
    clients = CLIENTS_WHEN_SHORT if is_short else CLIENTS
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    with serving() as server:
        counts = [_race(server.endpoint, f"r{number}", clients) for number in range(rounds)]
        entities = len(server.client.entities())
    for what, expected in (("OK", 1), ("NAME_NOT_UNIQUE", clients - 1)):
        samples = tuple(float(count[what]) for count in counts)
        for statistic, relation in (("min", ">="), ("max", "<=")):
            yield Figure(
                what=f"answers {what} of {clients}, {statistic}",
                unit="",
                samples=samples,
                limit=Limit(statistic, relation, expected),  # type: ignore[arg-type]
            )
    yield Figure(
        what="entities for each name",
        unit="",
        samples=(entities / len(counts),),
        limit=Limit("max", "<=", 1.0),
    )


def _race(endpoint: str, name: str, clients: int) -> Counter[str]:
    start = threading.Barrier(clients)
    order = SpawnEntityOrder(name=name, entity_resource=Resource(uri="box_bot"))

    def ask() -> str:
        with open_bus(BusConfig(connect=(endpoint,), open_timeout_s=20.0)) as bus:
            start.wait(60.0)
            try:
                SimClient(bus, timeout_s=30.0).spawn(order)
            except ServiceError as error:
                return error.code_name
            return "OK"

    with ThreadPoolExecutor(clients) as pool:
        return Counter(one.result() for one in [pool.submit(ask) for _ in range(clients)])
