"""World: who is in it, who drives whom, and what a command may do."""

import numpy as np
import pytest

from proto.claims import DriveCommand
from proto.result import ClaimCode
from proto.services import ResetScope, State
from sim_server.errors import (
    EntityNotFound,
    IncorrectState,
    NameNotUnique,
    NameRefused,
    NamespaceRefused,
    Refused,
    SimError,
)
from sim_server.physics.engine import EngineConfig, EngineRefused
from sim_server.world import World
from tests.engines import STEP_NS, ObedientEngine
from tests.models import a_box, a_state, an_arm, on_ground
from tests.sim_server.fakes import a_birth, a_command, a_world, floats


def names_in(world: World) -> list[str]:
    return [entity.name for entity in world.entities]


def kinds_of_events(world: World) -> list[str]:
    return [event.kind for event in world.take_events()]


def told_agents(world: World) -> list[str]:
    return [agent for agent, _ in world.drive_states()]


def wheel_speeds(world: World) -> list[float]:
    speeds: list[float] = world.reading().joint_velocities.tolist()
    return speeds


def test_world_refuses_spawn_when_name_is_taken() -> None:
    world = a_world("r1")

    with pytest.raises(NameNotUnique, match="'r1' already exists; choose another"):
        world.spawn(a_birth("r1", "elsewhere"))

    assert names_in(world) == ["r1"]
    assert world.take_events() == []


@pytest.mark.parametrize("name", ["", "1r", "r 1", "r/1", "é", "a" * 65])
def test_world_refuses_spawn_when_name_is_none(name: str) -> None:
    world = a_world()

    with pytest.raises(NameRefused, match="is not valid; use a letter"):
        world.spawn(a_birth(name))

    assert names_in(world) == []


@pytest.mark.parametrize("namespace", ["sim", "world/r", "a//b", "a b", "/"])
def test_world_refuses_spawn_when_namespace_is_none(namespace: str) -> None:
    world = a_world()

    with pytest.raises(NamespaceRefused, match="use"):
        world.spawn(a_birth("r1", namespace))

    assert names_in(world) == []


def test_world_refuses_spawn_when_namespace_is_taken() -> None:
    world = a_world("r1")

    with pytest.raises(NamespaceRefused, match="'r1' belongs to entity 'r1'; choose another"):
        world.spawn(a_birth("r2", "/r1"))

    assert names_in(world) == ["r1"]


def test_world_numbers_a_name_when_it_is_taken_and_may_be_changed() -> None:
    world = a_world("r", "r_1")

    entity = world.spawn(a_birth("r", allow_renaming=True))

    assert (entity.name, entity.namespace) == ("r_2", "r_2")


def test_world_keeps_a_numbered_name_valid_when_the_name_is_as_long_as_can_be() -> None:
    longest = "a" * 64
    world = a_world(longest)

    entity = world.spawn(a_birth(longest, allow_renaming=True))

    assert entity.name == "a" * 56 + "_1"


def test_world_gives_a_name_again_when_its_entity_was_deleted() -> None:
    world = a_world("r1")
    world.delete("r1")

    world.spawn(a_birth("r1"))

    assert names_in(world) == ["r1"]


def test_world_keeps_nothing_of_a_spawn_that_the_engine_refused() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r1", engine=engine)

    with pytest.raises(EngineRefused):
        world.spawn(a_birth("r2", model=an_arm("planar")))

    assert names_in(world) == ["r1"]
    assert len(engine.bodies) == 1
    assert world.take_events() == []


@pytest.mark.parametrize("act", ["delete", "state_of", "entity"])
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
    world.spawn(a_birth("box", model=a_box(), base=a_state((5.0, 0.0, 0.1))))
    world.spawn(a_birth("r1", base=on_ground(1.0)))

    roster = world.roster()

    assert roster.names == ("r0", "box", "r1")
    assert roster.joint_start.tolist() == [0, 2, 2]
    assert roster.joint_count.tolist() == [2, 0, 2]


def test_world_counts_rosters_as_entities_come_and_go() -> None:
    world = a_world("r0")
    before = world.roster_number

    world.spawn(a_birth("r1"))
    world.delete("r0")

    assert world.roster_number == before + 2


def test_world_time_is_steps_of_one_length() -> None:
    world = a_world()

    for _ in range(240):
        world.step()

    assert (world.steps, world.time_ns) == (240, 240 * STEP_NS)


def test_world_drives_an_entity_as_its_agent_commands() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()

    # The joints of a cart come right before left.
    assert wheel_speeds(world) == [5.0, 3.0]
    assert (world.commands, world.dropped) == (1, 0)


