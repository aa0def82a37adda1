"""Spawning

Four clients spawn and delete at once, with both versions of simulation_interfaces. Each call has
one reply. An unknown URI and bytes that are no request get a Result, too.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.figures import Figure, Limit
from tests.interop.acceptance import all_of, at_most, naming, none_of
from tests.interop.foreign_peers import HUMBLE, JAZZY, list_routers, stage
from zensim.proto.messages.result_messages import ResultCode

CLIENTS = 4
CALLS, CALLS_WHEN_SHORT = 200, 12
REPLY_MS, BAD_MS = 100.0, 2000.0
VERSIONS = {"2.1": (), "1.x": ("--v1",)}


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Spawn through each router with both versions."""
    for router in list_routers(is_short=is_short):
        yield from measure_spawn(router, JAZZY, VERSIONS, is_short=is_short)


def measure_spawn(
    router: str, distro: str, versions: Mapping[str, Sequence[str]], *, is_short: bool
) -> Iterator[Figure]:
    """Spawn with some versions of the service."""
    calls = CALLS_WHEN_SHORT if is_short else CALLS
    label = router if distro == JAZZY else f"{HUMBLE}, {router}"
    with stage(router, distro=distro) as network:
        for version, options in versions.items():
            count = ("--clients", str(CLIENTS), "--calls", str(calls))
            found = network.run("spawn", *count, *options)
            yield from judge_spawns(f"{label}, {version}", calls, found)


def judge_spawns(label: str, calls: int, found: dict[str, Any]) -> Iterator[Figure]:
    """Compare replies with calls."""
    refused = [*found["refused"], *found["failed"]]
    yield all_of(f"{label}: spawned", len(found["spawned_ms"]), calls)
    yield none_of(naming(f"{label}: refused or failed", refused[:3]), len(refused))
    yield none_of(f"{label}: second replies", found["extra_replies"])
    yield Figure(
        what=f"{label}: call to reply",
        unit="ms",
        samples=tuple(found["spawned_ms"]) or (0.0,),
        limit=Limit("p99", "<=", REPLY_MS, is_timed=True),
    )
    for what, bad in zip(("unknown URI", "malformed bytes"), found["bad"], strict=True):
        yield at_most(f"{label}: replies to {what}", [bad["replies"]], 1, "")
        # 0 is what the peer reports of a reply that it cannot decode.
        is_result = bad["attachment"] and bad["code"] not in {0, ResultCode.OK}
        yield all_of(f"{label}: Result for {what}", int(is_result), 1)
        yield at_most(f"{label}: {what} to reply", [bad["ms"]], BAD_MS, "ms", is_timed=True)
