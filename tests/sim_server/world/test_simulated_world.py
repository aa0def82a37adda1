"""World: who is in it, its time, and what a reset touches."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.engines import STEP_NS, ObedientEngine
from tests.models import a_box, a_state, an_arm, on_ground
from tests.sim_server.fakes import (
    a_command,
    a_spawn,
    a_world,
    kinds_of_events,
    names_in,
    wheel_speeds,
)
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.sim_server.errors import (
    EntityNotFound,
    IncorrectState,
    NameNotUnique,
    NameRefused,
    NamespaceRefused,
)
from zensim.sim_server.physics.engine import BodyStates, EngineRefused
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.world.simulated_world import World
from zensim.sim_server.world.spawn_request import ValidatedSpawn


def test_expected_entity_is_not_there_but_its_names_are() -> None:
    world = a_world("a")

    world.stage_spawn(a_spawn("b"))

    assert names_in(world) == ["a"]
    assert world.clock.take_events() == []
    assert world.entities.index.names == ("a",)
    with pytest.raises(NameNotUnique):
        world.spawn(a_spawn("b"))
    with pytest.raises(NamespaceRefused):
        world.spawn(a_spawn("c", "b"))


def test_expected_entities_are_let_in_all_at_once() -> None:
    world = a_world("a")
    expected = [world.stage_spawn(a_spawn(name))[0] for name in "cb"]

    world.commit_staged(expected)

    assert names_in(world) == ["a", "c", "b"]
    assert [event.entity for event in world.clock.take_events()] == ["c", "b"]
    assert not world.entities.is_staged(expected[0])


def test_entity_that_is_turned_away_leaves_nothing() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("a", engine=engine)

    world.rollback_staged([world.stage_spawn(a_spawn("b"))[0]])

    assert len(engine.bodies) == 1
    world.spawn(a_spawn("b"))
    assert names_in(world) == ["a", "b"]


def test_reset_that_deletes_what_was_spawned_expects_nobody() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("a", engine=engine)
    entity, _ = world.stage_spawn(a_spawn("b"))

    world.reset(ResetScope.SPAWNED)

    assert not world.entities.is_staged(entity)
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

    entity, _ = world.stage_spawn(a_spawn("b"))
    before = set(engine.concealed)
    world.commit_staged([entity])

    assert before == {entity.body}
    assert engine.concealed == set()


def test_expected_entity_overlaps_others_that_are_expected_too() -> None:
    world = a_world("a")
    world.stage_spawn(a_spawn("b", base=on_ground(5.0)))

    _, overlapped = world.stage_spawn(a_spawn("c", base=on_ground(5.02)))

    assert overlapped() == ["b"]


def test_world_refuses_spawn_when_name_is_taken() -> None:
    world = a_world("r1")

    with pytest.raises(NameNotUnique, match="'r1' already exists; choose another"):
        world.spawn(a_spawn("r1", "elsewhere"))

    assert names_in(world) == ["r1"]
    assert world.clock.take_events() == []


@pytest.mark.parametrize("name", ["", "1r", "r 1", "r/1", "é", "a" * 65])
def test_world_refuses_spawn_when_name_is_none(name: str) -> None:
    world = a_world()

    with pytest.raises(NameRefused, match="is not valid; use a letter"):
        world.spawn(a_spawn(name))

    assert names_in(world) == []


@pytest.mark.parametrize("namespace", ["sim", "world/r", "a//b", "a b", "/"])
def test_world_refuses_spawn_when_namespace_is_none(namespace: str) -> None:
    world = a_world()

    with pytest.raises(NamespaceRefused, match="use"):
        world.spawn(a_spawn("r1", namespace))

    assert names_in(world) == []


def test_world_refuses_spawn_when_namespace_is_taken() -> None:
    world = a_world("r1")

    with pytest.raises(NamespaceRefused, match="'r1' belongs to entity 'r1'; choose another"):
        world.spawn(a_spawn("r2", "/r1"))

    assert names_in(world) == ["r1"]


def test_world_numbers_a_name_when_it_is_taken_and_may_be_changed() -> None:
    world = a_world("r", "r_1")

    entity = world.spawn(a_spawn("r", allow_renaming=True))

    assert (entity.name, entity.namespace) == ("r_2", "r_2")


def test_world_keeps_a_numbered_name_valid_when_the_name_is_as_long_as_can_be() -> None:
    longest = "a" * 64
    world = a_world(longest)

    entity = world.spawn(a_spawn(longest, allow_renaming=True))

    assert entity.name == "a" * 56 + "_1"


def test_world_gives_a_name_again_when_its_entity_was_deleted() -> None:
    world = a_world("r1")
    world.delete("r1")

    world.spawn(a_spawn("r1"))

    assert names_in(world) == ["r1"]


def test_world_keeps_nothing_of_a_spawn_that_the_engine_refused() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r1", engine=engine)

    with pytest.raises(EngineRefused):
        world.spawn(a_spawn("r2", model=an_arm("planar")))

    assert names_in(world) == ["r1"]
    assert len(engine.bodies) == 1
    assert world.clock.take_events() == []


@pytest.mark.parametrize("act", ["delete", "state_of", "reported_state"])
def test_world_says_that_an_entity_does_not_exist(act: str) -> None:
    world = a_world("r1")

    with pytest.raises(EntityNotFound, match="'r2' does not exist; 'get_entities' lists"):
        getattr(world, act)("r2")


def test_world_tells_where_an_entity_is_after_another_was_deleted() -> None:
    world = a_world("r0", "r1", "r2")

    world.delete("r1")

    assert world.state_of("r2") == pytest.approx(on_ground(2.0))


def test_world_lines_joints_up_when_entities_have_none() -> None:
    world = a_world("r0")
    world.spawn(a_spawn("box", model=a_box(), base=a_state((5.0, 0.0, 0.1))))
    world.spawn(a_spawn("r1", base=on_ground(1.0)))

    roster = world.entities.index

    assert roster.names == ("r0", "box", "r1")
    assert roster.joint_start.tolist() == [0, 2, 2]
    assert roster.joint_count.tolist() == [2, 0, 2]


def test_world_counts_rosters_as_entities_come_and_go() -> None:
    world = a_world("r0")
    before = world.entities.roster_number

    world.spawn(a_spawn("r1"))
    world.delete("r0")

    assert world.entities.roster_number == before + 2


def test_world_time_is_steps_of_one_length() -> None:
    world = a_world()

    for _ in range(240):
        world.step()

    assert (world.clock.steps, world.clock.time_ns) == (240, 240 * STEP_NS)


def test_world_plays_and_pauses_with_events() -> None:
    world = a_world()

    world.clock.pause()
    state, name = world.clock.state, world.clock.state_name
    world.clock.play()

    assert (state, name) == (State.PAUSED, "paused")
    assert world.clock.state_name == "playing"
    assert kinds_of_events(world) == ["paused", "played"]


def test_world_refuses_to_be_stepped_when_it_plays() -> None:
    world = a_world()

    with pytest.raises(IncorrectState, match="playing; pause it before"):
        world.clock.require_paused()


@pytest.mark.parametrize("scope", [ResetScope.DEFAULT, ResetScope.ALL])
def test_world_is_empty_and_at_zero_when_all_is_reset(scope: ResetScope) -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r0", "r1", engine=engine)
    world.step()

    world.reset(scope)

    assert (names_in(world), engine.bodies) == ([], ())
    assert (world.clock.steps, world.clock.epoch) == (0, 1)
    assert kinds_of_events(world) == ["deleted", "deleted", "reset"]


def test_world_keeps_entities_and_states_when_time_is_reset() -> None:
    world = a_moved_world()
    moved = world.state_of("r0").copy()

    world.reset(ResetScope.TIME)

    assert (world.clock.steps, world.clock.time_ns) == (0, 0)
    assert world.state_of("r0") == pytest.approx(moved)
    assert world.claims.agent_of("r0") == "a"


def test_world_puts_entities_back_when_states_are_reset() -> None:
    world = a_moved_world()

    world.reset(ResetScope.STATE)

    assert world.clock.steps == 100
    assert world.state_of("r0") == pytest.approx(on_ground())
    world.step()
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_keeps_time_when_spawned_entities_are_reset() -> None:
    world = a_moved_world()

    world.reset(ResetScope.SPAWNED)

    assert (names_in(world), world.clock.steps, len(world.claims)) == ([], 100, 0)


def a_moved_world() -> World:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    for _ in range(100):
        world.step()
    return world


def test_world_snapshot_holds_every_entity() -> None:
    world = a_world("r0", "r1")
    world.clock.pause()

    snapshot = world.snapshot(0.5)

    assert snapshot.names == ("r0", "r1")
    assert np.frombuffer(snapshot.base).reshape(-1, 13)[:, 0].tolist() == [0.0, 1.0]
    assert len(snapshot.joint_positions) == 4 * 8
    assert (snapshot.real_time_factor, snapshot.state) == (0.5, "paused")


def test_world_snapshot_is_empty_when_nobody_is_there() -> None:
    snapshot = a_world().snapshot(1.0)

    assert (snapshot.names, snapshot.base, snapshot.joint_positions) == ((), b"", b"")


def test_world_places_an_entity() -> None:
    world = a_world("r0")

    world.place("r0", on_ground(7.0))

    assert world.state_of("r0") == pytest.approx(on_ground(7.0))


def test_world_starts_an_entity_where_it_was_spawned_whatever_becomes_of_the_row() -> None:
    world, row = a_world(), on_ground(1.0)
    world.spawn(a_spawn("r0", base=row))

    row[:] = 9.0
    world.reset(ResetScope.STATE)

    assert world.state_of("r0") == pytest.approx(on_ground(1.0))


def test_world_closes_its_engine() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))

    a_world(engine=engine).close()

    assert engine.is_closed


def test_world_rehearses_a_spawn_and_leaves_nothing() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r0", "r1", engine=engine)
    before = (world.entities.roster_number, world.states().base.tobytes(), engine.bodies)

    overlapped = world.check_overlaps(a_spawn("r9", base=on_ground(1.02)))

    assert overlapped == ["r1"]
    assert (world.entities.roster_number, world.states().base.tobytes(), engine.bodies) == before
    assert (names_in(world), world.clock.take_events()) == (["r0", "r1"], [])


def test_world_refuses_in_a_rehearsal_what_it_refuses_to_spawn() -> None:
    world = a_world("r0")

    with pytest.raises(NameNotUnique):
        world.check_overlaps(a_spawn("r0", base=on_ground(5.0)))
    with pytest.raises(EngineRefused):
        world.check_overlaps(a_spawn("r1", model=an_arm("planar")))

    assert names_in(world) == ["r0"]


def test_world_names_the_entities_that_an_entity_overlaps() -> None:
    world = a_world("r0", "r1")
    world.spawn(a_spawn("r2", base=on_ground(0.02)))

    first, second, _ = world.entities
    assert (world.find_overlaps(first), world.find_overlaps(second)) == (["r2"], [])


def test_what_belongs_to_the_world_has_no_namespace_and_outlives_a_reset() -> None:
    world = a_world("r1")
    shelf = ValidatedSpawn("shelf", "", a_box(is_static=True), a_state((1.0, 0.0, 0.1)))
    world.spawn(replace(shelf, belongs_to_world=True))
    world.place("shelf", a_state((5.0, 0.0, 0.1)))

    world.reset(ResetScope.ALL)

    assert names_in(world) == ["shelf"]
    assert world.entities.find("shelf").namespace == ""
    assert world.state_of("shelf")[0] == 1.0


def test_robot_of_a_world_has_a_namespace_so_that_it_can_be_driven() -> None:
    world = a_world()

    robot = world.spawn(replace(a_spawn("r1"), belongs_to_world=True))

    assert robot.namespace == "r1"


class CountingEngine(ObedientEngine):
    """Remembers what was read."""

    def __init__(self) -> None:
        super().__init__(EngineConfig(STEP_NS))
        self.reads: list[tuple[int, ...]] = []

    def read(self, bodies: Sequence[int]) -> BodyStates:
        self.reads.append(tuple(bodies))
        return super().read(bodies)


def test_world_reads_one_entity_alone_when_not_all_have_been_read() -> None:
    engine = CountingEngine()
    world = a_world("a", "b", engine=engine)
    world.step()

    row = world.state_of("b")

    assert engine.reads == [(world.entities.find("b").body,)]
    assert row.tolist() == world.states().base[1].tolist()


def test_world_reads_nothing_again_between_two_steps() -> None:
    engine = CountingEngine()
    world = a_world("a", "b", engine=engine)
    world.states()

    world.state_of("b")
    world.states()

    assert len(engine.reads) == 1
