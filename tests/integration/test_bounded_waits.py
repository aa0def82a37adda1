"""Every public function with a timeout ends by it: without a server, and if one never replies."""

import inspect
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import zensim
from tests.integration.processes import Server, free_endpoint, kill, serving
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.public_names import list_public_names

TIMEOUT_S = 0.3
SLACK_S = 8.0
"""What a busy host may add; the limits that waits have without a timeout are longer."""
IN_A_BASE = "Simulation."
"""Methods of this class are called on those that derive from it."""
Call = Callable[[zensim.Sim, Path], object]


def takes_timeout(function: Callable[..., object]) -> bool:
    """Whether a function has `timeout_s`, or it is among its keyword arguments."""
    parameters = inspect.signature(function).parameters
    annotations = [
        str(one.annotation).strip("'\"").removeprefix("Unpack[").removesuffix("]")
        for one in parameters.values()
        if one.kind is one.VAR_KEYWORD
    ]
    scope = function.__globals__
    return "timeout_s" in parameters or any(
        "timeout_s" in getattr(scope.get(name), "__annotations__", ()) for name in annotations
    )


def list_functions() -> Iterator[tuple[str, Callable[..., object]]]:
    """List public functions, and methods of public classes, by qualified name."""
    for name in list_public_names():
        found = getattr(zensim, name)
        if inspect.isfunction(found):
            yield name, found
        elif inspect.isclass(found):
            for key, method in inspect.getmembers(found, inspect.isfunction):
                if key[0] != "_":
                    yield f"{name}.{key}", method


BOUNDED = {name for name, found in list_functions() if takes_timeout(found)}
OF_A_SERVER: Mapping[str, Call] = {
    "Sim.join_lockstep": lambda sim, _: join(sim),
    "Sim.record": lambda sim, folder: sim.record(folder / "a.mcap", timeout_s=TIMEOUT_S),
    "Sim.run_for": lambda sim, _: sim.run_for(1.0, timeout_s=TIMEOUT_S),
    "Sim.run_to": lambda sim, _: sim.run_to(1e6, timeout_s=TIMEOUT_S),
    "Sim.show": lambda sim, _: sim.show(timeout_s=TIMEOUT_S),
    "Sim.spawn": lambda sim, _: sim.spawn("box_bot", "late", timeout_s=TIMEOUT_S),
    "Sim.spawn_fleet": lambda sim, _: sim.spawn_fleet("box_bot", 2, timeout_s=TIMEOUT_S),
    "Sim.step": lambda sim, _: sim.step(timeout_s=TIMEOUT_S),
    "Sim.wait_until": lambda sim, _: sim.wait_until(lambda: False, 1e6, timeout_s=TIMEOUT_S),
    "Topic.read": lambda sim, _: sim.topic("model_states").read(timeout_s=TIMEOUT_S),
}
"""Methods that wait for a server, whose world is paused."""
OF_A_WORLD: Mapping[str, Callable[[zensim.World], object]] = {
    "World.run_for": lambda world: world.run_for(1e6, timeout_s=TIMEOUT_S),
    "World.run_to": lambda world: world.run_to(1e6, timeout_s=TIMEOUT_S),
    "World.step": lambda world: world.step(10**7, timeout_s=TIMEOUT_S),
    "World.wait_until": lambda world: world.wait_until(lambda: False, 1e6, timeout_s=TIMEOUT_S),
}
"""Methods that compute until they are over."""
AT_ONCE = {"World.record", "World.spawn", "World.spawn_fleet"}
"""Methods that wait for nothing: the world is in this process."""
AT_AN_ENDPOINT = {"connect", "servers", "launch"}


def join(sim: zensim.Sim) -> None:
    with sim.join_lockstep(timeout_s=TIMEOUT_S) as steps:
        next(steps)


GIVEN_UP = (zensim.Timeout, zensim.ConnectionLost, zensim.Unreachable)


def assert_ends_in_time(call: Callable[[], object]) -> None:
    """Check that a call ends by its timeout, with an error that says so."""
    began_s = time.monotonic()
    with pytest.raises(GIVEN_UP):
        call()
    assert time.monotonic() - began_s < TIMEOUT_S + SLACK_S


@contextmanager
def mute_peer() -> Iterator[Bus]:
    """Run a router that says it is a server, takes all queries, and replies to none."""
    with open_bus(BusConfig(mode="router", listen=(free_endpoint(),))) as bus:
        kept = bus.token(keys.alive_server("default")), bus.serve("**")
        yield bus
        del kept


@pytest.fixture(scope="module")
def paused() -> Iterator[Server]:
    with serving("--paused", "--engine", "mujoco") as server:
        yield server


def test_every_public_function_with_a_timeout_is_tried() -> None:
    tried = OF_A_SERVER.keys() | OF_A_WORLD.keys() | AT_AN_ENDPOINT | AT_ONCE

    assert {one for one in BOUNDED if not one.startswith(IN_A_BASE)} == tried


@pytest.mark.parametrize("name", OF_A_SERVER)
def test_call_ends_in_time_if_the_server_stops_to_reply(
    name: str, paused: Server, tmp_path: Path
) -> None:
    with zensim.connect(paused.endpoint) as sim:
        sim.topic("model_states")  # which reads what there is
        kill(paused.process.pid, signal.SIGSTOP)
        try:
            assert_ends_in_time(lambda: OF_A_SERVER[name](sim, tmp_path))
        finally:
            kill(paused.process.pid, signal.SIGCONT)


@pytest.mark.parametrize("name", OF_A_SERVER)
def test_call_ends_in_time_if_the_server_is_gone(name: str, tmp_path: Path) -> None:
    with serving("--paused", "--engine", "mujoco") as server:
        sim = zensim.connect(server.endpoint)
        sim.topic("model_states")  # which reads what there is
        server.process.kill()
        server.process.wait()
        with sim:
            assert_ends_in_time(lambda: OF_A_SERVER[name](sim, tmp_path))


@pytest.mark.parametrize("name", OF_A_WORLD)
def test_call_in_process_ends_in_time(name: str) -> None:
    with zensim.World(engine="mujoco") as world:
        assert_ends_in_time(lambda: OF_A_WORLD[name](world))


def call_at(endpoint: str) -> dict[str, Callable[[], Any]]:
    """Make the calls that name an endpoint."""
    return {
        "connect": lambda: zensim.connect(endpoint, timeout_s=TIMEOUT_S),
        "servers": lambda: zensim.servers(endpoint, timeout_s=TIMEOUT_S),
    }


def test_nothing_is_found_in_time_where_nothing_listens() -> None:
    calls, began_s = call_at(free_endpoint()), time.monotonic()

    assert_ends_in_time(calls["connect"])
    assert calls["servers"]() == ()
    assert time.monotonic() - began_s < 2 * (TIMEOUT_S + SLACK_S)


def test_peer_that_never_replies_is_given_up_in_time() -> None:
    with mute_peer() as bus:
        for call in call_at(bus.endpoint).values():
            assert_ends_in_time(call)


def test_start_that_takes_longer_is_given_up_in_time() -> None:
    assert_ends_in_time(lambda: zensim.launch(timeout_s=TIMEOUT_S))
