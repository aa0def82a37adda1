"""Parsing and building robots

CPU time to parse a URDF of 4, 100 and 500 links as the server does; to parse `box_bot_legacy`,
which has the most to report, with and without a report, in turns; to parse a robot of 100 links
with twenty meshes of 20,160 triangles; to convert meshes of 500 to 50,000 corners, all of them
corners of the hull, into hulls, against reading and writing the same files; and to add a box_bot
to PyBullet as the first and as the thousandth of a world.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING
from unittest.mock import patch

import numpy as np

from benchmarks import large_robot
from benchmarks.figures import Figure, table
from zensim.proto.messages.model_messages import Model, ReportStatus
from zensim.proto.stl import write_corners
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.meshes.convex_hull import find_hull
from zensim.sim_server.description.meshes.mesh_reader import read_mesh
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.urdf import urdf_parser
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig

if TYPE_CHECKING:
    from zensim.sim_server.description.meshes.mesh_conversion import MeshFiles

__all__ = ["rows", "table"]

LINKS = (4, 100, 500)
REPEATS = 20
REPEATS_WHEN_SHORT = 2
RUNS = 5
CROWD = 1000
CROWD_WHEN_SHORT = 50
WORLDS = 3
HULL_CORNERS = (501, 1500, 5001, 50_001)
"""Whole triangles."""
LAST = 20
"""Number of last spawns averaged as the thousandth."""
STEP_NS = 4_166_667
ROW = 40
"""Distance of robots in a row: one metre."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure parsing, then spawning."""
    for links in LINKS:
        text = a_caterpillar(links)
        repeats = REPEATS_WHEN_SHORT if is_short else REPEATS
        samples = tuple(_milliseconds(partial(read_urdf, text)) for _ in range(repeats))
        yield Figure(what=f"read a URDF of {links} links", unit="ms", samples=samples)
    yield from _report(REPEATS_WHEN_SHORT if is_short else REPEATS)
    yield _meshes(1 if is_short else RUNS)
    yield from _hulls(REPEATS_WHEN_SHORT if is_short else REPEATS)
    run_fleet_users = CROWD_WHEN_SHORT if is_short else CROWD
    model = read_urdf(read_builtin_model("box_bot"))
    spawns = [_spawns(model, run_fleet_users) for _ in range(1 if is_short else WORLDS)]
    first = tuple(world[0] for world in spawns)
    last = tuple(sample for world in spawns for sample in world[-LAST:])
    yield Figure(what="put the first box_bot into the engine", unit="ms", samples=first)
    yield Figure(
        what=f"put box_bot number {run_fleet_users} into the engine", unit="ms", samples=last
    )


def _report(repeats: int) -> Iterator[Figure]:
    text = read_builtin_model("box_bot_legacy")
    with_ms, without_ms = [], []
    for _ in range(repeats):
        with_ms.append(_milliseconds(partial(read_urdf, text)))
        with patch.object(urdf_parser, "ParseReport", Silence):
            without_ms.append(_milliseconds(partial(read_urdf, text)))
    yield Figure(what="read box_bot_legacy", unit="ms", samples=tuple(with_ms))
    yield Figure(what="read it and report nothing", unit="ms", samples=tuple(without_ms))


def _meshes(repeats: int) -> Figure:
    samples = []
    for seed in range(repeats):
        files: MeshFiles = {uri: (uri, data) for uri, data in large_robot.meshes(seed).items()}
        read = partial(
            parse_description, large_robot.text(), assets=files, allow_missing=False, compat="fixed"
        )
        samples.append(_milliseconds(read))
    return Figure(what="read a robot with twenty meshes", unit="ms", samples=tuple(samples))


def _hulls(repeats: int) -> Iterator[Figure]:
    for corners in HULL_CORNERS:
        data = an_ellipsoid(corners)
        hulls, floor = [], []
        for _ in range(repeats):
            hulls.append(_milliseconds(partial(_find_hull_of, data)))
            floor.append(_milliseconds(partial(_copy, data)))
        what = f"mesh of {corners} corners"
        yield Figure(what=f"hull of a {what}", unit="ms", samples=tuple(hulls))
        yield Figure(what=f"floor: read and write a {what}", unit="ms", samples=tuple(floor))
        ratios = tuple(one / other for one, other in zip(hulls, floor, strict=True))
        yield Figure(what=f"the first over the second, {corners} corners", unit="", samples=ratios)


def _find_hull_of(data: bytes) -> None:
    find_hull(read_mesh("a.stl", data).vertices)


def _copy(data: bytes) -> None:
    write_corners(read_mesh("a.stl", data).corners)


def an_ellipsoid(corners: int) -> bytes:
    """Write an ellipsoid as binary STL, whose corners are all on its surface."""
    points = np.random.default_rng(corners).normal(size=(corners, 3))
    points *= np.array([3.0, 2.0, 1.0]) / np.linalg.norm(points, axis=1)[:, None]
    # Triangles need not be neighbours for a hull.
    corners_of = points[np.arange(corners - corners % 3).reshape(-1, 3)]
    return write_corners(corners_of)


class Silence(ParseReport):
    """A report that discards its entries."""

    def unread_tag(self, subject: str, tag: str, known: Iterable[str]) -> None:
        """See `ParseReport`."""

    def unread_attribute(self, subject: str, name: str, known: Iterable[str]) -> None:
        """See `ParseReport`."""

    def _add(self, status: ReportStatus, subject: str, reason: str) -> None:
        """See `ParseReport`."""


def a_caterpillar(links: int) -> str:
    """Write a robot with many legs on one body: every fifth joint turns, the rest are fixed."""
    body = (
        '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial><collision><geometry><box size="1 1 1"/></geometry></collision>'
        '<visual><geometry><sphere radius="1"/></geometry><material name="grey">'
        '<color rgba="0.5 0.5 0.5 1"/></material></visual>'
    )
    legs = "".join(
        f'<link name="l{i}">{body}</link><joint name="j{i}" '
        f'type="{"fixed" if i % 5 else "continuous"}"><parent link="l0"/><child link="l{i}"/>'
        f'<origin xyz="{i} 0 0" rpy="0 0 1"/><axis xyz="0 1 0"/></joint>'
        for i in range(1, links)
    )
    return f'<robot name="caterpillar"><link name="l0">{body}</link>{legs}</robot>'


def _spawns(model: Model, count: int) -> list[float]:
    engine = PyBulletEngine(EngineConfig(STEP_NS))
    try:
        return [_spawn(engine, model, number) for number in range(count)]
    finally:
        engine.close()


def _spawn(engine: PyBulletEngine, model: Model, number: int) -> float:
    base = np.array([number % ROW, number // ROW, 0.06, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    return _milliseconds(lambda: engine.add(model, base))


def _milliseconds(call: Callable[[], object]) -> float:
    before = time.thread_time_ns()
    call()
    return (time.thread_time_ns() - before) * 1e-6
