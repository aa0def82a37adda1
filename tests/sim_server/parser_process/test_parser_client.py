"""ParserClient with a real process: results, limits, deadlines, replacement."""

import errno
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import psutil
import pytest
import trimesh

from tests.integration.processes import eventually
from tests.sim_server.description.meshes.mesh_samples import BOX, exported
from tests.sim_server.description.robots import a_link, a_robot
from tests.sim_server.fakes import WallTime
from tests.sim_server.parser_process.test_asset_store import put
from zensim.proto.child_process import FramedProcess
from zensim.proto.messages.asset_messages import AssetRef
from zensim.sim_server.parser_process import parser_client, parser_worker
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.parser_client import (
    DEADLINE_S,
    MAX_IN_FLIGHT,
    MAX_SLOWDOWN,
    PARSER_NICENESS,
    ParserClient,
    ParserClock,
    read_run_queue_wait_ns,
)
from zensim.sim_server.parser_process.parser_protocol import ParsedMesh, ParseRequest, ParseResult

PROCESS, NEXT = 1, 2
MS = 1_000_000


class FakeKernel:
    """Waiting times of processes."""

    def __init__(self) -> None:
        self.waits: dict[int, int] = {PROCESS: 0, NEXT: 0}

    def read_wait_ns(self, process_id: int) -> int:
        return self.waits[process_id]


def a_clock() -> tuple[WallTime, FakeKernel, ParserClock]:
    wall, kernel = WallTime(), FakeKernel()
    time = ParserClock(wall.now_ns, kernel.read_wait_ns)
    time.track(PROCESS)
    return wall, kernel, time


