"""What the API says when the server stops, ends or is cut off, and when a process forks."""

import math
import multiprocessing
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from multiprocessing.connection import Connection

import psutil
import pytest

import zensim
from tests.integration.processes import START_S, eventually, free_endpoint
from tests.tcp_relay import TcpRelay
from zensim.api.world_session import check_protocol
from zensim.proto.child_process import close_pipes, make_module_command, start_process
from zensim.proto.messages.telemetry_messages import PROTOCOL, Info

SLACK_S = 6.0
"""Of wall times on a machine with other work; calls without a timeout wait longer."""
CUT_OFF = ("timeout", "connection_lost")
"""Slugs of a session whose server does not answer."""
RETURN_S = 2.5 + SLACK_S
"""Within which a world returns to its mode after its client has gone."""


@pytest.fixture
def own() -> Iterator[zensim.Sim]:
    """A server that a test may end."""
    with zensim.launch(timeout_s=120.0) as sim:
        yield sim


def server_process() -> psutil.Process:
    """Find the server that this process has started last; others may serve other tests."""
    running = [one for one in psutil.Process().children() if one.status() != psutil.STATUS_ZOMBIE]
    return max((one for one in running if "serve" in one.cmdline()), key=psutil.Process.create_time)


def test_killed_server_is_lost_soon(own: zensim.Sim) -> None:
    server_process().kill()

    began_s = time.monotonic()
    with pytest.raises(zensim.ConnectionLost):
        own.run_for(1.0, timeout_s=2.0)

    assert time.monotonic() - began_s < 2.0 + SLACK_S
    assert eventually(lambda: not own.is_connected, 5.0)


def test_stopped_server_keeps_the_timeout(own: zensim.Sim) -> None:
    server = server_process()
    server.send_signal(signal.SIGSTOP)
    try:
        began_s = time.monotonic()
        with pytest.raises(zensim.Error) as caught:
            own.step(timeout_s=1.0)
        waited_s = time.monotonic() - began_s
    finally:
        server.send_signal(signal.SIGCONT)

    assert waited_s < 1.0 + SLACK_S
    assert caught.value.slug in ("timeout", "connection_lost")


def test_value_is_refused_when_the_server_is_silent(own: zensim.Sim) -> None:
    robot = own.spawn("box_bot", name="r1")
    server = server_process()
    server.send_signal(signal.SIGSTOP)
    try:

        def is_lost() -> bool:
            try:
                _ = robot.pose
            except zensim.ConnectionLost:
                return True
            return False

        eventually(is_lost, 6.0)
    finally:
        server.send_signal(signal.SIGCONT)


def find_slug(call: Callable[[], object]) -> str:
    """Find the slug of the error that a call raises; empty without one."""
    try:
        call()
    except zensim.Error as error:
        return error.slug
    return ""


def use_in_child(sim: zensim.Sim, out: Connection) -> None:
    """Try what a forked child must not do."""
    out.send([find_slug(one) for one in (lambda: sim.time, sim.step, lambda: sim.run_for(0.1))])


def test_forked_child_is_refused(sim: zensim.Sim) -> None:
    receive, send = multiprocessing.Pipe(duplex=False)
    child_id = os.fork()
    if not child_id:
        use_in_child(sim, send)
        os._exit(0)
    try:
        assert receive.poll(20.0), "the child hangs"
        assert receive.recv() == ["forked"] * 3
    finally:
        os.kill(child_id, signal.SIGKILL)
        os.waitpid(child_id, 0)


def test_slow_callback_drops_and_does_not_delay() -> None:
    with zensim.launch(rtf=1, timeout_s=120.0) as sim:
        robot = sim.spawn("box_bot", name="r1")
        called: list[object] = []
        is_over = threading.Event()

        @robot.on("odom")
        def be_slow(odom: object) -> None:
            called.append(odom)
            is_over.wait(1.0)

        began = sim.time
        eventually(lambda: be_slow.dropped > 0, 10.0)
        eventually(lambda: sim.time > began + 1.0, 10.0)
        is_over.set()
        be_slow.cancel()

    assert called


