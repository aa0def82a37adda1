"""Sessions that are held

Clients open sessions and keep them. A server that may open as many files as today's systems allow
holds a thousand, and serves others as before. A server that may open few admits as many sessions as
leave it 200 files: the next one is refused in one line, and the server spawns robots, takes files
and loads worlds. When the clients end, others are admitted, and the memory is given back.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256

import psutil

from benchmarks.figures import Figure, Limit
from tests.integration.processes import Server, end, eventually, serving
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.bus.session_files import find_max_sessions
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.world_messages import LoadWorldRequest
from zensim.proto.parent_death import PARENT_PID_VARIABLE
from zensim.proto.service_catalog import LOAD_WORLD

HELD, HELD_WHEN_SHORT = 1000, 30
FILES, FILES_WHEN_SHORT = 1024, 260
SETTLE_S, SETTLE_WHEN_SHORT_S = 10.0, 1.0
OWN_SESSIONS = 1
MEGABYTE = 1e6
ASSET = b"solid nothing\nendsolid nothing\n"


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Hold sessions at servers with many and with few files."""
    settle_s = SETTLE_WHEN_SHORT_S if is_short else SETTLE_S
    with serving() as server:
        yield from _hold_many(server, HELD_WHEN_SHORT if is_short else HELD, settle_s)
    files = FILES_WHEN_SHORT if is_short else FILES
    with serving(prefix=("sh", "-c", f'ulimit -n {files}; exec "$@"', "sh")) as server:
        yield from _fill(server, find_max_sessions(files) - OWN_SESSIONS)


def _hold_many(server: Server, count: int, settle_s: float) -> Iterator[Figure]:
    memory = psutil.Process(server.process.pid)
    before_mb = _read_mb(memory)
    with _holding(server, count) as (admitted, _):
        held_mb = _read_mb(memory) - before_mb
        failed = _count_failures(server, "held")
    time.sleep(settle_s)
    yield Figure(
        what=f"sessions of {count} that are held",
        unit="",
        samples=(float(admitted),),
        limit=Limit("min", ">=", float(count)),
    )
    yield _make_failures(f"beside {count} sessions", failed)
    yield Figure(what=f"memory of {count} sessions", unit="MB", samples=(held_mb,))
    yield Figure(
        what=f"memory {settle_s:g} s after {count} sessions",
        unit="MB",
        samples=(_read_mb(memory) - before_mb,),
        limit=Limit("max", "<=", 50.0),
    )


def _fill(server: Server, most: int) -> Iterator[Figure]:
    with _holding(server, most + 1) as (admitted, refusal):
        failed = _count_failures(server, "full")
    yield Figure(
        what="sessions beyond the limit that were admitted or refused without 'full'",
        unit="",
        samples=(float(max(0, admitted - most) + ("full" not in refusal)),),
        limit=Limit("max", "<=", 0.0),
    )
    yield _make_failures("at a server that is full", failed)
    begin_s = time.monotonic()
    eventually(lambda: _may_join(server), 30.0, "joining")
    yield Figure(
        what="end of the sessions to the next session",
        unit="s",
        samples=(time.monotonic() - begin_s,),
        limit=Limit("max", "<=", 5.0, is_timed=True),
    )


def _make_failures(where: str, failed: int) -> Figure:
    return Figure(
        what=f"spawn, file and world that failed {where}",
        unit="",
        samples=(float(failed),),
        limit=Limit("max", "<=", 0.0),
    )


@contextmanager
def _holding(server: Server, count: int) -> Iterator[tuple[int, str]]:
    """Hold sessions; yield how many were admitted, and the text of a refusal."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.chaos.session_holder", server.endpoint, str(count)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )
    try:
        assert process.stdout is not None
        admitted, _, refusal = process.stdout.readline().partition(" ")
        yield int(admitted), refusal.strip()
    finally:
        end(process)
        if process.stdin is not None:
            process.stdin.close()


def _count_failures(server: Server, name: str) -> int:
    """Load a world, spawn a robot and send a file; count those that fail."""
    sha = sha256(ASSET).hexdigest()
    attempts: tuple[Callable[[], object], ...] = (
        lambda: server.bus.call(LOAD_WORLD, LoadWorldRequest(Resource("empty")), world="default"),
        lambda: server.client.spawn(SpawnEntityOrder(name, entity_resource=Resource("box_bot"))),
        lambda: server.client.put_asset(sha, offset=0, total=len(ASSET), data=ASSET),
    )
    return sum(not _succeeds(attempt) for attempt in attempts)


def _succeeds(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except (ServiceError, BusError, TimeoutError):
        return False
    return True


def _may_join(server: Server) -> bool:
    try:
        with open_bus(BusConfig(connect=(server.endpoint,), open_timeout_s=0.5)):
            return True
    except BusError:
        return False


def _read_mb(memory: psutil.Process) -> float:
    return float(memory.memory_info().rss / MEGABYTE)
