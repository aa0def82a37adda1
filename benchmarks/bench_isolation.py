"""Physics while large and bad files arrive

Ten robots drive circles. A robot of 100 links and 20 meshes of 20,160 triangles each (STL, OBJ, DAE
and GLB) is uploaded, parsed and spawned, in runs that share no file; then a static one, whose
triangles themselves collide; then descriptions and meshes that are refused. A sample is a second of
the server: how late its latest step began, and for how long the loop's own work delayed a step. The
first is also late when other programs have the cores, as "nothing else" shows; the second is CPU
time of the loop thread: the delay on a core of its own.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from typing import TYPE_CHECKING

import msgspec

from benchmarks import large_robot
from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import (
    ROBOTS,
    ROBOTS_WHEN_SHORT,
    Fleet,
    fleet,
    latest_steps,
    longest_work,
    milliseconds,
    observe_in_turns,
    stats_of,
)
from tests.hostile.case import Case, alone, solid
from tests.hostile.corpus import corpus
from tests.hostile.meshes import BadMesh, bad_meshes
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.description_sources import read_model_argument
from zensim.spawner.spawn.search_paths import SearchPaths
from zensim.spawner.spawn.spawn_client import SpawnPayload, add_payload, make_payload, send_files

if TYPE_CHECKING:
    from zensim.proto.messages.telemetry_messages import Stats

__all__ = ["rows", "table"]

RUNS, SHARES_WHEN_SHORT = 5, 16
MESHES_WHEN_SHORT = len(large_robot.ENDINGS)
FAR_M = 500.0
QUIET_S = 4.5
NO_NAME = "no-name"
"""Refused for its name, after the description was parsed."""
LATE = Limit("max", "<=", 20.0)
LARGEST = 16
"""The longest hostile descriptions: 40 kB to 9 MB."""


Act = Callable[[], object]


class ObservedFleet:
    """A fleet, and the delays of its steps during actions."""

    def __init__(self, found: Fleet) -> None:
        self.client = SimClient(found.server.bus, timeout_s=60.0)
        self.took_ms: dict[str, list[float]] = {}
        self.seconds: dict[str, list[Stats]] = {}
        self._stats = stats_of(found)

    def during(self, acts: dict[str, Act]) -> None:
        """Run actions in turns, and record the steps meanwhile."""
        timed = (partial(self._timed, what, act) for what, act in acts.items())
        for what, seen in zip(acts, observe_in_turns(self._stats, timed), strict=True):
            self.seconds.setdefault(what, []).extend(seen)

    def _timed(self, what: str, act: Act) -> None:
        self.took_ms.setdefault(what, []).append(milliseconds(act))


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure robots, scenes, and refusals."""
    size = {"links": 4, "count": MESHES_WHEN_SHORT} if is_short else {}
    with (
        TemporaryDirectory() as folder,
        fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found,
    ):
        found.circle()
        record_lateness, path = ObservedFleet(found), Path(folder)
        record_lateness.during({"nothing else": partial(sleep, 0.5 if is_short else QUIET_S)})
        for run in range(1 if is_short else RUNS):
            for what, is_held in (("robot", False), ("scene", True)):
                cargo = a_cargo(path, 2 * run + is_held, is_held=is_held, **size)
                record_lateness.during(_acts(record_lateness.client, cargo, what))
            every = SHARES_WHEN_SHORT if is_short else RUNS
            record_lateness.during(_refusals(record_lateness.client, path, run, every))
    yield from _figures(record_lateness)


def a_cargo(
    folder: Path,
    seed: int,
    *,
    is_held: bool,
    links: int = large_robot.LINKS,
    count: int = large_robot.MESHES,
) -> SpawnPayload:
    """Write a robot and its meshes, and collect them like `zensim spawn`."""
    for name, data in large_robot.meshes(seed, count).items():
        folder.joinpath(name).write_bytes(data)
    return _cargo(folder, large_robot.text(links, count, is_held=is_held))


def _cargo(folder: Path, text: str) -> SpawnPayload:
    file = folder / "robot.urdf"
    file.write_text(text, encoding="utf-8")
    return make_payload(
        read_model_argument(str(file), {}, SearchPaths()), SearchPaths(), allow_missing=False
    )


def _acts(client: SimClient, cargo: SpawnPayload, what: str) -> dict[str, Act]:
    order = SpawnEntityOrder(initial_pose=PoseStamped(pose=Pose(Point(FAR_M, FAR_M, 1.0))))
    named, unnamed = (
        add_payload(cargo, msgspec.structs.replace(order, name=name), "")
        for name in (what, NO_NAME)
    )
    return {
        f"{what}: uploaded": lambda: send_files(client, cargo.bundle),
        f"{what}: read": partial(_refused, client, unnamed),
        f"{what}: spawned, stands there": lambda: client.spawn(named),
        f"{what}: deleted": lambda: client.delete(what),
    }


def _refusals(client: SimClient, folder: Path, run: int, every: int) -> dict[str, Act]:
    """Take one of so many refused inputs, others in each run."""
    texts = sorted(corpus(), key=lambda case: len(case.text))[-LARGEST:]
    meshes = list(bad_meshes())
    return {
        "refused descriptions": partial(_refuse_texts, client, texts[run::every]),
        "refused meshes": partial(_refuse_meshes, client, folder, meshes[run::every]),
    }


def _refuse_texts(client: SimClient, cases: list[Case]) -> None:
    for case in cases:
        _refused(client, SpawnEntityOrder(NO_NAME, entity_resource=Resource("", case.text)))


def _refuse_meshes(client: SimClient, folder: Path, meshes: list[BadMesh]) -> None:
    for mesh in meshes:
        folder.joinpath(mesh.name).write_bytes(mesh.data)
        cargo = _cargo(folder, alone(solid(f'<mesh filename="{mesh.name}"/>')))
        send_files(client, cargo.bundle)
        _refused(client, add_payload(cargo, SpawnEntityOrder(NO_NAME), ""))


def _refused(client: SimClient, order: SpawnEntityOrder) -> None:
    with suppress(ServiceError):
        client.spawn(order)
        raise RuntimeError(f"'{order.name}' was spawned")


def _figures(record_lateness: ObservedFleet) -> Iterator[Figure]:
    for what, seconds in record_lateness.seconds.items():
        yield longest_work(what, seconds, LATE)
    for what, seconds in record_lateness.seconds.items():
        yield latest_steps(what, seconds, LATE)
    for what, took_ms in record_lateness.took_ms.items():
        if not what.endswith("else"):
            yield Figure(what=f"{what}: request to reply", unit="ms", samples=tuple(took_ms))
