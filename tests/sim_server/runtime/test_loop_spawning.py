"""Loop: spawns that wait for parsing, and bonded robots."""

import io
import json
import logging

import pytest

from tests.fakes import MemoryCall
from tests.sim_server.fakes import (
    InlineParser,
    ServerFixture,
    TimedEngine,
    a_server,
    answer_of,
    names_in,
)
from tests.sim_server.orders import an_order
from zensim.proto.json_logs import CONTEXT, JsonFormatter
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import SpawnEntityReport
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.sim_server.physics.engine import FloatArray


def a_slow_server(*names: str) -> ServerFixture:
    """Make a flat-out server whose descriptions are not parsed yet."""
    server = a_server(*names, factor=0.0)
    descriptions_of(server).is_slow = True
    return server


def descriptions_of(server: ServerFixture) -> InlineParser:
    assert isinstance(server.parts.descriptions.provider, InlineParser)
    return server.parts.descriptions.provider


def request_spawn(
    server: ServerFixture, name: str, *, bond: str = "", request_id: bytes = b""
) -> MemoryCall:
    x = 5.0 + 5.0 * len(server.inbox.calls)
    call = server.request("spawn_entity", an_order(name, place=(x, 0.0, 0.06), bond=bond))
    call.request_id = request_id
    return call


def code_of(call: MemoryCall) -> int:
    report = answer_of(call, SpawnEntityReport)
    assert isinstance(report, SpawnEntityReport)
    return report.result.result


def test_loop_spawns_at_once_when_the_description_is_known() -> None:
    server = a_server(factor=0.0)
    call = request_spawn(server, "r1")

    server.loop.turn()

    assert code_of(call) == ResultCode.OK
    assert names_in(server.world) == ["r1"]


def test_loop_continues_while_a_description_is_parsed() -> None:
    server = a_slow_server()
    spawn, info = request_spawn(server, "r1"), server.request("info", InfoRequest())

    for _ in range(5):
        server.loop.turn()

    assert (spawn.is_over, info.is_over) == (False, True)
    assert server.world.clock.steps == 5
    assert names_in(server.world) == []


def count_clock_reads(server: ServerFixture, monkeypatch: pytest.MonkeyPatch) -> int:
    """Count the readings of the loop's CPU time in a turn."""
    reads = 0

    def read_used_ns() -> int:
        nonlocal reads
        reads += 1
        return 0

    budget = server.loop._budget  # noqa: SLF001  its clock is read by nothing else
    monkeypatch.setattr(budget, "_read_used_ns", read_used_ns)
    server.loop.turn()
    return reads


def test_spawns_that_wait_for_parsing_are_not_measured_in_each_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = a_slow_server()
    for name in ("r0", "r1", "r2"):
        request_spawn(server, name)
    server.loop.turn()

    assert count_clock_reads(server, monkeypatch) == 0


def test_loop_spawns_in_the_order_of_requests_when_descriptions_are_parsed() -> None:
    server = a_slow_server()
    calls = [request_spawn(server, name) for name in ("r2", "r0", "r1")]
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert names_in(server.world) == ["r2", "r0", "r1"]
    assert [code_of(call) for call in calls] == [ResultCode.OK] * 3


def test_loop_refuses_the_second_of_two_pending_spawns_of_one_name() -> None:
    server = a_slow_server()
    first, second = request_spawn(server, "r1"), request_spawn(server, "r1")
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert (code_of(first), code_of(second)) == (ResultCode.OK, SpawnCode.NAME_NOT_UNIQUE)


def test_loop_replies_to_a_retry_in_place_of_a_pending_spawn() -> None:
    server = a_slow_server()
    first = request_spawn(server, "r1", request_id=b"same")
    server.loop.turn()
    retry = request_spawn(server, "r1", request_id=b"same")
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert code_of(retry) == ResultCode.OK
    assert not first.is_over
    assert names_in(server.world) == ["r1"]


def test_deferred_spawn_is_finished_with_its_request_id_in_the_log(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server, add, log = a_slow_server(), TimedEngine.add, io.StringIO()
    handler = logging.StreamHandler(log)
    handler.setFormatter(JsonFormatter())
    logger = logging.getLogger("zensim.test")
    monkeypatch.setattr(logger, "handlers", [handler])

    def add_and_warn(engine: TimedEngine, model: Model, base: FloatArray) -> int:
        logger.warning("adding")
        return add(engine, model, base)

    monkeypatch.setattr(TimedEngine, "add", add_and_warn)
    call = request_spawn(server, "r1", request_id=b"spawn-1")
    server.loop.turn()

    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert code_of(call) == ResultCode.OK
    assert [json.loads(line)["request"] for line in log.getvalue().splitlines()] == ["spawn-1"]
    assert CONTEXT.request == b""


@pytest.mark.parametrize("turns", [0, 1, 5])
def test_loop_deletes_a_bonded_robot_in_the_turn_that_its_bond_ends(turns: int) -> None:
    server = a_server("free", factor=0.0)
    server.inbox.bonds.append(("b1", True))
    call = request_spawn(server, "r1", bond="b1")
    server.loop.turn()
    before = names_in(server.world)
    for _ in range(turns):
        server.loop.turn()

    server.inbox.bonds.append(("b1", False))
    server.loop.turn()

    assert (code_of(call), before) == (ResultCode.OK, ["free", "r1"])
    assert names_in(server.world) == ["free"]


def test_loop_refuses_to_spawn_on_an_unknown_bond() -> None:
    server = a_server(factor=0.0)
    call = request_spawn(server, "r1", bond="b1")

    server.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE
    assert names_in(server.world) == []


def test_loop_refuses_to_spawn_on_a_bond_that_ended_meanwhile() -> None:
    server = a_slow_server()
    server.inbox.bonds.append(("b1", True))
    call = request_spawn(server, "r1", bond="b1")
    server.loop.turn()

    server.inbox.bonds.append(("b1", False))
    descriptions_of(server).is_slow = False
    server.loop.turn()

    assert code_of(call) == ResultCode.INCORRECT_STATE
    assert names_in(server.world) == []
