"""The end of a server: accepted requests are finished, new changes are refused."""

from typing import Any

import msgspec
import pytest

from tests.fakes import MemoryCall
from tests.sim_server.fakes import ServerFixture, a_server, answer_of
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    SimulateStepsRequest,
    SimulateStepsResponse,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, SpawnEntityOrder
from zensim.proto.messages.telemetry_messages import Info, InfoRequest
from zensim.proto.service_catalog import DELETE_ENTITY, SPAWN_ENTITY, STEP_SIMULATION, Service
from zensim.sim_server.runtime.loop import MAX_DRAIN_NS

FOREVER = 1_000_000


def start_steps(server: ServerFixture, steps: int) -> MemoryCall:
    server.world.clock.pause()
    call = server.request("simulate_steps", SimulateStepsRequest(steps=steps))
    server.loop.turn()
    return call


def never() -> bool:
    return False


def test_accepted_request_is_finished_before_the_end() -> None:
    server = a_server("r1")
    call = start_steps(server, 50)

    server.loop.drain(never)

    response = answer_of(call, SimulateStepsResponse)
    assert isinstance(response, SimulateStepsResponse)
    assert response.result.result == ResultCode.OK
    assert server.world.clock.steps >= 50
    assert server.loop.status.check_ready().fault != ""


@pytest.mark.parametrize(
    ("service", "change"),
    [
        (SPAWN_ENTITY, SpawnEntityOrder(name="r2")),
        (DELETE_ENTITY, DeleteEntityRequest(entity="r1")),
        (STEP_SIMULATION, StepSimulationRequest(steps=1)),
    ],
    ids=lambda one: getattr(one, "name", ""),
)
def test_changes_are_refused_at_the_end(service: Service[Any, Any], change: msgspec.Struct) -> None:
    server = a_server("r1")
    start_steps(server, 50)
    call = server.request(service.name, change)

    server.loop.drain(never)

    result = getattr(answer_of(call, service.response), "result", Result())
    assert result.error_message.startswith("server.ends: ")
    assert len(server.world.entities) == 1


def test_questions_are_answered_at_the_end() -> None:
    server = a_server("r1")
    start_steps(server, 50)
    call = server.request("info", InfoRequest())

    server.loop.drain(never)

    assert msgspec.to_builtins(answer_of(call, Info))["entities"] == 1


def test_end_waits_for_a_limited_time() -> None:
    server = a_server("r1", cost_ns=1_000_000)
    start_steps(server, FOREVER)
    began_ns = server.wall.ns

    server.loop.drain(never)

    assert MAX_DRAIN_NS <= server.wall.ns - began_ns < MAX_DRAIN_NS * 1.1


def test_second_signal_ends_at_once() -> None:
    server = a_server("r1", cost_ns=1_000_000)
    start_steps(server, FOREVER)
    began_ns = server.wall.ns

    server.loop.drain(lambda: True)

    assert server.wall.ns - began_ns < 10_000_000
