"""An installation in separate processes: router, server and agents."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import psutil

from benchmarks.fleet_server import PATIENCE_S
from benchmarks.machine import used_s
from tests.integration.processes import connected, free_endpoint, running
from zensim.proto.bus.bus_session import Bus
from zensim.spawner.client.sim_client import SimClient

CALL_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class Installation:
    """Running processes by role."""

    bus: Bus
    client: SimClient
    pids: Mapping[str, tuple[int, ...]]

    def used_s(self) -> dict[str, float]:
        """Get the accumulated CPU time of each group."""
        return {group: sum(used_s(pid) for pid in pids) for group, pids in self.pids.items()}


@contextmanager
def run_installation(
    serve: Sequence[str], agents: Sequence[Sequence[str]], *, has_router: bool = True
) -> Iterator[Installation]:
    """Run a server without robots, and agents with these arguments.

    The router is a process of its own, or that of the server.
    """
    endpoint = free_endpoint()
    with ExitStack() as stack:
        routers = (
            [stack.enter_context(running("router", "--listen", endpoint))] if has_router else []
        )
        how = "--connect" if has_router else "--listen"
        server = stack.enter_context(running("serve", how, endpoint, *serve))
        bus = stack.enter_context(connected(endpoint, (*routers, server)[0]))
        client = SimClient(bus, timeout_s=CALL_TIMEOUT_S)
        client.wait_for_server(PATIENCE_S)
        agents_started = [
            stack.enter_context(running("agent", *words, "--connect", endpoint, "--quiet"))
            for words in agents
        ]
        children = psutil.Process(server.pid).children(recursive=True)
        pids = {
            **({"router": (routers[0].pid,)} if routers else {}),
            "server": (server.pid, *(child.pid for child in children)),
            "agents": tuple(agent.pid for agent in agents_started),
        }
        yield Installation(bus, client, pids)
