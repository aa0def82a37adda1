"""zensim processes on ephemeral ports, each ended by its process id."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TypeVar

import psutil
from typer.testing import CliRunner

from tests.contract.repository import ROOT
from tests.integration.fork_server import run_program, start_program
from zensim.deploy.cli import build
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, NoServer
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.parent_death import PARENT_PID_VARIABLE
from zensim.spawner.client.sim_client import SimClient

T = TypeVar("T")
POLL_S, MAX_POLL_S = 0.005, 0.05
"""First and last pause between calls: each costs the server what its start could use."""
POLL_SHARE = 0.1
"""Of the time waited until now."""
FORKED = ("agent", "sensors", "serve")
"""Programs that tests fork; benchmarks and others start them."""
TESTS_VARIABLE = "PYTEST_VERSION"
SHORT = ("delete", "fleet", "list", "play", "spawn")
START_S = 120.0
END_S = 60.0
"""Timeout after SIGTERM; benchmarks measure the actual time."""
LEAST_PATIENCE_S = 120.0
"""Minimum timeout, because other programs may occupy the cores."""
PORTS = range(10_000, 32_000)
"""Below those that the kernel gives to sockets without a port of their own, which may be any."""
PORTS_OF_WORKER = 1000


def eventually(call: Callable[[], T | None], within_s: float, what: str = "it") -> T:
    """Call a function until it returns neither None nor False; fail after a timeout."""
    within_s = max(within_s, LEAST_PATIENCE_S)
    began = time.monotonic()
    while True:
        result = call()
        if result is not None and result is not False:
            return result
        waited = time.monotonic() - began
        assert waited < within_s, f"{what} did not happen within {within_s:g} s"
        time.sleep(min(max(waited * POLL_SHARE, POLL_S), MAX_POLL_S))


def _first_port() -> int:
    """Choose where the ports of this process begin: runs begin anywhere, and workers in steps."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return os.getppid() * 997 + worker * PORTS_OF_WORKER


_next_ports: dict[int, Iterator[int]] = {}
"""By process id: a worker is a fork of the process that imports this module."""


def free_endpoint(protocol: str = "tcp", host: str = "127.0.0.1") -> str:
    """Find an unused endpoint, which no other process of this run of tests will choose."""
    ports = _next_ports.setdefault(os.getpid(), count(_first_port()))
    while True:
        port = PORTS[next(ports) % len(PORTS)]
        with socket.socket() as probe:
            try:
                probe.bind((host, port))
            except OSError:
                continue
        return f"{protocol}/{host}:{port}"


def command_line(arguments: Sequence[str], prefix: Sequence[str] = ()) -> list[str]:
    """Make the command line of `zensim ARGUMENTS`."""
    return [*prefix, sys.executable, "-m", "zensim", *arguments]