def test_world_takes_the_newest_command_when_several_come_in_one_step() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    for speed in (1.0, 2.0, 3.0):
        world.command("a", a_command(world, "a", speed, speed))
    world.step()

    assert wheel_speeds(world) == [3.0, 3.0]


def test_world_cuts_targets_by_claim_when_an_agent_drives_several() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r1", "r0"), "stop")

    world.command("a", a_command(world, "a", 1.0, 2.0, 3.0, 4.0))
    world.step()

    assert wheel_speeds(world) == [4.0, 3.0, 2.0, 1.0]


@pytest.mark.parametrize(
    "spoiled",
    [
        {"epoch": 1},
        {"claims": b""},
        {"claims": b"\xff" * 4},
        {"targets": floats([1.0])},
        {"targets": floats([1.0, 2.0, 3.0])},
        {"targets": floats([1.0, 2.0])[:-1]},
        {"targets": floats([float("nan"), 2.0])},
        {"targets": floats([1.0, float("-inf")])},
    ],
    ids=str,
)
def test_world_drops_and_counts_a_command_that_does_not_fit(spoiled: dict[str, object]) -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    good = a_command(world, "a", 1.0, 2.0)
    fields = {name: getattr(good, name) for name in good.__struct_fields__}

    is_taken = world.command("a", DriveCommand(**{**fields, **spoiled}))
    world.step()

    assert not is_taken
    assert (world.commands, world.dropped) == (0, 1)
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_drops_a_command_of_an_agent_that_drives_nothing() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    world.command("b", a_command(world, "a", 1.0, 2.0))
    world.step()

    assert (world.commands, world.dropped) == (0, 1)
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_drops_a_command_under_a_claim_that_was_renewed() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    stale = a_command(world, "a", 1.0, 2.0)

    world.claim("a", ("r0",), "stop")
    world.command("a", stale)

    assert (world.commands, world.dropped) == (0, 1)


def test_world_drops_a_command_of_before_a_reset() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    stale = a_command(world, "a", 1.0, 2.0)

    world.reset(ResetScope.TIME)
    world.command("a", stale)

    assert world.dropped == 1


def test_world_forgets_a_command_when_the_fleet_changes_before_the_step() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0", "r1"), "stop")
    world.command("a", a_command(world, "a", 1.0, 1.0, 1.0, 1.0))

    world.delete("r0")
    world.step()

    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_never_uses_a_claim_twice() -> None:
    world = a_world("r0", "r1")

    numbers = []
    for agent in ("a", "b", "a"):
        numbers += [claim.claim for claim in world.claim(agent, ("r0", "r1"), "stop")]
        world.release(agent)

    assert len(set(numbers)) == len(numbers) == 6


def test_world_tells_an_agent_what_it_needs_to_drive() -> None:
    world = a_world("r0")

    (claim,) = world.claim("a", ("r0",), "stop")

    assert (claim.entity, claim.namespace, claim.robot_description) == ("r0", "r0", "<robot/>")
    assert claim.model == world.entity("r0").model
    assert claim.spawn_state == pytest.approx(on_ground())


def test_world_grants_an_entity_once_when_it_is_named_twice() -> None:
    world = a_world("r0")

    claims = world.claim("a", ("r0", "r0"), "stop")

    assert len(claims) == 1
    assert world.claimed == 1


def test_world_refuses_all_of_a_claim_when_another_agent_drives_one() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r1",), "stop")

    with pytest.raises(Refused, match="'r1' is driven by agent 'a'; stop that agent") as refused:
        world.claim("b", ("r0", "r1"), "stop")

    assert refused.value.code == ClaimCode.ALREADY_CLAIMED
    assert (world.agent_of("r0"), world.agent_of("r1")) == ("", "a")


def test_world_refuses_all_of_a_claim_when_one_does_not_exist() -> None:
    world = a_world("r0")

    with pytest.raises(EntityNotFound):
        world.claim("b", ("r0", "r9"), "stop")

    assert world.claimed == 0


def test_world_stops_wheels_when_an_agent_goes_that_said_stop() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()
    world.take_events()

    world.release("a")

    assert wheel_speeds(a_fresh_look(world)) == [0.0, 0.0]
    assert world.agent_of("r0") == ""
    assert kinds_of_events(world) == ["released"]


def a_fresh_look(world: World) -> World:
    world.step()
    return world


def test_world_lets_wheels_turn_when_an_agent_goes_that_said_keep() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "keep")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()

    world.release("a")
    world.step()

    assert wheel_speeds(world) == [5.0, 3.0]


def test_world_deletes_entities_when_an_agent_goes_that_said_delete() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "delete")
    world.take_events()

    world.release("a")

    assert names_in(world) == ["r1"]
    assert kinds_of_events(world) == ["released", "deleted"]


