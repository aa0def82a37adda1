"""All changes are journaled before replies are sent, and undone if they cannot be written."""

import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryCall
from tests.models import a_state
from tests.sim_server.fakes import answer_of, names_in
from tests.sim_server.journal.journaled_server import DISK_FULL, JournaledServer, read_journal
from zensim.proto.messages.entity_messages import (
    GetEntitiesRequest,
    GetEntitiesResponse,
    SetEntityStateRequest,
)
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulateStepsRequest,
    SimulationState,
    State,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.journal import server_journal
from zensim.sim_server.journal.server_journal import (
    BOND_TIMEOUT_S,
    MOTION_PERIOD_S,
    WriterEnded,
    find_crashing,
)
from zensim.sim_server.journal.sqlite_store import DATABASE

RELEASED = sorted((Path(__file__).parent / "released").iterdir())


def harmless() -> None:
    pass


def crash() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def raising() -> None:
    raise RuntimeError("no harm")


@pytest.mark.parametrize(
    ("attempts", "expected"),
    [
        ([], []),
        ([harmless, raising, harmless], []),
        ([crash], [0]),
        ([harmless, crash, harmless, raising, crash], [1, 4]),
    ],
)
def test_attempts_that_crash_are_found(
    attempts: list[Callable[[], None]], expected: list[int]
) -> None:
    assert find_crashing(attempts) == expected


def test_attempt_that_crashes_once_is_not_reported(tmp_path: os.PathLike[str]) -> None:
    mark = os.path.join(tmp_path, "mark")  # noqa: PTH118

    def crash_once() -> None:
        if not os.path.exists(mark):  # noqa: PTH110
            os.close(os.open(mark, os.O_CREAT))
            crash()

    assert find_crashing([harmless, crash_once]) == []


def test_attempt_that_does_not_end_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_journal, "DEADLINE_S", 0.1)

    assert find_crashing([harmless, lambda: time.sleep(30.0)]) == [1]


def test_attempts_have_no_effect_in_this_process() -> None:
    seen: list[int] = []

    find_crashing([lambda: seen.append(1)])

    assert seen == []


def send(
    server: JournaledServer, service: str, request: msgspec.Struct, name: str = ""
) -> MemoryCall:
    call = server.server.request(service, request)
    call.request_id = name.encode()
    return call


def spawn(server: JournaledServer, name: str, request_id: str = "", bond: str = "") -> MemoryCall:
    order = SpawnEntityOrder(name, entity_resource=Resource("box_bot"), bond=bond)
    return send(server, "spawn_entity", order, request_id)


def result_code(call: MemoryCall) -> int:
    response = answer_of(call, SERVICES[call.name].response)
    return int(response.result.result)  # type: ignore[attr-defined]


def listed_names(call: MemoryCall) -> tuple[str, ...]:
    response = answer_of(call, GetEntitiesResponse)
    assert isinstance(response, GetEntitiesResponse)
    return response.entities


def turn(server: JournaledServer, times: int = 1) -> None:
    for _ in range(times):
        server.server.loop.turn()


@pytest.fixture
def server(tmp_path: Path) -> JournaledServer:
    server = JournaledServer(tmp_path, "r0", "r1")
    turn(server)
    return server


def test_reply_is_sent_when_its_changes_are_durable(server: JournaledServer) -> None:
    server.disk.is_slow = True
    calls = [spawn(server, "r2"), send(server, "get_entities", GetEntitiesRequest())]

    turn(server, 3)
    assert [call.answers for call in calls] == [[], []]

    server.disk.flush()
    turn(server)
    assert result_code(calls[0]) == ResultCode.OK
    assert listed_names(calls[1]) == ("r0", "r1", "r2")


def test_query_is_answered_at_once_when_nothing_has_changed(server: JournaledServer) -> None:
    server.disk.is_slow = True
    call = send(server, "get_entities", GetEntitiesRequest())

    turn(server)

    assert listed_names(call) == ("r0", "r1")


@pytest.mark.parametrize("how", ["request", "bond", "release"])
def test_delete_is_journaled_for_any_cause(server: JournaledServer, how: str) -> None:
    if how == "request":
        send(server, "delete_entity", DeleteEntityRequest("r0"))
    elif how == "bond":
        born_ns = server.world.entities.find("r0").born_ns
        server.parts.bonds.alive.add("b")
        server.parts.bonds.entities["b"] = [("r0", born_ns)]
        server.server.inbox.bonds.append(("b", False))
    else:
        server.parts.agents.alive.add("a")
        server.world.claim("a", ("r0",), "delete")
        server.server.inbox.agents.append(("a", False))
    turn(server)
    server.crash()

    assert [row.name for row in read_journal(server.folder).entities] == ["r1"]


