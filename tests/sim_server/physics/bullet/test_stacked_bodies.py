"""Which loose bodies lie on one another, and what keeps a stack where it is."""

import pickle
from collections.abc import Collection, Sequence

import numpy as np
import pytest

from tests.engines import STEP_NS, advance, running
from tests.models import a_state
from zensim.proto.messages.model_messages import Inertial, Link, Model, Shape
from zensim.proto.se3 import FloatArray
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.bullet.stacked_bodies import StackedBodies
from zensim.sim_server.physics.engine import Engine

EDGE_M = 0.2
MOMENT = EDGE_M**2 / 6.0
STEPS_PER_S = round(1e9 / STEP_NS)
CREEP_M = 2e-3


def a_cube(friction: float) -> Model:
    shape = Shape("box", (EDGE_M,) * 3, friction=friction)
    inertial = Inertial(1.0, inertia=(MOMENT, 0.0, 0.0, MOMENT, 0.0, MOMENT))
    return Model("cube", (Link("base", inertial, (shape,)),))


def add_stack(engine: Engine, count: int, friction: float, *, wait: int = 4) -> list[int]:
    """Stack cubes, each some steps after the one below it."""
    bodies = []
    for number in range(count):
        place = (0.0, 0.0, EDGE_M * (number + 0.5))
        bodies.append(engine.add(a_cube(friction), a_state(place)))
        advance(engine, wait)
    return bodies


def find_creep(engine: Engine, bodies: Sequence[int]) -> FloatArray:
    places = [(0.0, 0.0, EDGE_M * (number + 0.5)) for number in range(len(bodies))]
    distances: FloatArray = np.linalg.norm(engine.read(bodies).base[:, :3] - places, axis=1)
    return distances


@pytest.mark.parametrize("friction", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("count", [2, 5])
def test_stack_does_not_creep(count: int, friction: float) -> None:
    with running(PyBulletEngine) as engine:
        bodies = add_stack(engine, count, friction)
        advance(engine, 60 * STEPS_PER_S)

        assert find_creep(engine, bodies).max() < CREEP_M


def test_restored_stack_goes_on_as_it_was() -> None:
    with running(PyBulletEngine) as engine:
        bodies = add_stack(engine, 3, 0.5)
        advance(engine, STEPS_PER_S // 2)
        saved = pickle.dumps(engine)
        advance(engine, STEPS_PER_S)
        answer = engine.read(bodies).base
        engine.set_base_state(bodies[2], a_state((5.0, 0.0, EDGE_M)))
        advance(engine, STEPS_PER_S // 4)
        restored = pickle.loads(saved)
        restored.resume()
        advance(restored, STEPS_PER_S)

        # Not to the bit: contacts are searched anew.
        assert restored.read(bodies).base[:, :3] == pytest.approx(answer[:, :3], abs=1e-5)


def test_cube_whose_stack_is_gone_slides_as_others() -> None:
    with running(PyBulletEngine) as engine:
        lower, upper = add_stack(engine, 2, 0.5)
        advance(engine, STEPS_PER_S)
        engine.remove(upper)
        alone = engine.add(a_cube(0.5), a_state((0.0, 3.0, EDGE_M / 2.0)))
        advance(engine, STEPS_PER_S // 10)
        starts = engine.read([lower, alone]).base
        for body, base in zip((lower, alone), starts, strict=True):
            engine.set_base_state(body, np.array([*base[:7], 1.0, *[0.0] * 5]))
        advance(engine, STEPS_PER_S)
        ways = engine.read([lower, alone]).base[:, 0] - starts[:, 0]

        assert ways[0] == pytest.approx(ways[1], rel=0.01)


def search(
    stacks: StackedBodies, pairs: Collection[tuple[int, int]], asleep: Collection[int] = ()
) -> frozenset[int]:
    def read_contacts(body: int) -> list[Sequence[int]]:
        return [
            (0, body, one if other == body else other)
            for one, other in pairs
            if body in (one, other)
        ]

    return stacks.search(read_contacts, asleep)


def a_group(*bodies: int) -> StackedBodies:
    stacks = StackedBodies(STEP_NS * 1e-9)
    for body in bodies:
        stacks.add(body)
    return stacks


def test_loose_bodies_that_touch_are_anchored_until_they_part() -> None:
    stacks = a_group(1, 2, 3)

    assert search(stacks, [(1, 2), (3, 9)]) == {1, 2}
    assert stacks.are_moving
    assert search(stacks, []) == {1, 2}
    assert not stacks.anchored
    assert not stacks.are_moving


def test_sleeping_stack_keeps_its_anchors_and_costs_nothing() -> None:
    stacks = a_group(1, 2)
    search(stacks, [(1, 2)])

    assert not search(stacks, [(1, 2)], asleep=(1, 2))
    assert stacks.anchored == {1, 2}
    assert not stacks.are_moving


def test_sleeping_body_that_is_touched_is_anchored() -> None:
    assert search(a_group(1, 2), [(1, 2)], asleep=(2,)) == {1, 2}


def test_single_body_is_never_searched() -> None:
    stacks = a_group(1)

    assert not any(stacks.is_due() for _ in range(100))


def test_forgotten_body_says_whether_it_was_anchored() -> None:
    stacks = a_group(1, 2, 3)
    search(stacks, [(1, 2)])

    assert stacks.forget(1)
    assert not stacks.forget(3)
    assert stacks.anchored == {2}
