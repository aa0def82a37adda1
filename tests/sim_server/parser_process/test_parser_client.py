"""The reader, a real process: what kills it is refused, and costs nothing more."""

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
from tests.sim_server.description.meshes.test_mesh_conversion import BOX, exported
from tests.sim_server.description.robots import a_link, a_robot
from tests.sim_server.fakes import WallTime
from tests.sim_server.parser_process.test_asset_store import put
from zensim.proto.messages.asset_messages import AssetRef
from zensim.sim_server.parser_process import parser_worker
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.parser_client import (
    DEADLINE_S,
    PARSER_NICENESS,
    ParserClient,
    ParserClock,
    read_run_queue_wait_ns,
)
from zensim.sim_server.parser_process.parser_protocol import ParsedMesh, ParseRequest, ParseResult

PROCESS, NEXT = 1, 2
MS = 1_000_000


class Kernel:
    """Says how long processes have waited."""

    def __init__(self) -> None:
        self.waits: dict[int, int] = {PROCESS: 0, NEXT: 0}

    def waited(self, process_id: int) -> int:
        return self.waits[process_id]


def a_clock() -> tuple[WallTime, Kernel, ParserClock]:
    wall, kernel = WallTime(), Kernel()
    time = ParserClock(wall.now_ns, kernel.waited)
    time.track(PROCESS)
    return wall, kernel, time