def test_world_releases_nobody_when_an_unknown_agent_goes() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.take_events()

    world.release("b")

    assert world.agents == ("a",)
    assert world.take_events() == []


def test_world_tells_an_agent_only_of_its_entities_in_the_order_of_claiming() -> None:
    world = a_world("r0", "r1", "r2")
    world.claim("a", ("r2",), "stop")
    world.claim("a", ("r0",), "stop")

    ((agent, state),) = world.drive_states()

    assert agent == "a"
    rows = np.frombuffer(state.base).reshape(-1, 13)
    assert rows == pytest.approx(np.array([on_ground(2.0), on_ground(0.0)]))
    assert np.frombuffer(state.claims, dtype="<u4").tolist() == [1, 2]
    assert len(state.joint_positions) == len(state.joint_velocities) == 4 * 8


def test_world_tells_an_agent_once_that_it_lost_its_last_entity() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "stop")
    world.claim("b", ("r1",), "stop")

    world.delete("r0")

    told = dict(world.drive_states())
    assert set(told) == {"a", "b"}
    assert told["a"].claims == told["a"].base == b""
    assert told_agents(world) == ["b"]


def test_world_tells_an_agent_of_its_new_entity_only_when_it_lost_one_just_before() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "stop")
    world.delete("r0")

    world.claim("a", ("r1",), "stop")

    ((_, state),) = world.drive_states()
    assert len(state.base) == 13 * 8


@pytest.mark.parametrize("on_release", ["stop", "keep", "delete"])
def test_world_tells_nothing_to_an_agent_that_has_gone(on_release: str) -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), on_release)  # type: ignore[arg-type]

    world.release("a")

    assert told_agents(world) == []


def test_world_plays_and_pauses_with_events() -> None:
    world = a_world()

    world.pause()
    state, name = world.state, world.state_name
    world.play()

    assert (state, name) == (State.PAUSED, "paused")
    assert world.state_name == "playing"
    assert kinds_of_events(world) == ["paused", "played"]


def test_world_refuses_to_be_stepped_when_it_plays() -> None:
    world = a_world()

    with pytest.raises(IncorrectState, match="playing; pause it before"):
        world.require_paused()


@pytest.mark.parametrize("scope", [ResetScope.DEFAULT, ResetScope.ALL])
def test_world_is_empty_and_at_zero_when_all_is_reset(scope: ResetScope) -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r0", "r1", engine=engine)
    world.step()

    world.reset(scope)

    assert (names_in(world), engine.bodies) == ([], ())
    assert (world.steps, world.epoch) == (0, 1)
    assert kinds_of_events(world) == ["deleted", "deleted", "reset"]


def test_world_keeps_entities_and_states_when_time_is_reset() -> None:
    world = a_moved_world()
    moved = world.state_of("r0").copy()

    world.reset(ResetScope.TIME)

    assert (world.steps, world.time_ns) == (0, 0)
    assert world.state_of("r0") == pytest.approx(moved)
    assert world.agent_of("r0") == "a"


def test_world_puts_entities_back_when_states_are_reset() -> None:
    world = a_moved_world()

    world.reset(ResetScope.STATE)

    assert world.steps == 100
    assert world.state_of("r0") == pytest.approx(on_ground())
    assert wheel_speeds(a_fresh_look(world)) == [0.0, 0.0]


def test_world_keeps_time_when_spawned_entities_are_reset() -> None:
    world = a_moved_world()

    world.reset(ResetScope.SPAWNED)

    assert (names_in(world), world.steps, world.claimed) == ([], 100, 0)


def a_moved_world() -> World:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    for _ in range(100):
        world.step()
    return world


def test_world_is_at_a_control_step_every_third_step() -> None:
    world = a_world()

    found = []
    for _ in range(6):
        world.step()
        found.append(world.is_control_step)

    assert found == [False, False, True, False, False, True]


def test_world_remembers_once_how_long_an_entity_took_to_be_driven() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "stop")

    world.note_ready("a", 2_000_000_000)
    world.note_ready("a", 9_000_000_000)

    assert world.ready_s == {"r0": pytest.approx(2.0)}


def test_world_snapshot_holds_every_entity() -> None:
    world = a_world("r0", "r1")
    world.pause()

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
    world.spawn(a_birth("r0", base=row))

    row[:] = 9.0
    world.reset(ResetScope.STATE)

    assert world.state_of("r0") == pytest.approx(on_ground(1.0))


def test_world_closes_its_engine() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))

    a_world(engine=engine).close()

    assert engine.is_closed


def test_world_refusals_are_all_sim_errors() -> None:
    for kind in (EntityNotFound, NameNotUnique, NameRefused, NamespaceRefused, Refused):
        assert issubclass(kind, SimError)