def zensim(
    *arguments: str, timeout_s: float = START_S, prefix: Sequence[str] = ()
) -> "subprocess.CompletedProcess[str]":
    """Run a command and wait for its exit."""
    if not prefix and TESTS_VARIABLE in os.environ:
        return run_program(arguments, timeout_s)
    return subprocess.run(
        command_line(arguments, prefix),
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def run_in_process(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run a command in this process; its unexpected exceptions are raised."""
    result = CliRunner().invoke(build(arguments[0]), arguments, prog_name="zensim")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return subprocess.CompletedProcess(
        arguments, result.exit_code, stdout=result.stdout, stderr=result.stderr
    )


def without_libraries(folder: Path, *libraries: str) -> tuple[str, ...]:
    """Make a command prefix under which libraries cannot be imported."""
    block = f"import sys\nsys.modules.update(dict.fromkeys({libraries!r}))\n"
    (folder / "sitecustomize.py").write_text(block)
    path = os.pathsep.join((str(folder), str(ROOT)))
    return ("env", f"PYTHONPATH={path}")


def _start(arguments: Sequence[str], prefix: Sequence[str]) -> "subprocess.Popen[str]":
    if not prefix and arguments[0] in FORKED and TESTS_VARIABLE in os.environ:
        return start_program(arguments)
    return subprocess.Popen(
        command_line(arguments, prefix),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )


@contextmanager
def running(*arguments: str, prefix: Sequence[str] = ()) -> Iterator["subprocess.Popen[str]"]:
    """Run a command in the background; end it and its descendants afterwards."""
    process = _start(arguments, prefix)
    try:
        yield process
    finally:
        end(process)


def end(process: "subprocess.Popen[str]") -> None:
    """End a process and its descendants."""
    family = [process.pid, *children(process.pid)]
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
    process.wait()
    for pid in family[1:]:
        if psutil.pid_exists(pid):
            kill(pid, signal.SIGKILL)
    for pipe in (process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()


def children(pid: int) -> list[int]:
    """List the process ids of all descendants."""
    try:
        return [child.pid for child in psutil.Process(pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def kill(pid: int, number: signal.Signals) -> None:
    """Send a signal; ignores processes that have exited."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return


def read_json_line(process: "subprocess.Popen[str]") -> dict[str, object]:
    """Read the next line of a process's output as JSON."""
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, f"no line came: {process.stderr.read() if process.stderr else ''}"
    found = json.loads(line)
    assert isinstance(found, dict)
    return found


@dataclass(frozen=True)
class Server:
    """A running server and a client of it."""

    process: "subprocess.Popen[str]"
    endpoint: str
    bus: Bus
    client: SimClient

    def zensim(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Run a command against this server; short ones run in this process."""
        run = run_in_process if arguments[0] in SHORT else zensim
        return run(*arguments, "--connect", self.endpoint)

    def steps(self) -> int:
        """Get the number of completed steps."""
        return self.client.info().steps


@contextmanager
def serving(*arguments: str, prefix: Sequence[str] = (), endpoint: str = "") -> Iterator[Server]:
    """Run a server until the block ends."""
    # An endpoint that a test gives may be of another host.
    insecure = ("--insecure",) if endpoint else ()
    endpoint = endpoint or free_endpoint()
    with (
        running("serve", "--listen", endpoint, *insecure, *arguments, prefix=prefix) as process,
        connected(endpoint, process) as bus,
    ):
        client = SimClient(bus, timeout_s=START_S)
        client.wait_for_server(START_S)
        yield Server(process, endpoint, bus, client)


@contextmanager
def connected(endpoint: str, process: "subprocess.Popen[str] | None" = None) -> Iterator[Bus]:
    """Connect to an endpoint as soon as a router listens on it."""

    def attempt() -> Bus | None:
        if process is not None:
            assert process.poll() is None, process.stderr.read() if process.stderr else ""
        try:
            return open_bus(BusConfig(connect=(endpoint,), open_timeout_s=0.5))
        except BusError:
            return None

    with eventually(attempt, START_S, f"joining {endpoint}") as bus:
        yield bus


@contextmanager
def running_up(*arguments: str) -> Iterator[tuple["subprocess.Popen[str]", dict[str, object], Bus]]:
    """Run `zensim up`; yield its process, what it says when it is ready, and a session."""
    endpoint = free_endpoint()
    with running("up", *arguments, "--json", "--listen", endpoint) as process:
        ready = read_json_line(process)
        with connected(endpoint, process) as bus:
            yield process, ready, bus


@contextmanager
def running_agents(
    server: Server, *names: str, options: Sequence[str] = ()
) -> Iterator[dict[str, "subprocess.Popen[str]"]]:
    """Run an agent for each entity; enter the block when all are claimed."""
    with ExitStack() as stack:
        agents = {
            name: stack.enter_context(
                running("agent", name, "--connect", server.endpoint, *options)
            )
            for name in names
        }
        wait_for_agents(server, names)
        yield agents


def wait_for_agents(server: Server, names: Sequence[str]) -> None:
    """Wait until each entity is claimed."""
    eventually(lambda: all(agent_of(server, name) for name in names), START_S, "claiming")


def agent_of(server: Server, name: str) -> str:
    """Get the agent of an entity; empty if there is none."""
    try:
        return server.client.entity_model(name).agent
    except NoServer:
        return ""
