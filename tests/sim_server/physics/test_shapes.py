"""Shapes that are made once."""

from tests.models import a_box_bot
from zensim.sim_server.physics.blueprint import blueprint_of
from zensim.sim_server.physics.creation import SOLID_KINDS
from zensim.sim_server.physics.shapes import Shapes


def test_shapes_of_alike_parts_are_made_once() -> None:
    made: list[object] = []

    def make(**solids: object) -> int:
        made.append(solids)
        return len(made)

    shapes = Shapes(make, folder="", kinds=dict.fromkeys(SOLID_KINDS, 1), dented=8)
    plan = blueprint_of(a_box_bot())
    _, left, right, _ = plan.parts

    first, second = shapes.of(plan, left.shapes), shapes.of(plan, right.shapes)

    assert first == second == len(made) == 1
    assert left not in shapes.unmade(plan)
    assert shapes.of(plan, ()) == -1
