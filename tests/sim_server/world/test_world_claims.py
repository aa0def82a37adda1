"""World: who drives whom, what a command may do, and what agents are told."""

import numpy as np
import pytest

from tests.models import on_ground
from tests.sim_server.fakes import (
    a_command,
    a_world,
    floats,
    kinds_of_events,
    names_in,
    wheel_speeds,
)
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.result_messages import ClaimCode
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.sim_server.errors import EntityNotFound, RequestRefused
from zensim.sim_server.world.simulated_world import World


def told_agents(world: World) -> list[str]:
    return [agent for agent, _ in world.drive_states()]


def test_world_drives_an_entity_as_its_agent_commands() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()

    # The joints of a cart come right before left.
    assert wheel_speeds(world) == [5.0, 3.0]
    assert (world.claims.taken, world.claims.dropped) == (1, 0)


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
    assert (world.claims.taken, world.claims.dropped) == (0, 1)
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_drops_a_command_of_an_agent_that_drives_nothing() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    world.command("b", a_command(world, "a", 1.0, 2.0))
    world.step()

    assert (world.claims.taken, world.claims.dropped) == (0, 1)
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_drops_a_command_under_a_claim_that_was_renewed() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    stale = a_command(world, "a", 1.0, 2.0)

    world.claim("a", ("r0",), "stop")
    world.command("a", stale)

    assert (world.claims.taken, world.claims.dropped) == (0, 1)


def test_world_drops_a_command_of_before_a_reset() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    stale = a_command(world, "a", 1.0, 2.0)

    world.reset(ResetScope.TIME)
    world.command("a", stale)

    assert world.claims.dropped == 1


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
    assert claim.model == world.entities.find("r0").model
    assert claim.spawn_state == pytest.approx(on_ground())


def test_world_grants_an_entity_once_when_it_is_named_twice() -> None:
    world = a_world("r0")

    claims = world.claim("a", ("r0", "r0"), "stop")

    assert len(claims) == 1
    assert len(world.claims) == 1


def test_world_refuses_all_of_a_claim_when_another_agent_drives_one() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r1",), "stop")

    with pytest.raises(
        RequestRefused, match="'r1' is driven by agent 'a'; stop that agent"
    ) as refused:
        world.claim("b", ("r0", "r1"), "stop")

    assert refused.value.code == ClaimCode.ALREADY_CLAIMED
    assert (world.claims.agent_of("r0"), world.claims.agent_of("r1")) == ("", "a")


def test_world_refuses_all_of_a_claim_when_one_does_not_exist() -> None:
    world = a_world("r0")

    with pytest.raises(EntityNotFound):
        world.claim("b", ("r0", "r9"), "stop")

    assert len(world.claims) == 0


def test_world_stops_wheels_when_an_agent_goes_that_said_stop() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()
    world.clock.take_events()

    world.release("a")

    world.step()
    assert wheel_speeds(world) == [0.0, 0.0]
    assert world.claims.agent_of("r0") == ""
    assert kinds_of_events(world) == ["released"]


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
    world.clock.take_events()

    world.release("a")

    assert names_in(world) == ["r1"]
    assert kinds_of_events(world) == ["released", "deleted"]


def test_world_releases_nobody_when_an_unknown_agent_goes() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.clock.take_events()

    world.release("b")

    assert world.claims.agents == ("a",)
    assert world.clock.take_events() == []


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

    world.record_ready_time("a", 2_000_000_000)
    world.record_ready_time("a", 9_000_000_000)

    assert world.ready_s == {"r0": pytest.approx(2.0)}