def advance(wall: WallTime, time: ParserClock, milliseconds: int) -> int:
    """Update the clock every 20 ms; return how far it went [ms]."""
    before_ns = time.now_ns
    for _ in range(milliseconds // 20):
        wall.ns += 20 * MS
        time.update()
    return (time.now_ns - before_ns) // MS


def test_clock_follows_wall_time_when_the_process_never_waits() -> None:
    wall, _, time = a_clock()

    assert advance(wall, time, 1000) == 1000


def test_clock_leaves_out_time_in_the_run_queue() -> None:
    wall, kernel, time = a_clock()
    elapsed_ms = 0
    for _ in range(50):
        kernel.waits[PROCESS] += 15 * MS
        elapsed_ms += advance(wall, time, 20)

    assert elapsed_ms == 250


def test_clock_subtracts_a_long_wait_that_is_reported_at_its_end() -> None:
    wall, kernel, time = a_clock()
    first = advance(wall, time, 300)
    kernel.waits[PROCESS] += 300 * MS

    second = advance(wall, time, 500)

    assert (first, second) == (300, 200)


def test_clock_advances_by_a_sixth_of_wall_time_at_least() -> None:
    wall, kernel, time = a_clock()
    for _ in range(60):
        kernel.waits[PROCESS] += 20 * MS
        advance(wall, time, 20)

    assert time.now_ns == 200 * MS


def test_clock_limits_the_time_of_one_update() -> None:
    wall, _, time = a_clock()
    wall.ns += 60_000 * MS
    time.update()

    assert time.now_ns == 1000 * MS


def test_clock_does_not_jump_when_it_tracks_another_process() -> None:
    wall, kernel, time = a_clock()
    kernel.waits = {PROCESS: 0, NEXT: 900 * MS}
    advance(wall, time, 100)
    time.track(NEXT)

    assert advance(wall, time, 100) == 100


def test_run_queue_wait_of_no_process_is_zero() -> None:
    assert read_run_queue_wait_ns(os.getpid()) >= 0
    assert read_run_queue_wait_ns(0) == 0


WITHIN_S = 30.0
ROBOT = a_robot(a_link("base"))
MESH_ROBOT = (
    '<robot name="m"><link name="base"><inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    '<collision><geometry><mesh filename="a.stl"/></geometry></collision></link></robot>'
)
SLEEPER = (sys.executable, "-c", "import sys; sys.stdin.read()")


@pytest.fixture
def store() -> Iterator[AssetStore]:
    found = AssetStore()
    yield found
    found.close()


@pytest.fixture
def parser(store: AssetStore) -> Iterator[ParserClient]:
    found = ParserClient(store, time.monotonic_ns)
    yield found
    found.close()


def parse(parser: ParserClient, request: ParseRequest) -> list[ParsedMesh | ParseResult]:
    """Submit a request and poll for its results."""
    parser.submit(request)
    return poll_for_result(parser, request.number)


def poll_for_result(parser: ParserClient, number: int) -> list[ParsedMesh | ParseResult]:
    found: list[ParsedMesh | ParseResult] = []

    def is_answered() -> bool:
        found.extend(parser.poll())
        return any(isinstance(one, ParseResult) and one.number == number for one in found)

    eventually(is_answered, WITHIN_S, "a result")
    return found


def poll_for(
    parser: ParserClient, wall: WallTime, seconds: float
) -> list[ParsedMesh | ParseResult]:
    """Poll ten times a second for some wall time."""
    found = []
    for _ in range(round(seconds / 0.1)):
        wall.sleep(0.1)
        found.extend(parser.poll())
    return found


def test_parser_returns_the_model_of_a_text(parser: ParserClient) -> None:
    (result,) = parse(parser, ParseRequest(1, ROBOT))

    assert isinstance(result, ParseResult)
    assert result.model is not None
    assert result.model.links[0].name == "base"


def test_parser_returns_the_slug_of_an_error(parser: ParserClient) -> None:
    (result,) = parse(parser, ParseRequest(1, "<robot"))

    assert isinstance(result, ParseResult)
    assert (result.model, result.slug) == (None, "xml.syntax")


def test_parser_sends_meshes_before_their_model(parser: ParserClient, store: AssetStore) -> None:
    name = put(store, exported(BOX, "stl"))
    refs = (AssetRef("a.stl", name),)

    mesh, result = parse(parser, ParseRequest(1, MESH_ROBOT, assets=refs, files=(name,)))

    assert isinstance(mesh, ParsedMesh)
    assert isinstance(result, ParseResult)
    assert result.model is not None
    assert result.model.links[0].collisions[0].mesh == mesh.sha256


def test_parser_converts_meshes_like_a_process_with_all_libraries(
    parser: ParserClient, store: AssetStore
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    two = trimesh.Scene([BOX, ball.apply_translation((3.0, 0.0, 0.0))])
    for number, ending in enumerate(("stl", "obj", "dae", "glb")):
        data = exported(two if ending == "glb" else ball, ending)
        name = put(store, data)
        text = MESH_ROBOT.replace("a.stl", f"a.{ending}")
        refs = (AssetRef(f"a.{ending}", name),)
        request = ParseRequest(number, text, assets=refs, files=(name,))

        *meshes, result = parse(parser, request)

        expected, made = parser_worker.parse_request(request, {name: data})
        assert msgspec.structs.replace(expected, wanted=()) == result
        assert {mesh.sha256: mesh.data for mesh in meshes if isinstance(mesh, ParsedMesh)} == made


def test_parser_is_replaced_when_it_crashes(parser: ParserClient) -> None:
    parse(parser, ParseRequest(1, ROBOT))
    first = parser.process_id
    parser.submit(ParseRequest(2, ROBOT))
    parser.poll()
    os.kill(first, signal.SIGKILL)

    (refused,) = poll_for_result(parser, 2)
    # It may have replied before it was killed; requests until the replacement fail, too.
    eventually(lambda: not parser.poll() and parser.process_id != first, WITHIN_S, "a replacement")
    (result,) = parse(parser, ParseRequest(3, ROBOT))

    assert isinstance(refused, ParseResult)
    assert refused.slug in ("reader.crashed", "")
    assert isinstance(result, ParseResult)
    assert result.model is not None
    assert parser.process_id != first


def test_many_requests_are_under_way_at_once(parser: ParserClient) -> None:
    parse(parser, ParseRequest(0, ROBOT))
    for number in range(1, MAX_IN_FLIGHT + 3):
        parser.submit(ParseRequest(number, ROBOT))

    found: list[ParsedMesh | ParseResult] = []

    def are_all_there() -> bool:
        found.extend(parser.poll())
        return len(found) == MAX_IN_FLIGHT + 2

    eventually(are_all_there, WITHIN_S, "all results")

    numbers = [one.number for one in found if isinstance(one, ParseResult)]
    assert numbers == list(range(1, MAX_IN_FLIGHT + 3))


def test_requests_behind_one_that_ends_the_process_are_sent_again(store: AssetStore) -> None:
    parser = ParserClient(store, time.monotonic_ns)
    eventually(lambda: not parser.poll() and parser.is_ready, WITHIN_S, "a parser")
    os.kill(parser.process_id, signal.SIGSTOP)
    for number in (1, 2, 3):
        parser.submit(ParseRequest(number, ROBOT))
    parser.poll()
    os.kill(parser.process_id, signal.SIGKILL)

    results = poll_for_result(parser, 3)

    found = [one for one in results if isinstance(one, ParseResult)]
    assert [one.number for one in found] == [1, 2, 3]
    assert [one.slug for one in found] == ["reader.crashed", "", ""]
    parser.close()


def test_request_is_refused_when_it_takes_too_much_cpu_time(store: AssetStore) -> None:
    """The kernel then sends the parser the signal that this test sends."""
    parser = ParserClient(store, time.monotonic_ns)
    eventually(lambda: not parser.poll() and parser.is_ready, WITHIN_S, "a parser")
    os.kill(parser.process_id, signal.SIGSTOP)
    parser.submit(ParseRequest(1, ROBOT))
    parser.poll()
    os.kill(parser.process_id, signal.SIGXCPU)
    os.kill(parser.process_id, signal.SIGCONT)

    results = poll_for_result(parser, 1)

    assert [one.slug for one in results if isinstance(one, ParseResult)] == ["reader.timeout"]
    parser.close()


def test_parser_has_limits_on_files_memory_and_cpu_time(parser: ParserClient) -> None:
    parse(parser, ParseRequest(1, ROBOT))

    process = psutil.Process(parser.process_id)

    assert process.rlimit(psutil.RLIMIT_NOFILE) == (0, 0)
    assert process.rlimit(psutil.RLIMIT_FSIZE) == (0, 0)
    assert 0 < process.rlimit(psutil.RLIMIT_AS)[0] < 8 << 30
    assert 0 < process.rlimit(psutil.RLIMIT_CPU)[0] < 60
    assert process.net_connections() == []


def test_request_is_refused_when_the_parser_does_not_start(store: AssetStore) -> None:
    wall = WallTime()
    parser = ParserClient(store, wall.now_ns, SLEEPER)
    parser.submit(ParseRequest(1, ROBOT))
    before = parser.poll()

    (result,) = poll_for(parser, wall, DEADLINE_S + 1.0)

    assert before == []
    assert isinstance(result, ParseResult)
    assert result.slug == "reader.busy"
    parser.close()


def test_parser_process_is_reaped_when_closed(store: AssetStore) -> None:
    parser = ParserClient(store, time.monotonic_ns, SLEEPER)
    number = parser.process_id

    parser.close()

    assert not psutil.pid_exists(number)


def test_polling_does_not_block(parser: ParserClient) -> None:
    parser.submit(ParseRequest(1, ROBOT))
    longest_s = 0.0
    for _ in range(100):
        before = time.thread_time()
        parser.poll()
        longest_s = max(longest_s, time.thread_time() - before)

    assert longest_s < 0.02


def test_idle_parser_is_polled_periodically(store: AssetStore) -> None:
    wall = WallTime()
    parser = ParserClient(store, wall.now_ns)
    eventually(lambda: not parser.poll() and parser.is_ready, WITHIN_S, "a parser")
    first = parser.process_id
    os.kill(first, signal.SIGKILL)
    dead = psutil.Process(first)
    eventually(lambda: dead.status() == psutil.STATUS_ZOMBIE, WITHIN_S, "its end")

    parser.poll()
    process_id = parser.process_id
    wall.sleep(0.25)
    parser.poll()

    assert process_id == first
    assert parser.process_id != first
    parser.close()


def test_parser_session_has_a_lower_priority(parser: ParserClient) -> None:
    session_share = Path(f"/proc/{parser.process_id}/autogroup")
    parse(parser, ParseRequest(1, ROBOT))

    niceness = os.getpriority(os.PRIO_PROCESS, parser.process_id)

    assert niceness == PARSER_NICENESS
    # Kernels that share cores among sessions report the share.
    assert not session_share.exists() or session_share.read_text(encoding="ascii").strip().endswith(
        f"nice {PARSER_NICENESS}"
    )


def test_parser_is_started_when_files_are_free_again(
    store: AssetStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    wall = WallTime()
    parser = ParserClient(store, wall.now_ns)
    eventually(lambda: not parser.poll() and parser.is_ready, WITHIN_S, "a parser")
    process = psutil.Process(parser.process_id)
    process.kill()
    eventually(lambda: process.status() == psutil.STATUS_ZOMBIE, WITHIN_S, "its end")

    def fail(_: object) -> FramedProcess:
        raise OSError(errno.EMFILE, "Too many open files")

    with monkeypatch.context() as patch:
        patch.setattr(parser_client, "FramedProcess", fail)
        parser.submit(ParseRequest(1, ROBOT))
        # Its clock leaves out what the former process waited for a core.
        refused = poll_for(parser, wall, MAX_SLOWDOWN * DEADLINE_S + 1.0)
    poll_for(parser, wall, MAX_SLOWDOWN * 1.0)
    found = parse(parser, ParseRequest(2, ROBOT))
    parser.close()

    assert [one.slug for one in refused if isinstance(one, ParseResult)] == ["reader.busy"]
    assert [one.slug for one in found if isinstance(one, ParseResult)] == [""]
