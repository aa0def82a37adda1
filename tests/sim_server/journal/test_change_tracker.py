"""Recorder: whatever changes the world is kept, nobody is told before, and failures are undone."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryCall
from tests.sim_server.fakes import answer_of, names_in
from tests.sim_server.journal.journaled_server import DISK_FULL, Journalled, contents_in
from zensim.proto.messages.entity_messages import (
    GetEntitiesRequest,
    GetEntitiesResponse,
    SetEntityStateRequest,
)
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulationState,
    State,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.journal.change_tracker import BOND_TIMEOUT_S, MOTION_PERIOD_S, WriterEnded


def ask(kept: Journalled, service: str, request: msgspec.Struct, name: str = "") -> MemoryCall:
    call = kept.server.ask(service, request)
    call.request_id = name.encode()
    return call


def spawn(kept: Journalled, name: str, request_id: str = "", bond: str = "") -> MemoryCall:
    order = SpawnEntityOrder(name, entity_resource=Resource("box_bot"), bond=bond)
    return ask(kept, "spawn_entity", order, request_id)


def code_of(call: MemoryCall) -> int:
    response = answer_of(call, SERVICES[call.name].response)
    return int(response.result.result)  # type: ignore[attr-defined]


def listed(call: MemoryCall) -> tuple[str, ...]:
    response = answer_of(call, GetEntitiesResponse)
    assert isinstance(response, GetEntitiesResponse)
    return response.entities


def turn(kept: Journalled, times: int = 1) -> None:
    for _ in range(times):
        kept.server.loop.turn()


@pytest.fixture
def kept(tmp_path: Path) -> Journalled:
    kept = Journalled(tmp_path, "r0", "r1")
    turn(kept)
    return kept


def test_reply_waits_until_what_it_tells_is_on_the_disk(kept: Journalled) -> None:
    kept.disk.is_slow = True
    calls = [spawn(kept, "r2"), ask(kept, "get_entities", GetEntitiesRequest())]

    turn(kept, 3)
    assert [call.answers for call in calls] == [[], []]

    kept.disk.flush()
    turn(kept)
    assert code_of(calls[0]) == ResultCode.OK
    assert listed(calls[1]) == ("r0", "r1", "r2")


def test_read_does_not_wait_when_nothing_has_changed(kept: Journalled) -> None:
    kept.disk.is_slow = True
    call = ask(kept, "get_entities", GetEntitiesRequest())

    turn(kept)

    assert listed(call) == ("r0", "r1")


@pytest.mark.parametrize("how", ["request", "bond", "release"])
def test_delete_is_kept_however_it_came(kept: Journalled, how: str) -> None:
    if how == "request":
        ask(kept, "delete_entity", DeleteEntityRequest("r0"))
    elif how == "bond":
        born_ns = kept.world.entities.find("r0").born_ns
        kept.parts.bonds.alive.add("b")
        kept.parts.bonds.entities["b"] = [("r0", born_ns)]
        kept.server.inbox.bonds.append(("b", False))
    else:
        kept.parts.agents.alive.add("a")
        kept.world.claim("a", ("r0",), "delete")
        kept.server.inbox.agents.append(("a", False))
    turn(kept)
    kept.crash()

    assert [row.name for row in contents_in(kept.folder).entities] == ["r1"]


def test_name_that_was_given_again_is_kept_as_another_entity(kept: Journalled) -> None:
    ask(kept, "delete_entity", DeleteEntityRequest("r0"))
    spawn(kept, "r0")
    turn(kept)
    kept.crash()

    found = contents_in(kept.folder)
    assert [row.name for row in found.entities] == ["r1", "r0"]
    assert found.models[found.entities[1].model].name == "box_bot"


def test_models_and_texts_go_with_their_last_user(kept: Journalled) -> None:
    spawn(kept, "a")
    spawn(kept, "b")
    turn(kept)
    assert len(contents_of_open(kept)) == 2

    for name in ("a", "b", "r0"):
        ask(kept, "delete_entity", DeleteEntityRequest(name))
    turn(kept)

    assert len(contents_of_open(kept)) == 1
    assert len(kept.ledger.rows("text")) == 1


def contents_of_open(kept: Journalled) -> dict[str, bytes]:
    return kept.ledger.rows("model")


def test_place_that_was_set_is_kept_before_the_reply(kept: Journalled) -> None:
    call = ask(kept, "set_entity_state", SetEntityStateRequest("r0", set_pose=True))
    turn(kept)
    kept.crash()

    assert code_of(call) == ResultCode.OK
    found = contents_in(kept.folder)
    assert found.stand(found.entities[0])[0][:3].tolist() == [0.0, 0.0, 0.0]


def test_motion_is_kept_often_enough(kept: Journalled) -> None:
    kept.server.turn_for(3.0)

    steps = [
        record.motion.steps
        for batch in kept.disk.batches
        for record in batch
        if record.motion is not None
    ]
    gaps_s = np.diff(steps) * kept.world.clock.step_ns * 1e-9
    assert len(steps) > 5
    assert gaps_s.max() <= MOTION_PERIOD_S + 0.06


def test_nothing_is_written_while_nothing_happens(kept: Journalled) -> None:
    kept.world.clock.pause()
    turn(kept, 2)
    kept.server.turn_for(2.0 * MOTION_PERIOD_S)
    written = len(kept.disk.batches)

    kept.server.turn_for(10.0)

    assert len(kept.disk.batches) == written


def test_spawn_is_taken_back_when_the_disk_is_full(kept: Journalled) -> None:
    kept.disk.is_full = True
    refused, seen = spawn(kept, "r2", "1"), ask(kept, "get_entities", GetEntitiesRequest())

    turn(kept, 3)

    assert code_of(refused) == ResultCode.OPERATION_FAILED
    assert DISK_FULL.encode() in refused.answers[0].payload
    assert listed(seen) == ("r0", "r1")
    assert names_in(kept.world) == ["r0", "r1"]


def test_delete_is_taken_back_when_the_disk_is_full(kept: Journalled) -> None:
    before = kept.world.state_of("r0").tolist()
    kept.disk.is_full = True
    call = ask(kept, "delete_entity", DeleteEntityRequest("r0"))

    turn(kept, 3)

    assert code_of(call) == ResultCode.OPERATION_FAILED
    assert sorted(names_in(kept.world)) == ["r0", "r1"]
    assert kept.world.state_of("r0").tolist() == before


def test_spawn_waits_for_another_try_while_the_disk_is_full(kept: Journalled) -> None:
    kept.disk.is_full = True
    spawn(kept, "r2")
    turn(kept, 3)
    events = len(kept.server.events())
    refused = spawn(kept, "r3")
    turn(kept, 3)
    kept.disk.is_full = False
    taken = spawn(kept, "r4", "4")
    turn(kept, 3)
    kept.crash()

    assert code_of(refused) == ResultCode.OPERATION_FAILED
    assert ("spawned", "r3") not in kept.server.events()[events:]
    assert code_of(taken) == ResultCode.OK
    assert [row.name for row in contents_in(kept.folder).entities] == ["r0", "r1", "r4"]


def test_robots_go_on_while_the_disk_is_full(kept: Journalled) -> None:
    kept.disk.is_full = True
    before = kept.world.clock.steps

    kept.server.turn_for(2.0)
    seen = ask(kept, "get_entities", GetEntitiesRequest())
    turn(kept, 2)

    assert kept.world.clock.steps > before
    assert listed(seen) == ("r0", "r1")


def test_pause_stands_and_is_kept_once_the_disk_has_room(kept: Journalled) -> None:
    kept.disk.is_full = True
    request = SetSimulationStateRequest(SimulationState(State.PAUSED))
    call = ask(kept, "set_simulation_state", request, "1")
    turn(kept, 3)
    assert code_of(call) == ResultCode.OK

    kept.disk.is_full = False
    kept.server.turn_for(2.0 * MOTION_PERIOD_S)
    kept.crash()

    assert contents_in(kept.folder).clock.state == State.PAUSED


def test_bond_that_ended_while_the_disk_was_full_ends_for_good(kept: Journalled) -> None:
    kept.parts.bonds.alive.add("b")
    spawn(kept, "r2", bond="b")
    turn(kept)
    kept.disk.is_full = True
    kept.server.inbox.bonds.append(("b", False))
    kept.server.turn_for(2.0 * MOTION_PERIOD_S)
    assert names_in(kept.world) == ["r0", "r1"]

    kept.disk.is_full = False
    kept.server.turn_for(2.0 * MOTION_PERIOD_S)
    kept.crash()

    assert [row.name for row in contents_in(kept.folder).entities] == ["r0", "r1"]


def test_retry_gets_the_same_answer_and_no_second_robot_after_a_restart(kept: Journalled) -> None:
    first = spawn(kept, "r2", "abc")
    turn(kept)
    kept.crash()
    again = Journalled(kept.folder)

    retry = spawn(again, "r2", "abc")
    other = spawn(again, "r2", "def")
    turn(again)

    assert retry.answers[0].payload == first.answers[0].payload
    assert code_of(other) != ResultCode.OK
    assert names_in(again.world) == ["r0", "r1", "r2"]


def test_bond_whose_holder_did_not_come_back_ends(kept: Journalled) -> None:
    kept.parts.bonds.alive.update({"gone", "there"})
    spawn(kept, "g", bond="gone")
    spawn(kept, "t", bond="there")
    turn(kept)
    kept.crash()
    again = Journalled(kept.folder)
    again.server.inbox.bonds.append(("there", True))

    again.server.turn_for(BOND_TIMEOUT_S - 0.5)
    assert names_in(again.world) == ["r0", "r1", "g", "t"]
    again.server.turn_for(1.0)

    assert names_in(again.world) == ["r0", "r1", "t"]


def test_server_ends_when_the_writer_has_ended(kept: Journalled) -> None:
    kept.disk.is_alive = False

    with pytest.raises(WriterEnded):
        turn(kept)
