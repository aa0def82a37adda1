"""Mechanics

Situations with an answer in the textbook, through the whole service, in both engines. A figure is
the difference from that answer, and each has a tolerance: the first figures count those within it.
Where an engine cannot reach it, the figure says whether the report of the spawn predicts that.
"""

from collections.abc import Iterator

from msgspec import structs

from benchmarks import mechanics_bodies, mechanics_contacts, mechanics_joints
from benchmarks.figures import Figure, table

__all__ = ["rows", "table"]

ENGINES = ("pybullet", "mujoco")


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure contacts, joints and bodies in each engine."""
    for engine in ENGINES:
        parts = (mechanics_contacts, mechanics_joints, mechanics_bodies)
        found = [one for part in parts for one in part.rows(engine, is_short=is_short)]
        judged = [one for one in found if one.limit is not None]
        share = 100.0 * sum(not one.is_missed for one in judged) / len(judged)
        what = f"{engine}: figures within their tolerance"
        yield Figure(what=what, unit="%", samples=(share,))
        yield from (structs.replace(one, limit=None) for one in found)