def looked_for(wall: WallTime, time: ParserClock, milliseconds: int) -> int:
    """Look every 20 ms, and say how far the clock went."""
    before_ns = time.now_ns
    for _ in range(milliseconds // 20):
        wall.ns += 20 * MS
        time.update()
    return (time.now_ns - before_ns) // MS


def test_time_goes_on_with_the_wall_when_nothing_is_in_the_way() -> None:
    wall, _, time = a_clock()

    assert looked_for(wall, time, 1000) == 1000


def test_time_stands_while_others_have_the_cores() -> None:
    wall, kernel, time = a_clock()
    gone = 0
    for _ in range(50):
        kernel.waits[PROCESS] += 15 * MS
        gone += looked_for(wall, time, 20)

    assert gone == 250


def test_time_catches_up_when_a_long_wait_is_told_at_its_end() -> None:
    wall, kernel, time = a_clock()
    first = looked_for(wall, time, 300)
    kernel.waits[PROCESS] += 300 * MS

    second = looked_for(wall, time, 500)

    assert (first, second) == (300, 200)


def test_time_goes_on_a_little_on_any_machine() -> None:
    wall, kernel, time = a_clock()
    for _ in range(60):
        kernel.waits[PROCESS] += 20 * MS
        looked_for(wall, time, 20)

    assert time.now_ns == 200 * MS


def test_time_leaves_out_how_long_nobody_looked() -> None:
    wall, _, time = a_clock()
    wall.ns += 60_000 * MS
    time.update()

    assert time.now_ns == 1000 * MS


def test_time_does_not_jump_when_the_process_is_another() -> None:
    wall, kernel, time = a_clock()
    kernel.waits = {PROCESS: 0, NEXT: 900 * MS}
    looked_for(wall, time, 100)
    time.track(NEXT)

    assert looked_for(wall, time, 100) == 100


def test_waits_of_this_process_are_told_and_those_of_none_are_zero() -> None:
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
def reader(store: AssetStore) -> Iterator[ParserClient]:
    found = ParserClient(store, time.monotonic_ns)
    yield found
    found.close()


def read(reader: ParserClient, request: ParseRequest) -> list[ParsedMesh | ParseResult]:
    """Hand a request over and poll until it is answered."""
    reader.submit(request)
    return answered(reader, request.number)


def answered(reader: ParserClient, number: int) -> list[ParsedMesh | ParseResult]:
    found: list[ParsedMesh | ParseResult] = []

    def is_answered() -> bool:
        found.extend(reader.poll())
        return any(isinstance(one, ParseResult) and one.number == number for one in found)

    eventually(is_answered, WITHIN_S, "an answer")
    return found


def polled_for(
    reader: ParserClient, wall: WallTime, seconds: float
) -> list[ParsedMesh | ParseResult]:
    """Poll ten times a second until so much wall time is over."""
    found = []
    for _ in range(round(seconds / 0.1)):
        wall.sleep(0.1)
        found.extend(reader.poll())
    return found


def test_reader_gives_the_model_of_a_text(reader: ParserClient) -> None:
    (answer,) = read(reader, ParseRequest(1, ROBOT))

    assert isinstance(answer, ParseResult)
    assert answer.model is not None
    assert answer.model.links[0].name == "base"


def test_reader_says_why_there_is_no_model(reader: ParserClient) -> None:
    (answer,) = read(reader, ParseRequest(1, "<robot"))

    assert isinstance(answer, ParseResult)
    assert (answer.model, answer.slug) == (None, "xml.syntax")


def test_reader_sends_meshes_before_the_model_that_names_them(
    reader: ParserClient, store: AssetStore
) -> None:
    name = put(store, exported(BOX, "stl"))
    refs = (AssetRef("a.stl", name),)

    mesh, answer = read(reader, ParseRequest(1, MESH_ROBOT, assets=refs, files=(name,)))

    assert isinstance(mesh, ParsedMesh)
    assert isinstance(answer, ParseResult)
    assert answer.model is not None
    assert answer.model.links[0].collisions[0].mesh == mesh.sha256


def test_reader_makes_the_meshes_that_a_process_with_every_library_makes(
    reader: ParserClient, store: AssetStore
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    two = trimesh.Scene([BOX, ball.apply_translation((3.0, 0.0, 0.0))])
    for number, ending in enumerate(("stl", "obj", "dae", "glb")):
        data = exported(two if ending == "glb" else ball, ending)
        name = put(store, data)
        text = MESH_ROBOT.replace("a.stl", f"a.{ending}")
        refs = (AssetRef(f"a.{ending}", name),)
        request = ParseRequest(number, text, assets=refs, files=(name,))

        *meshes, answer = read(reader, request)

        expected, made = parser_worker.parse_request(request, {name: data})
        assert msgspec.structs.replace(expected, wanted=()) == answer
        assert {mesh.sha256: mesh.data for mesh in meshes if isinstance(mesh, ParsedMesh)} == made


def test_reader_is_replaced_when_it_dies_and_reads_on(reader: ParserClient) -> None:
    read(reader, ParseRequest(1, ROBOT))
    first = reader.process_id
    reader.submit(ParseRequest(2, ROBOT))
    reader.poll()
    os.kill(first, signal.SIGKILL)

    (refused,) = answered(reader, 2)
    # It may have answered before it died; what is handed over until then dies with it.
    eventually(lambda: not reader.poll() and reader.process_id != first, WITHIN_S, "another one")
    (answer,) = read(reader, ParseRequest(3, ROBOT))

    assert isinstance(refused, ParseResult)
    assert refused.slug in ("reader.crashed", "")
    assert isinstance(answer, ParseResult)
    assert answer.model is not None
    assert reader.process_id != first


def test_reader_can_open_no_file_and_take_no_more_memory(reader: ParserClient) -> None:
    read(reader, ParseRequest(1, ROBOT))

    process = psutil.Process(reader.process_id)

    assert process.rlimit(psutil.RLIMIT_NOFILE) == (0, 0)
    assert process.rlimit(psutil.RLIMIT_FSIZE) == (0, 0)
    assert 0 < process.rlimit(psutil.RLIMIT_AS)[0] < 8 << 30
    assert 0 < process.rlimit(psutil.RLIMIT_CPU)[0] < 60
    assert process.net_connections() == []


def test_request_is_refused_when_the_reader_never_gets_ready(store: AssetStore) -> None:
    wall = WallTime()
    reader = ParserClient(store, wall.now_ns, SLEEPER)
    reader.submit(ParseRequest(1, ROBOT))
    before = reader.poll()

    (answer,) = polled_for(reader, wall, DEADLINE_S + 1.0)

    assert before == []
    assert isinstance(answer, ParseResult)
    assert answer.slug == "reader.timeout"
    reader.close()


def test_reader_is_gone_when_closed(store: AssetStore) -> None:
    reader = ParserClient(store, time.monotonic_ns, SLEEPER)
    number = reader.process_id

    reader.close()

    assert not psutil.pid_exists(number)


def test_polling_never_waits(reader: ParserClient) -> None:
    reader.submit(ParseRequest(1, ROBOT))
    longest_s = 0.0
    for _ in range(100):
        before = time.thread_time()
        reader.poll()
        longest_s = max(longest_s, time.thread_time() - before)

    assert longest_s < 0.02


def test_reader_that_is_idle_is_looked_at_at_times(store: AssetStore) -> None:
    wall = WallTime()
    reader = ParserClient(store, wall.now_ns)
    eventually(lambda: not reader.poll() and reader.is_ready, WITHIN_S, "a reader")
    first = reader.process_id
    os.kill(first, signal.SIGKILL)
    dead = psutil.Process(first)
    eventually(lambda: dead.status() == psutil.STATUS_ZOMBIE, WITHIN_S, "its end")

    reader.poll()
    at_once = reader.process_id
    wall.sleep(0.25)
    reader.poll()

    assert at_once == first
    assert reader.process_id != first
    reader.close()


def test_reader_comes_last_among_all_sessions(reader: ParserClient) -> None:
    shares = Path(f"/proc/{reader.process_id}/autogroup")
    read(reader, ParseRequest(1, ROBOT))

    niceness = os.getpriority(os.PRIO_PROCESS, reader.process_id)

    assert niceness == PARSER_NICENESS
    # Kernels that share cores among sessions say what the reader's gets.
    assert not shares.exists() or shares.read_text(encoding="ascii").strip().endswith(
        f"nice {PARSER_NICENESS}"
    )