def test_entity_with_a_reused_name_is_journaled_as_a_new_one(server: JournaledServer) -> None:
    send(server, "delete_entity", DeleteEntityRequest("r0"))
    spawn(server, "r0")
    turn(server)
    server.crash()

    contents = read_journal(server.folder)
    assert [row.name for row in contents.entities] == ["r1", "r0"]
    assert contents.models[contents.entities[1].model].name == "box_bot"


def test_models_and_texts_are_removed_with_their_last_entity(server: JournaledServer) -> None:
    spawn(server, "a")
    spawn(server, "b")
    turn(server)
    assert len(read_models(server)) == 2

    for name in ("a", "b", "r0"):
        send(server, "delete_entity", DeleteEntityRequest(name))
    turn(server)

    assert len(read_models(server)) == 1
    assert len(server.database.rows("text")) == 1


def read_models(server: JournaledServer) -> dict[str, bytes]:
    return server.database.rows("model")


def test_pose_that_was_set_is_durable_before_the_reply(server: JournaledServer) -> None:
    call = send(server, "set_entity_state", SetEntityStateRequest("r0", set_pose=True))
    turn(server)
    server.crash()

    assert result_code(call) == ResultCode.OK
    contents = read_journal(server.folder)
    assert contents.last_state(contents.entities[0])[0][:3].tolist() == [0.0, 0.0, 0.0]


def test_states_are_recorded_periodically(server: JournaledServer) -> None:
    server.server.turn_for(3.0)

    steps = [
        record.motion.steps
        for batch in server.disk.batches
        for record in batch
        if record.motion is not None
    ]
    gaps_s = np.diff(steps) * server.world.clock.step_ns * 1e-9
    assert len(steps) > 5
    assert gaps_s.max() <= MOTION_PERIOD_S + 0.06


def count_motions(server: JournaledServer) -> int:
    records = [record for batch in server.disk.batches for record in batch]
    return sum(record.motion is not None for record in records)


@pytest.mark.parametrize(("steps", "delay_s"), [(0, 0.0), (1, 0.04)])
def test_states_are_recorded_at_the_first_control_step_or_40_ms_late(
    server: JournaledServer, steps: int, delay_s: float
) -> None:
    server.world.clock.pause()
    server.world.clock.steps = steps
    server.server.wall.ns += 1_000_000_000
    server.tracker.poll()
    due_ns = server.server.wall.ns + round((MOTION_PERIOD_S + delay_s) * 1e9)
    server.world.place("r0", a_state((1.0, 0.0, 0.0)))

    counts = []
    for now_ns in (due_ns - 1, due_ns):
        server.server.wall.ns = now_ns
        server.tracker.poll()
        counts.append(count_motions(server))

    assert counts[1] == counts[0] + 1


def test_nothing_is_written_while_nothing_changes(server: JournaledServer) -> None:
    server.world.clock.pause()
    turn(server, 2)
    server.server.turn_for(2.0 * MOTION_PERIOD_S)
    written = len(server.disk.batches)

    server.server.turn_for(10.0)

    assert len(server.disk.batches) == written


def test_spawn_is_undone_when_the_disk_is_full(server: JournaledServer) -> None:
    server.disk.is_full = True
    refused, query = spawn(server, "r2", "1"), send(server, "get_entities", GetEntitiesRequest())

    turn(server, 3)

    assert result_code(refused) == ResultCode.OPERATION_FAILED
    assert DISK_FULL.encode() in refused.answers[0].payload
    assert listed_names(query) == ("r0", "r1")
    assert names_in(server.world) == ["r0", "r1"]


def test_delete_is_undone_when_the_disk_is_full(server: JournaledServer) -> None:
    before = server.world.state_of("r0").tolist()
    server.disk.is_full = True
    call = send(server, "delete_entity", DeleteEntityRequest("r0"))

    turn(server, 3)

    assert result_code(call) == ResultCode.OPERATION_FAILED
    assert sorted(names_in(server.world)) == ["r0", "r1"]
    assert server.world.state_of("r0").tolist() == before


def test_spawn_waits_for_a_successful_write_while_the_disk_is_full(server: JournaledServer) -> None:
    server.disk.is_full = True
    spawn(server, "r2")
    turn(server, 3)
    events = len(server.server.events())
    refused = spawn(server, "r3")
    turn(server, 3)
    server.disk.is_full = False
    accepted = spawn(server, "r4", "4")
    turn(server, 3)
    server.crash()

    assert result_code(refused) == ResultCode.OPERATION_FAILED
    assert ("spawned", "r3") not in server.server.events()[events:]
    assert result_code(accepted) == ResultCode.OK
    assert [row.name for row in read_journal(server.folder).entities] == ["r0", "r1", "r4"]


