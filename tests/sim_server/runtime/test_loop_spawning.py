"""Loop: spawns that wait for their description, and robots that hang on a bond."""

import pytest

from tests.fakes import MemoryCall
from tests.sim_server.fakes import InlineParser, ServerFixture, a_server, answer_of, names_in
from tests.sim_server.orders import an_order
from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import SpawnEntityReport
from zensim.proto.messages.telemetry_messages import InfoRequest


def a_slow_server(*names: str) -> ServerFixture:
    """A flat-out loop whose descriptions take a while."""
    server = a_server(*names, factor=0.0)
    descriptions_of(server).is_slow = True
    return server


def descriptions_of(server: ServerFixture) -> InlineParser:
    assert isinstance(server.parts.descriptions.provider, InlineParser)
    return server.parts.descriptions.provider


def ask_to_spawn(
    server: ServerFixture, name: str, *, bond: str = "", request_id: bytes = b""
) -> MemoryCall:
    x = 5.0 + 5.0 * len(server.inbox.calls)
    call = server.ask("spawn_entity", an_order(name, place=(x, 0.0, 0.06), bond=bond))
    call.request_id = request_id
    return call


def code_of(call: MemoryCall) -> int:
    report = answer_of(call, SpawnEntityReport)
    assert isinstance(report, SpawnEntityReport)
    return report.result.result


def test_loop_spawns_at_once_when_the_description_is_known() -> None:
    server = a_server(factor=0.0)
    call = ask_to_spawn(server, "r1")

    server.loop.turn()

    assert code_of(call) == ResultCode.OK
    assert names_in(server.world) == ["r1"]


def test_loop_goes_on_while_a_description_is_read() -> None:
    server = a_slow_server()
    spawn, info = ask_to_spawn(server, "r1"), server.ask("info", InfoRequest())

    for _ in range(5):
        server.loop.turn()

    assert (spawn.is_over, info.is_over) == (False, True)
    assert server.world.clock.steps == 5
    assert names_in(server.world) == []


def test_loop_spawns_in_the_order_of_asking_when_descriptions_are_read() -> None:
    server = a_slow_server()
    calls = [ask_to_spawn(server, name) for name in ("r2", "r0", "r1")]
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert names_in(server.world) == ["r2", "r0", "r1"]
    assert [code_of(call) for call in calls] == [ResultCode.OK] * 3


def test_loop_refuses_the_second_of_two_that_waited_under_one_name() -> None:
    server = a_slow_server()
    first, second = ask_to_spawn(server, "r1"), ask_to_spawn(server, "r1")
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert (code_of(first), code_of(second)) == (ResultCode.OK, SpawnCode.NAME_NOT_UNIQUE)


def test_loop_answers_a_retry_in_place_of_a_spawn_that_waits() -> None:
    server = a_slow_server()
    first = ask_to_spawn(server, "r1", request_id=b"same")
    server.loop.turn()
    retry = ask_to_spawn(server, "r1", request_id=b"same")
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert code_of(retry) == ResultCode.OK
    assert not first.is_over
    assert names_in(server.world) == ["r1"]


@pytest.mark.parametrize("turns", [0, 1, 5])
def test_loop_takes_a_bonded_robot_out_in_the_turn_that_its_bond_goes(turns: int) -> None:
    server = a_server("free", factor=0.0)
    server.inbox.bonds.append(("b1", True))
    call = ask_to_spawn(server, "r1", bond="b1")
    server.loop.turn()
    before = names_in(server.world)
    for _ in range(turns):
        server.loop.turn()

    server.inbox.bonds.append(("b1", False))
    server.loop.turn()

    assert (code_of(call), before) == (ResultCode.OK, ["free", "r1"])
    assert names_in(server.world) == ["free"]


def test_loop_refuses_to_spawn_on_a_bond_that_is_not_there() -> None:
    server = a_server(factor=0.0)
    call = ask_to_spawn(server, "r1", bond="b1")

    server.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE
    assert names_in(server.world) == []


def test_loop_refuses_to_spawn_on_a_bond_that_went_while_it_waited() -> None:
    server = a_slow_server()
    server.inbox.bonds.append(("b1", True))
    call = ask_to_spawn(server, "r1", bond="b1")
    server.loop.turn()

    server.inbox.bonds.append(("b1", False))
    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE
    assert names_in(server.world) == []
