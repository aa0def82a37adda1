"""Physics while large and bad files come

Ten robots drive circles. A robot of 100 links with 20 meshes of 20,160 triangles each (STL, OBJ,
DAE and GLB, in turn) is uploaded, read and put into the world, in runs that share no file; then one
of which nothing moves, so that its triangles themselves are what others collide with; then
descriptions and meshes are sent that are refused. A sample is a second of the server: how late its
latest step began.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from typing import TYPE_CHECKING

import msgspec

from proto.geometry import Point, Pose, PoseStamped
from proto.result import ServiceError
from proto.services import Resource, SpawnEntityOrder
from spawner.client import SimClient
from spawner.descriptions import from_word
from spawner.launch import Cargo, cargo_of, order_for, send_files
from spawner.search_paths import SearchPaths
from tests.benchmark import huge
from tests.benchmark.figures import Asked, Figure, table
from tests.benchmark.fleet import (
    ROBOTS,
    ROBOTS_WHEN_SHORT,
    Fleet,
    fleet,
    latest_steps,
    milliseconds,
    observed,
    stats_of,
)
from tests.hostile.corpus import corpus

if TYPE_CHECKING:
    from proto.telemetry import Stats

__all__ = ["rows", "table"]

RUNS = 5
FAR_M = 500.0
QUIET_S = 5.0
AFTER_S = 1.0
"""Physics with the new robot in it."""
NO_NAME = "no-name"
"""Refused for its name, once the description has been read."""
LATE = Asked("max", "<=", 20.0)
LARGEST = 40
"""Hostile descriptions, the longest of them."""


class Watched:
    """A fleet, and what its steps suffered while something was done."""

    def __init__(self, found: Fleet) -> None:
        self.client = SimClient(found.server.bus, timeout_s=60.0)
        self.took_ms: dict[str, list[float]] = {}
        self.seconds: dict[str, list[Stats]] = {}
        self._stats = stats_of(found)

    def during(self, what: str, act: Callable[[], object]) -> None:
        """Act, and watch the steps meanwhile."""
        took_ms = self.took_ms.setdefault(what, [])
        seen = observed(self._stats, lambda: took_ms.append(milliseconds(act)))
        self.seconds.setdefault(what, []).extend(seen)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure robots, scenes, and what is refused."""
    size = {"links": 4, "count": len(huge.ENDINGS)} if is_short else {}
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        found.circle()
        watched = Watched(found)
        watched.during("nothing else", partial(sleep, 1.0 if is_short else QUIET_S))
        for run in range(1 if is_short else RUNS):
            for what, is_held in (("robot", False), ("scene", True)):
                with TemporaryDirectory() as folder:
                    cargo = a_cargo(Path(folder), 2 * run + is_held, is_held=is_held, **size)
                    _put(watched, cargo, what)
            watched.during("refused descriptions", partial(_refused_texts, watched.client))
    yield from _figures(watched)


def a_cargo(folder: Path, seed: int, *, is_held: bool, **size: int) -> Cargo:
    """Write a robot and its meshes, and gather them as `zensim spawn` does."""
    for name, data in huge.meshes(seed, size.get("count", huge.MESHES)).items():
        folder.joinpath(name).write_bytes(data)
    file = folder / "huge.urdf"
    file.write_text(huge.text(**size, is_held=is_held), encoding="utf-8")
    return cargo_of(from_word(str(file), {}, SearchPaths()), SearchPaths(), allow_missing=False)


def _put(watched: Watched, cargo: Cargo, what: str) -> None:
    client = watched.client
    order = SpawnEntityOrder(initial_pose=PoseStamped(pose=Pose(Point(FAR_M, FAR_M, 1.0))))
    named, unnamed = (
        order_for(cargo, msgspec.structs.replace(order, name=name), "") for name in (what, NO_NAME)
    )
    watched.during(f"{what}: uploaded", lambda: send_files(client, cargo.bundle))
    watched.during(f"{what}: read", partial(_refused, client, unnamed))
    watched.during(f"{what}: spawned", lambda: client.spawn(named))
    watched.during(f"{what}: stands there", partial(sleep, AFTER_S))
    watched.during(f"{what}: deleted", lambda: client.delete(what))


def _refused_texts(client: SimClient) -> None:
    for case in sorted(corpus(), key=lambda case: len(case.text))[-LARGEST:]:
        _refused(client, SpawnEntityOrder(NO_NAME, entity_resource=Resource("", case.text)))


def _refused(client: SimClient, order: SpawnEntityOrder) -> None:
    with suppress(ServiceError):
        client.spawn(order)
        raise RuntimeError(f"'{order.name}' was spawned")


def _figures(watched: Watched) -> Iterator[Figure]:
    for what, seconds in watched.seconds.items():
        yield latest_steps(what, seconds, LATE)
    for what, took_ms in watched.took_ms.items():
        if not what.endswith(("else", "there")):
            yield Figure(what=f"{what}: request to reply", unit="ms", samples=tuple(took_ms))
