"""Reading and building robots

Processor time of reading a URDF of 4, 100 and 500 links in the server's own way, and of putting a
box_bot into PyBullet as the first and as the thousandth of a world.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from proto.model import Model
from sim_server.description.library import model_text
from sim_server.description.urdf import read_urdf
from sim_server.physics.engine import EngineConfig
from sim_server.physics.pybullet_engine import PyBulletEngine
from tests.benchmark.figures import Asked, Figure, table

__all__ = ["rows", "table"]

LINKS = (4, 100, 500)
REPEATS = 20
REPEATS_WHEN_SHORT = 2
CROWD = 1000
CROWD_WHEN_SHORT = 50
WORLDS = 3
LAST = 20
"""How many of the last spawns stand for the thousandth."""
STEP_NS = 4_166_667
ROW = 40
"""Robots in a row, one metre apart."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure reading, then spawning."""
    for links in LINKS:
        text = a_caterpillar(links)
        repeats = REPEATS_WHEN_SHORT if is_short else REPEATS
        samples = tuple(_milliseconds(partial(read_urdf, text)) for _ in range(repeats))
        yield Figure(what=f"read a URDF of {links} links", unit="ms", samples=samples)
    crowd = CROWD_WHEN_SHORT if is_short else CROWD
    model = read_urdf(model_text("box_bot"))
    spawns = [_spawns(model, crowd) for _ in range(1 if is_short else WORLDS)]
    first = tuple(world[0] for world in spawns)
    last = tuple(sample for world in spawns for sample in world[-LAST:])
    yield Figure(what="put the first box_bot into the engine", unit="ms", samples=first)
    yield Figure(
        what=f"put box_bot number {crowd} into the engine",
        unit="ms",
        samples=last,
        asked=Asked("median", "<=", 1.5),
    )


def a_caterpillar(links: int) -> str:
    """Write a robot whose legs hang from one body: every fifth turns, the rest is fixed."""
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
