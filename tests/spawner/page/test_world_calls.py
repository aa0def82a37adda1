"""WorldCalls: calls of services for visitors, the long ones on threads."""

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec
import pytest

from tests.integration.processes import eventually
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.result_messages import ServiceError, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import (
    RunToRequest,
    RunToResponse,
    SetSimulationStateRequest,
)
from zensim.proto.service_catalog import RUN_TO, SET_SIMULATION_STATE
from zensim.spawner.page.side_panel import WorldCall
from zensim.spawner.page.world_calls import LAST_CALLS_S, MAX_LONG_CALLS, WorldCalls


class StubNetwork:
    """Replies as a test says."""

    def __init__(self, reply: Callable[[], object]) -> None:
        self.reply = reply
        self.timeouts: list[float] = []

    def call(
        self,
        service: object,
        request: msgspec.Struct,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Any:  # noqa: ANN401  of any service
        del service, request, world, request_id
        self.timeouts.append(timeout_s)
        return self.reply()


class Answers:
    """What came of calls."""

    def __init__(self) -> None:
        self.replies: list[object] = []
        self.errors: list[str] = []
        self.threads: set[int] = set()

    def take_reply(self, reply: object) -> None:
        self.replies.append(reply)
        self.threads.add(threading.get_ident())

    def wait(self, calls: WorldCalls, count: int) -> None:
        """Settle calls until there are so many replies."""

        def look() -> bool:
            calls.settle()
            return len(self.replies) >= count

        eventually(look, 10.0, f"{count} replies")

    def call(self, timeout_s: float = 0.0) -> WorldCall:
        return WorldCall(RUN_TO, RunToRequest(), self.take_reply, self.errors.append, timeout_s)


def raise_error(error: Exception) -> object:
    raise error


def test_a_short_call_is_answered_at_once() -> None:
    network, answers = StubNetwork(RunToResponse), Answers()

    WorldCalls(network, "w").make(answers.call())

    assert answers.replies == [RunToResponse()]
    assert network.timeouts[0] < 1.0


def test_a_long_call_is_answered_in_the_thread_that_settles() -> None:
    network, answers = StubNetwork(RunToResponse), Answers()
    calls = WorldCalls(network, "w")

    calls.make(answers.call(60.0))
    answers.wait(calls, 1)

    assert network.timeouts == [60.0]
    assert answers.threads == {threading.get_ident()}


def test_refusals_and_failures_are_told_with_their_reason() -> None:
    refusal = ServiceError("run_to", 4, "INCORRECT_STATE", "not paused")
    for error in (refusal, NoServer("no server"), TimeoutError("late")):
        answers = Answers()
        network = StubNetwork(partial(raise_error, error))
        WorldCalls(network, "w").make(answers.call())

        assert answers.errors == [str(error)]


def test_a_state_that_is_there_already_is_no_refusal() -> None:
    code = SetSimulationStateCode.ALREADY_IN_TARGET_STATE
    error = ServiceError("set_simulation_state", code, code.name, "paused already")
    errors: list[str] = []
    call = WorldCall(SET_SIMULATION_STATE, SetSimulationStateRequest(), on_error=errors.append)

    WorldCalls(StubNetwork(lambda: raise_error(error)), "w").make(call)

    assert errors == []


def test_the_same_code_of_another_service_is_a_refusal() -> None:
    error = ServiceError("spawn_entity", 101, "NAME_NOT_UNIQUE", "r1 is taken")
    answers = Answers()

    WorldCalls(StubNetwork(lambda: raise_error(error)), "w").make(answers.call())

    assert answers.errors == [str(error)]


def test_a_long_call_that_ends_by_a_defect_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Answers()
    defects: list[object] = []
    monkeypatch.setattr(threading, "excepthook", defects.append)
    calls = WorldCalls(StubNetwork(lambda: raise_error(KeyError("defect"))), "w")

    def look() -> bool:
        calls.settle()
        return bool(answers.errors and defects)

    calls.make(answers.call(60.0))
    eventually(look, 10.0, "an error")

    assert answers.errors == ["internal error"]


def test_the_last_calls_are_made_before_their_return() -> None:
    network, answers = StubNetwork(RunToResponse), Answers()

    WorldCalls(network, "w").make_last(answers.call(60.0) for _ in range(3))

    assert network.timeouts == [LAST_CALLS_S] * 3


def test_last_calls_without_a_reply_are_not_awaited_for_long() -> None:
    gate, answers = threading.Event(), Answers()
    network = StubNetwork(lambda: RunToResponse() if gate.wait(30.0) else None)

    WorldCalls(network, "w").make_last(answers.call() for _ in range(2 * MAX_LONG_CALLS))

    gate.set()
    assert len(network.timeouts) == MAX_LONG_CALLS


def test_more_long_calls_than_the_limit_are_refused_until_one_is_over() -> None:
    gate, answers = threading.Event(), Answers()
    network = StubNetwork(lambda: RunToResponse() if gate.wait(30.0) else None)
    calls = WorldCalls(network, "w")

    for _ in range(MAX_LONG_CALLS + 1):
        calls.make(answers.call(60.0))
    assert len(answers.errors) == 1
    gate.set()
    answers.wait(calls, MAX_LONG_CALLS)
    calls.make(answers.call(60.0))

    assert len(answers.errors) == 1
