"""Processes of the peers, and networks of zensim for them."""

import json
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.integration.processes import (
    START_S,
    Server,
    connected,
    end,
    eventually,
    free_endpoint,
    read_json_line,
    running,
    serving,
    zensim,
)
from tests.interop.peer_build import build_peers, build_router, has_router
from zensim.proto.parent_death import PARENT_PID_VARIABLE
from zensim.spawner.client.sim_client import SimClient

JAZZY, HUMBLE = "jazzy", "humble"
SERVE, ZENOHD, HIROZ = "zensim serve", "zenohd", "router of hiroz"
"""What routes between the peers and zensim."""
MARGIN_S = 60.0
"""Time of a program beyond what it is told to wait, because others may occupy the cores."""


def list_routers(*, is_short: bool) -> tuple[str, ...]:
    """List the routers to measure: the server, and zenohd or, without a build of it, hiroz."""
    if is_short:
        return (SERVE,)
    return (SERVE, ZENOHD if has_router() else HIROZ)


@dataclass(frozen=True)
class PeerNetwork:
    """A router, and the build of the peers that connect to it."""

    endpoint: str
    distro: str

    def run(self, *arguments: str, within_s: float = START_S) -> dict[str, Any]:
        """Run a peer, and return the last object that it prints."""
        with self.running(*arguments) as process:
            return self.read_last(process, within_s)

    def read_last(self, process: "subprocess.Popen[str]", within_s: float) -> dict[str, Any]:
        """Wait for the end of a peer, and return the last object that it prints."""
        printed, errors = process.communicate(timeout=within_s + MARGIN_S)
        lines = printed.splitlines()
        assert process.returncode == 0, f"{process.args!r}: {errors[-2000:]}"
        assert lines, f"{process.args!r} printed nothing: {errors[-2000:]}"
        found: dict[str, Any] = json.loads(lines[-1])
        return found

    @contextmanager
    def running(self, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
        """Run a peer until the block ends."""
        network = ("--connect", self.endpoint)
        with running_program(str(build_peers(self.distro)), *network, *arguments) as process:
            yield process


@dataclass(frozen=True)
class Stage(PeerNetwork):
    """A network with a zensim server."""

    server: Server
    options: Sequence[str]
    """Of agents."""

    def agents(self, *arguments: str) -> "AbstractContextManager[subprocess.Popen[str]]":
        """Make a context that runs `zensim agent`."""
        return running("agent", *arguments, "--connect", self.endpoint, "--quiet", *self.options)

    def spawn(self, robots: int) -> list[str]:
        """Spawn box_bot0 and so on; return their names."""
        count = ("--robots", str(robots), "--spacing", "2")
        done = zensim("fleet", "box_bot", *count, "--connect", self.endpoint, timeout_s=300.0)
        assert done.returncode == 0, done.stderr
        return [f"box_bot{number}" for number in range(robots)]

    def wait_until_driven(self, robots: int) -> None:
        """Wait until agents drive that many robots."""
        eventually(lambda: self.server.client.info().claimed >= robots, START_S, "claiming")


@contextmanager
def running_program(*command: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a program until the block ends."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )
    try:
        yield process
    finally:
        end(process)


@contextmanager
def stage(
    router: str = SERVE, *, distro: str = JAZZY, options: Sequence[str] = ()
) -> Iterator[Stage]:
    """Run a server, behind the router that is asked for."""
    ros = ("--ros-distro", distro) if distro == HUMBLE else ()
    with ExitStack() as stack:
        if router == SERVE:
            server = stack.enter_context(serving(*ros, *options))
            yield Stage(server.endpoint, distro, server, ros)
            return
        endpoint = free_endpoint()
        stack.enter_context(running_router(router, endpoint))
        bus = stack.enter_context(connected(endpoint))
        process = stack.enter_context(running("serve", "--connect", endpoint, *ros, *options))
        client = SimClient(bus, timeout_s=START_S)
        client.wait_for_server(START_S)
        yield Stage(endpoint, distro, Server(process, endpoint, bus, client), ros)


@contextmanager
def running_router(router: str, endpoint: str) -> Iterator[None]:
    """Run a router with the settings of rmw_zenohd."""
    own = (str(build_peers(JAZZY)), "router", "--listen", endpoint)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        if router == ZENOHD:
            printed = subprocess.run(
                [*own, "--settings"], capture_output=True, text=True, check=True
            )
            settings = Path(folder) / "router.json5"
            settings.write_text(printed.stdout, encoding="utf-8")
            stack.enter_context(running_program(str(build_router()), "--config", str(settings)))
        else:
            wait_until_ready(stack.enter_context(running_program(*own)))
        yield


def wait_until_ready(process: "subprocess.Popen[str]") -> None:
    """Wait for the first line of a peer."""
    assert read_json_line(process)["ready"]
