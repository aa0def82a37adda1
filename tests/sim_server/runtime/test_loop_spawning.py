"""Loop: spawns that wait for their description, and robots that hang on a bond."""

import pytest

from tests.fakes import MemoryCall
from tests.sim_server.fakes import ReadHere, Stage, a_stage, answer_of, names_in
from tests.sim_server.orders import an_order
from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import SpawnEntityReport
from zensim.proto.messages.telemetry_messages import InfoRequest


def a_slow_stage(*names: str) -> Stage:
    """A flat-out loop whose descriptions take a while."""
    stage = a_stage(*names, factor=0.0)
    descriptions_of(stage).is_slow = True
    return stage


def descriptions_of(stage: Stage) -> ReadHere:
    assert isinstance(stage.context.descriptions, ReadHere)
    return stage.context.descriptions


def ask_to_spawn(stage: Stage, name: str, *, bond: str = "", request_id: bytes = b"") -> MemoryCall:
    x = 5.0 + 5.0 * len(stage.inbox.calls)
    call = stage.ask("spawn_entity", an_order(name, place=(x, 0.0, 0.06), bond=bond))
    call.request_id = request_id
    return call


def code_of(call: MemoryCall) -> int:
    report = answer_of(call, SpawnEntityReport)
    assert isinstance(report, SpawnEntityReport)
    return report.result.result


def test_loop_spawns_at_once_when_the_description_is_known() -> None:
    stage = a_stage(factor=0.0)
    call = ask_to_spawn(stage, "r1")

    stage.loop.turn()

    assert code_of(call) == ResultCode.OK
    assert names_in(stage.world) == ["r1"]


def test_loop_goes_on_while_a_description_is_read() -> None:
    stage = a_slow_stage()
    spawn, info = ask_to_spawn(stage, "r1"), stage.ask("info", InfoRequest())

    for _ in range(5):
        stage.loop.turn()

    assert (spawn.is_over, info.is_over) == (False, True)
    assert stage.world.steps == 5
    assert names_in(stage.world) == []


def test_loop_spawns_in_the_order_of_asking_when_descriptions_are_read() -> None:
    stage = a_slow_stage()
    calls = [ask_to_spawn(stage, name) for name in ("r2", "r0", "r1")]
    stage.loop.turn()

    descriptions_of(stage).is_slow = False
    stage.loop.turn()

    assert names_in(stage.world) == ["r2", "r0", "r1"]
    assert [code_of(call) for call in calls] == [ResultCode.OK] * 3


def test_loop_refuses_the_second_of_two_that_waited_under_one_name() -> None:
    stage = a_slow_stage()
    first, second = ask_to_spawn(stage, "r1"), ask_to_spawn(stage, "r1")
    stage.loop.turn()

    descriptions_of(stage).is_slow = False
    stage.loop.turn()

    assert (code_of(first), code_of(second)) == (ResultCode.OK, SpawnCode.NAME_NOT_UNIQUE)


def test_loop_answers_a_retry_in_place_of_a_spawn_that_waits() -> None:
    stage = a_slow_stage()
    first = ask_to_spawn(stage, "r1", request_id=b"same")
    stage.loop.turn()
    retry = ask_to_spawn(stage, "r1", request_id=b"same")
    stage.loop.turn()

    descriptions_of(stage).is_slow = False
    stage.loop.turn()

    assert code_of(retry) == ResultCode.OK
    assert not first.is_over
    assert names_in(stage.world) == ["r1"]


@pytest.mark.parametrize("turns", [0, 1, 5])
def test_loop_takes_a_bonded_robot_out_in_the_turn_that_its_bond_goes(turns: int) -> None:
    stage = a_stage("free", factor=0.0)
    stage.inbox.bonds.append(("b1", True))
    call = ask_to_spawn(stage, "r1", bond="b1")
    stage.loop.turn()
    before = names_in(stage.world)
    for _ in range(turns):
        stage.loop.turn()

    stage.inbox.bonds.append(("b1", False))
    stage.loop.turn()

    assert (code_of(call), before) == (ResultCode.OK, ["free", "r1"])
    assert names_in(stage.world) == ["free"]


def test_loop_refuses_to_spawn_on_a_bond_that_is_not_there() -> None:
    stage = a_stage(factor=0.0)
    call = ask_to_spawn(stage, "r1", bond="b1")

    stage.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE
    assert names_in(stage.world) == []


def test_loop_refuses_to_spawn_on_a_bond_that_went_while_it_waited() -> None:
    stage = a_slow_stage()
    stage.inbox.bonds.append(("b1", True))
    call = ask_to_spawn(stage, "r1", bond="b1")
    stage.loop.turn()

    stage.inbox.bonds.append(("b1", False))
    descriptions_of(stage).is_slow = False
    stage.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE
    assert names_in(stage.world) == []
