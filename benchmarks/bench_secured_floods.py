"""Floods by users of a secured server

Ten robots drive circles with an agent and a token each, while one client with the token of a role
loads the server. Everything else is as in the section on noisy neighbours: the clients that measure
have the role `operator`. What the role may not do is dropped by the router, or refused.
"""

from collections.abc import Iterator

from msgspec import structs

from benchmarks.bench_neighbours import UNDISTURBED, find_worst, measure, table
from benchmarks.figures import Figure
from benchmarks.secured_server import secured_fleet
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT
from zensim.proto.security.roles import User

__all__ = ["rows", "table"]

UNREAD = "stopped with 2000 unread get_models"
FLOODS = (
    ("observer", "10,000 get_entities a second, unread"),
    ("observer", "64 get_models in flight"),
    ("observer", "400 requests of 15 MiB at once"),
    ("observer", "request ids of 4 MiB"),
    ("observer", UNREAD),
    ("observer", "2000 sessions"),
    ("observer", "5000 subscriptions, queryables and tokens"),
    ("spawner", "16 dry runs of spawns in flight"),
    ("agent", "commands of 15 MiB"),
    ("agent", "10,000 malformed drive commands a second"),
    ("ros", "5000 subscriptions, queryables and tokens"),
    ("operator", "10,000 twists a second on one robot"),
)
"""Role, and one of `LOADS`."""
FLOODS_WHEN_SHORT = (("observer", "64 get_models in flight"),)
AGENT = User("flooder", "agent", ("flooder",))


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each flood, after an undisturbed time."""
    with secured_fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as (found, folder):
        folder.ensure([AGENT])
        found.server.client.wait_for_server(60.0)
        found.circle()
        yield from measure(found, UNDISTURBED, is_short=is_short)
        disturbed = []
        for role, load in FLOODS_WHEN_SHORT if is_short else FLOODS:
            user = AGENT.name if role == "agent" else role
            address = folder.make_token(folder.accounts()[user]).write()
            disturbed += [
                structs.replace(figure, what=f"{role}, {figure.what}")
                for figure in measure(found, load, is_short=is_short, address=address)
            ]
    yield from disturbed
    yield from find_worst(disturbed)