@pytest.mark.parametrize(
    "call",
    [
        lambda sim: sim.run_for(math.nan),
        lambda sim: sim.run_for(-1.0),
        lambda sim: sim.step(0),
        lambda sim: sim.run_to(-1.0),
        lambda sim: sim.cast_rays([[0.0, 0.0]], [[1.0, 0.0]]),
        lambda sim: sim.cast_rays([[0.0, 0.0, math.nan]], [[1.0, 0.0, 0.0]]),
        lambda sim: sim.spawn("box_bot", x=math.inf),
        lambda sim: sim.spawn("box_bot", name="no name"),
        lambda sim: sim.spawn_fleet("box_bot", poses=[[0.0]]),
        lambda sim: sim.spawn_fleet("box_bot", count=-1),
        lambda sim: list(sim.steps(seconds=1.0, rate=33.0)),
        lambda sim: sim.spawn("box_bot", name="f").follow([(0.0, 0.0, 0.0)]),
    ],
)
def test_wrong_argument_is_invalid(sim: zensim.Sim, call: Callable[[zensim.Sim], object]) -> None:
    before = sim.time

    with pytest.raises(zensim.Invalid):
        call(sim)

    assert sim.time == before


def test_unknown_keyword_is_a_type_error(sim: zensim.Sim) -> None:
    with pytest.raises(TypeError):
        sim.spawn("box_bot", names="r1")  # type: ignore[call-arg]


def test_server_of_another_protocol_is_refused_with_both_numbers() -> None:
    with pytest.raises(zensim.Unsupported) as caught:
        check_protocol(Info(version="9.9", protocol=PROTOCOL + 1))

    assert caught.value.slug == "wrong_protocol"
    assert str(PROTOCOL + 1) in caught.value.message
    check_protocol(Info(protocol=PROTOCOL))


def test_client_goes_on_with_a_server_that_was_killed_and_started_again() -> None:
    endpoint = free_endpoint()
    with start_server(endpoint) as first, zensim.connect(endpoint, timeout_s=START_S) as sim:
        sim.run_for(0.1)
        first.kill()
        first.wait()
        with pytest.raises(zensim.ConnectionLost):
            sim.run_for(0.1, timeout_s=2.0)
        with start_server(endpoint):
            began_s = time.monotonic()
            eventually(lambda: find_slug(lambda: sim.run_for(0.1)) == "", START_S)
            assert sim.time == pytest.approx(0.1, abs=0.01)
            assert sim.worlds()
            assert time.monotonic() - began_s < START_S


def test_client_that_is_cut_off_gets_an_error_in_time_and_goes_on_after_that() -> None:
    with zensim.launch(rtf=1, timeout_s=120.0) as own:
        robot = own.spawn("box_bot", name="r1")
        with (
            closing(TcpRelay(int(own.endpoint.rpartition(":")[2]))) as relay,
            zensim.connect(f"tcp/127.0.0.1:{relay.port}", timeout_s=START_S) as sim,
        ):
            sim.robots["r1"].drive(0.3)
            sim.run_for(0.5)
            sim.step(24)
            eventually(lambda: own.is_paused, RETURN_S)

            relay.cut()
            began_s = time.monotonic()
            with pytest.raises(zensim.Error) as caught:
                sim.step(timeout_s=1.0)
            waited_s = time.monotonic() - began_s
            eventually(lambda: not own.is_paused, RETURN_S)
            eventually(lambda: robot.twist.speed < 0.01, RETURN_S)
            eventually(lambda: find_slug(lambda: sim.time) in CUT_OFF, RETURN_S)
            relay.mend()

            eventually(lambda: find_slug(sim.step) == "", START_S)
            assert sim.robots["r1"].exists

    assert waited_s < 1.0 + SLACK_S
    assert caught.value.slug in CUT_OFF


@contextmanager
def start_server(endpoint: str) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a paused server at an endpoint until the end of the block."""
    command = make_module_command(
        "zensim", "serve", "--listen", endpoint, "--paused", "--announce", "--ros-domain", "off"
    )
    server = start_process(command, stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None
        assert server.stdout.readline()
        yield server
    finally:
        server.kill()
        server.wait()
        close_pipes(server)
