"""Secured servers for measurements, each with a state folder of its own."""

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from benchmarks.ten_robots import SPACING_M, Fleet
from tests.integration.processes import (
    START_S,
    Server,
    read_json_line,
    running,
    wait_for_agents,
    zensim,
)
from tests.integration.robots import robot
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.endpoints import with_free_port
from zensim.proto.security.roles import User
from zensim.sim_server.security.secure_folder import (
    SecureFolder,
    SecureSettings,
    open_secure_folder,
    prepare_secure_folder,
)
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    from subprocess import Popen

WORLD = "default"


@contextmanager
def state_folder() -> Iterator[None]:
    """Keep certificates and users of servers in a temporary folder meanwhile."""
    before = os.environ.get("XDG_STATE_HOME")
    with tempfile.TemporaryDirectory() as state:
        os.environ["XDG_STATE_HOME"] = state
        try:
            yield
        finally:
            if before is None:
                del os.environ["XDG_STATE_HOME"]
            else:
                os.environ["XDG_STATE_HOME"] = before


@dataclass(frozen=True)
class Deployment:
    """A `zensim up`, and a session of an operator.

    Attributes:
        ready: What it printed when it was ready.
    """

    process: "Popen[str]"
    ready: Mapping[str, object]
    bus: Bus
    client: SimClient
    folder: SecureFolder | None
    """Folder of a secured server; None without security."""

    def token(self, user: str) -> str:
        """Make the join token of a user; of an open server, its endpoint."""
        if self.folder is None:
            return self.bus.endpoint
        return self.folder.make_token(self.folder.accounts()[user]).write()


@contextmanager
def deployed(robots: int, *, is_secure: bool) -> Iterator[Deployment]:
    """Run robots until the block ends."""
    endpoint = with_free_port(f"{'tls' if is_secure else 'tcp'}/127.0.0.1:0")
    words = make_up_words(robots, endpoint, is_secure=is_secure)
    with deployed_by(words, endpoint) as found:
        yield found


@contextmanager
def deployed_by(words: Sequence[str], endpoint: str) -> Iterator[Deployment]:
    """Run `zensim up` with these arguments until the block ends."""
    with running(*words) as process:
        ready = read_json_line(process)
        folder = open_secure_folder(WORLD) if "--secure" in words else None
        address = endpoint
        if folder is not None:
            address = folder.make_token(folder.accounts()["operator"]).write()
        with open_bus(BusConfig(connect=(address,))) as bus:
            yield Deployment(process, ready, bus, SimClient(bus, timeout_s=START_S), folder)


def make_up_words(robots: int, endpoint: str, *, is_secure: bool) -> tuple[str, ...]:
    """Make the arguments of `zensim` that start robots which stand."""
    return (
        *("up", "--robots", str(robots), "--agents", "pooled", "--layout", "grid"),
        *("--spacing", str(SPACING_M), "--behaviour", "none", "--no-viewer", "--json"),
        *("--listen", endpoint, *(("--secure",) if is_secure else ())),
    )


@contextmanager
def secured_fleet(count: int) -> Iterator[tuple[Fleet, SecureFolder]]:
    """Run a secured server, robots far apart, and an agent with a token for each."""
    endpoint = with_free_port("tls/127.0.0.1:0")
    names = [f"box_bot{i}" for i in range(count)]
    layout = ("--robots", str(count), "--layout", "grid", "--spacing", str(SPACING_M))
    with state_folder(), ExitStack() as stack:
        folder = prepare_secure_folder(SecureSettings(WORLD, 0, endpoint))
        accounts = folder.ensure(User(name, "agent", (name,)) for name in names)
        process = stack.enter_context(
            running("serve", "--secure", "--listen", endpoint, "--announce")
        )
        read_json_line(process)
        operator = folder.make_token(folder.accounts()["operator"]).write()
        bus = stack.enter_context(open_bus(BusConfig(connect=(operator,))))
        server = Server(process, operator, bus, SimClient(bus, timeout_s=START_S))
        server.client.wait_for_server(START_S)
        done = zensim("fleet", "box_bot", *layout, "--join", operator)
        if done.returncode:
            raise RuntimeError(f"no fleet was spawned: {done.stderr}")
        agents: list[int] = []
        for account in accounts:
            joined = ("--join", folder.write_token(account, endpoint))
            options = ("-q", "--cmd-vel-timeout", "0")
            agent = running("agent", *account.user.robots, *joined, *options)
            agents.append(stack.enter_context(agent).pid)
        wait_for_agents(server, names)
        yield Fleet(server, [robot(bus, name) for name in names], tuple(agents)), folder