@pytest.mark.parametrize("is_full", [True, False], ids=["failing", "hanging"])
def test_server_that_ends_waits_for_no_disk_to_refuse_a_spawn_and_keeps_no_refusal(
    server: JournaledServer, *, is_full: bool
) -> None:
    server.disk.is_full = is_full
    spawn(server, "r2", "2")
    server.world.clock.pause()
    send(server, "simulate_steps", SimulateStepsRequest(steps=1_000_000))
    turn(server, 3)
    server.disk.is_slow = True
    refused, turns = spawn(server, "r3", "3"), iter([False] * 3)

    server.server.loop.drain(lambda: next(turns, True))

    answers = len(refused.answers)
    server.disk.is_full = False
    server.close()
    restarted = JournaledServer(server.folder)
    retry = spawn(restarted, "r3", "3")
    turn(restarted, 3)
    assert answers == 1
    assert b"server.ends: " in refused.answers[0].payload
    assert result_code(retry) == ResultCode.OK


@pytest.mark.parametrize("version", RELEASED, ids=lambda folder: folder.name)
def test_journal_of_each_released_version_opens_with_its_world(
    version: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "j"
    folder.mkdir()
    shutil.copy(version / DATABASE, folder / DATABASE)

    server = JournaledServer(folder)

    assert names_in(server.world) == ["box_bot0", "box_bot1"]
    assert server.refused == ()
    server.close()


def test_simulation_continues_while_the_disk_is_full(server: JournaledServer) -> None:
    server.disk.is_full = True
    before = server.world.clock.steps

    server.server.turn_for(2.0)
    query = send(server, "get_entities", GetEntitiesRequest())
    turn(server, 2)

    assert server.world.clock.steps > before
    assert listed_names(query) == ("r0", "r1")


def test_pause_is_effective_and_journaled_later_when_the_disk_is_full(
    server: JournaledServer,
) -> None:
    server.disk.is_full = True
    request = SetSimulationStateRequest(SimulationState(State.PAUSED))
    call = send(server, "set_simulation_state", request, "1")
    turn(server, 3)
    assert result_code(call) == ResultCode.OK

    server.disk.is_full = False
    server.server.turn_for(2.0 * MOTION_PERIOD_S)
    server.crash()

    assert read_journal(server.folder).clock.state == State.PAUSED


def test_bond_that_ended_while_the_disk_was_full_stays_ended(server: JournaledServer) -> None:
    server.parts.bonds.alive.add("b")
    spawn(server, "r2", bond="b")
    turn(server)
    server.disk.is_full = True
    server.server.inbox.bonds.append(("b", False))
    server.server.turn_for(2.0 * MOTION_PERIOD_S)
    assert names_in(server.world) == ["r0", "r1"]

    server.disk.is_full = False
    server.server.turn_for(2.0 * MOTION_PERIOD_S)
    server.crash()

    assert [row.name for row in read_journal(server.folder).entities] == ["r0", "r1"]


def test_repeated_request_gets_the_same_response_after_a_restart(server: JournaledServer) -> None:
    first = spawn(server, "r2", "abc")
    turn(server)
    server.crash()
    restarted = JournaledServer(server.folder)

    retry = spawn(restarted, "r2", "abc")
    other = spawn(restarted, "r2", "def")
    turn(restarted)

    assert retry.answers[0].payload == first.answers[0].payload
    assert result_code(other) != ResultCode.OK
    assert names_in(restarted.world) == ["r0", "r1", "r2"]


@pytest.mark.parametrize("step_s", [-7200.0, 7200.0, 1e8])
def test_repeated_request_gets_the_same_response_when_the_clock_was_set(
    tmp_path: Path, step_s: float
) -> None:
    server = JournaledServer(tmp_path, now_s=1e4)
    first = spawn(server, "r2", "abc")
    turn(server)
    server.crash()
    restarted = JournaledServer(server.folder, now_s=1e4 + step_s)

    retry = spawn(restarted, "r2", "abc")
    turn(restarted)

    assert retry.answers[0].payload == first.answers[0].payload
    assert names_in(restarted.world) == ["r2"]


def test_bond_that_is_not_renewed_after_a_restart_ends(server: JournaledServer) -> None:
    server.parts.bonds.alive.update({"lost", "renewed"})
    spawn(server, "g", bond="lost")
    spawn(server, "t", bond="renewed")
    turn(server)
    server.crash()
    restarted = JournaledServer(server.folder)
    restarted.server.inbox.bonds.append(("renewed", True))

    restarted.server.turn_for(BOND_TIMEOUT_S - 0.5)
    assert names_in(restarted.world) == ["r0", "r1", "g", "t"]
    restarted.server.turn_for(1.0)

    assert names_in(restarted.world) == ["r0", "r1", "t"]


def test_server_ends_when_the_writer_has_ended(server: JournaledServer) -> None:
    server.disk.is_alive = False

    with pytest.raises(WriterEnded):
        turn(server)
