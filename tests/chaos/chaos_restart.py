"""Restarts of large worlds

A server with a journal of robots is killed with SIGKILL and started again: the wall time until it
listens, until a call of `info` has a reply, and until it lists the robots. Then it is killed while
it restores, and started again.
"""

import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks.figures import Figure, Limit
from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import START_S, connected, eventually, free_endpoint, running
from zensim.proto.bus.bus_errors import NoServer
from zensim.sim_server.journal.restore_progress import RESTORE_MARK_FILE
from zensim.spawner.client.sim_client import SimClient

ROBOTS, ROBOTS_WHEN_SHORT = (200, 700, 2000), (160,)
"""From 150 robots on there are several cells, and worker processes."""
STARTS, STARTS_WHEN_SHORT = 5, 1
MOST_S = {700: 3.0, 2000: 6.0}
MOST_SILENT_S = 0.5
POLL_S, CONNECT_S = 0.001, 0.5


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill and restart servers with some numbers of robots."""
    starts = STARTS_WHEN_SHORT if is_short else STARTS
    for count in ROBOTS_WHEN_SHORT if is_short else ROBOTS:
        with tempfile.TemporaryDirectory() as folder:
            yield from _restart(Path(folder), count, starts)


def _restart(folder: Path, count: int, starts: int) -> Iterator[Figure]:
    endpoint = free_endpoint()
    with serving_with_journal(folder, endpoint) as server:
        layout = ("--robots", str(count), "--layout", "grid", "--spacing", "2")
        done = server.zensim("fleet", "box_bot", *layout)
        assert done.returncode == 0, done.stderr
        kill_hard(server)
    found = [_start(folder, endpoint) for _ in range(starts)]
    _kill_while_restoring(folder, endpoint)
    after = _start(folder, endpoint)
    most_s = MOST_S.get(count, min(MOST_S.values()))
    yield Figure(
        what=f"{count} robots: start to the list of robots",
        unit="s",
        samples=tuple(one.listed_s for one in found),
        limit=Limit("max", "<=", most_s, is_timed=True),
    )
    yield Figure(
        what=f"{count} robots: listening to the first reply",
        unit="s",
        samples=tuple(one.replied_s - one.listening_s for one in found),
        limit=Limit("max", "<=", MOST_SILENT_S, is_timed=True),
    )
    yield Figure(
        what=f"{count} robots: start to their list after a kill while restoring",
        unit="s",
        samples=(after.listed_s,),
    )
    yield Figure(
        what=f"{count} robots: missing after a start",
        unit="",
        samples=tuple(float(count - one.restored) for one in (*found, after)),
        limit=Limit("max", "<=", 0.0),
    )


class Start(NamedTuple):
    """When a server listened, replied to `info` and listed robots [s], and how many."""

    listening_s: float
    replied_s: float
    listed_s: float
    restored: int


def _start(folder: Path, endpoint: str) -> Start:
    """Start and kill a server."""
    begin_s = time.monotonic()
    with running("serve", "--listen", endpoint, "--journal", str(folder)) as process:
        eventually(lambda: _accepts(endpoint), START_S, "listening")
        listening_s = time.monotonic() - begin_s
        with connected(endpoint, process) as bus:
            client = SimClient(bus)
            eventually(lambda: _replies(client), START_S, "a reply")
            replied_s = time.monotonic() - begin_s
            client.wait_for_server(START_S)
            names = client.entities()
            listed_s = time.monotonic() - begin_s
        process.kill()
        process.wait()
    return Start(listening_s, replied_s, listed_s, len(names))


def _replies(client: SimClient) -> bool:
    try:
        client.info()
    except (NoServer, TimeoutError):
        return False
    return True


def _accepts(endpoint: str) -> bool:
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    try:
        with socket.create_connection((host, int(port)), CONNECT_S):
            return True
    except OSError:
        return False


def _kill_while_restoring(folder: Path, endpoint: str) -> None:
    with running("serve", "--listen", endpoint, "--journal", str(folder)) as process:
        while not (folder / RESTORE_MARK_FILE).exists():
            assert process.poll() is None, "the server ended before it restored"
            time.sleep(POLL_S)
        process.kill()
        process.wait()
