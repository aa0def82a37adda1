"""Robots that are spawned and deleted

One client spawns and deletes a box_bot, repeatedly. The server's memory is read before, after a
tenth that fills its caches, and at the end.
"""

from collections.abc import Iterator

import psutil

from benchmarks.figures import Figure, Limit
from tests.integration.processes import Server, serving
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder

ROUNDS, ROUNDS_WHEN_SHORT = 10_000, 100
MEGABYTE = 1e6


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Spawn and delete, and measure the memory of the server."""
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    with serving() as server:
        _churn(server, 1)
        begin = _rss_mb(server)
        _churn(server, rounds // 10)
        filled = _rss_mb(server)
        _churn(server, rounds - rounds // 10)
        end = _rss_mb(server)
        left = len(server.client.entities())
    yield Figure(
        what=f"growth of the server's memory over {rounds} rounds",
        unit="MB",
        samples=(end - begin,),
        limit=Limit("max", "<=", 10.0),
    )
    yield Figure(what="of it in the first tenth", unit="MB", samples=(filled - begin,))
    yield Figure(
        what="entities left", unit="", samples=(float(left),), limit=Limit("max", "<=", 0.0)
    )


def _churn(server: Server, rounds: int) -> None:
    order = SpawnEntityOrder(name="r1", entity_resource=Resource(uri="box_bot"))
    for _ in range(rounds):
        server.client.spawn(order)
        server.client.delete("r1")


def _rss_mb(server: Server) -> float:
    return float(psutil.Process(server.process.pid).memory_info().rss / MEGABYTE)
