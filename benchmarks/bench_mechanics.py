"""Mechanics

Situations with an answer in the textbook, through the whole service, in both engines. A figure is
the difference from that answer, and its limit is the tolerance. Where an engine cannot reach it,
the figure says whether the report of the spawn predicts that.
"""

from collections.abc import Iterator

from benchmarks import mechanics_bodies, mechanics_contacts, mechanics_joints
from benchmarks.figures import Figure, table

__all__ = ["rows", "table"]

ENGINES = ("pybullet", "mujoco")


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure contacts, joints and bodies in each engine."""
    for engine in ENGINES:
        for part in (mechanics_contacts, mechanics_joints, mechanics_bodies):
            yield from part.rows(engine, is_short=is_short)
