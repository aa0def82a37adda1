"""Entities that are expected: made, but not there before all of them are."""

from collections.abc import Sequence

import pytest

from tests.engines import STEP_NS, ObedientEngine
from tests.models import on_ground
from tests.sim_server.fakes import a_birth, a_world, names_in
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.sim_server.errors import NameNotUnique, NamespaceRefused
from zensim.sim_server.physics.engine_config import EngineConfig


def test_expected_entity_is_not_there_but_its_names_are() -> None:
    world = a_world("a")

    world.expect(a_birth("b"))

    assert names_in(world) == ["a"]
    assert world.take_events() == []
    assert world.roster().names == ("a",)
    with pytest.raises(NameNotUnique):
        world.spawn(a_birth("b"))
    with pytest.raises(NamespaceRefused):
        world.spawn(a_birth("c", "b"))


def test_expected_entities_are_let_in_all_at_once() -> None:
    world = a_world("a")
    expected = [world.expect(a_birth(name))[0] for name in "cb"]

    world.let_in(expected)

    assert names_in(world) == ["a", "c", "b"]
    assert [event.entity for event in world.take_events()] == ["c", "b"]
    assert not world.expects(expected[0])


def test_entity_that_is_turned_away_leaves_nothing() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("a", engine=engine)

    world.turn_away([world.expect(a_birth("b"))[0]])

    assert len(engine.bodies) == 1
    world.spawn(a_birth("b"))
    assert names_in(world) == ["a", "b"]


def test_reset_that_deletes_what_was_spawned_expects_nobody() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("a", engine=engine)
    entity, _ = world.expect(a_birth("b"))

    world.reset(ResetScope.SPAWNED)

    assert not world.expects(entity)
    assert engine.bodies == ()


class ConcealingEngine(ObedientEngine):
    """Remembers who is out of sight."""

    def __init__(self) -> None:
        super().__init__(EngineConfig(STEP_NS))
        self.concealed: set[int] = set()

    def hide(self, body: int) -> None:
        self.concealed.add(body)

    def show(self, bodies: Sequence[int]) -> None:
        self.concealed -= set(bodies)


def test_expected_entity_is_concealed_until_it_is_let_in() -> None:
    engine = ConcealingEngine()
    world = a_world("a", engine=engine)

    entity, _ = world.expect(a_birth("b"))
    before = set(engine.concealed)
    world.let_in([entity])

    assert before == {entity.body}
    assert engine.concealed == set()


def test_expected_entity_overlaps_others_that_are_expected_too() -> None:
    world = a_world("a")
    world.expect(a_birth("b", base=on_ground(5.0)))

    _, overlapped = world.expect(a_birth("c", base=on_ground(5.02)))

    assert overlapped() == ["b"]
