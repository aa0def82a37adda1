"""A server whose parser process hangs, dies or exceeds memory: one refusal, and the world runs."""

import array
import fcntl
import os
import signal
import struct
import termios
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from tests.hostile.case import BODY, alone, solid
from tests.integration.processes import START_S, Server, eventually, serving
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.sim_server.parser_process.parser_client import BUSY_MESSAGE
from zensim.spawner.spawn.description_sources import read_model_argument
from zensim.spawner.spawn.search_paths import SearchPaths
from zensim.spawner.spawn.spawn_client import add_payload, make_payload, send_files

STDIN = 0
PARSER = "zensim.sim_server.parser_process.parser_worker"
SLOW = f"reader.busy: {BUSY_MESSAGE}"
EXTRAS = b'{"asset":{"version":"2.0"},"extras":[' + b"[]," * (20 << 20) + b"[]]} "
"""JSON of a GLB file of 63 MB: nested lists that need far more memory than the file."""


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as found:
        yield found


@pytest.fixture(autouse=True)
def assert_steps_and_spawns(server: Server) -> Iterator[None]:
    before = find_parser(server).pid
    yield
    steps = server.steps()
    assert answer_to(server, an_order("next")) == ""
    eventually(lambda: server.steps() > steps, 5.0, "stepping")
    assert server.process.poll() is None
    assert server.client.entities() == ()
    assert not psutil.pid_exists(before) or find_parser(server).pid == before


def find_parser(server: Server) -> psutil.Process:
    """Find the parser process of a server; a process that has just started has no command line."""

    def find() -> psutil.Process | None:
        children = psutil.Process(server.process.pid).children()
        found = [child for child in children if PARSER in command_of(child)]
        return found[0] if len(found) == 1 else None

    return eventually(find, START_S, "a parser process")


def command_of(process: psutil.Process) -> list[str]:
    """Read a command line; empty for a process that has ended."""
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


def an_order(name: str) -> SpawnEntityOrder:
    text = alone(BODY).replace('name="r"', f'name="{name}"')
    return SpawnEntityOrder(name, entity_resource=Resource(resource_string=text))


def answer_to(server: Server, order: SpawnEntityOrder) -> str:
    """Spawn and delete; return the message of the refusal, empty if accepted."""
    try:
        report = server.client.spawn(order)
    except ServiceError as refusal:
        return refusal.message
    server.client.delete(report.entity_name)
    return ""


def answer_when(server: Server, name: str, act: Callable[[psutil.Process], None]) -> str:
    """Spawn with a suspended parser process, act on it when it has the request, and wait."""
    reader = find_parser(server)
    reader.suspend()
    with ThreadPoolExecutor(1) as pool:
        response = pool.submit(answer_to, server, an_order(name))
        eventually(lambda: unread_bytes(reader.pid) > 0, 5.0, "handing over")
        act(reader)
        return response.result()


def unread_bytes(process_id: int) -> int:
    """Count the unread bytes of a process's standard input."""
    pipe = os.open(f"/proc/{process_id}/fd/{STDIN}", os.O_RDONLY | os.O_NONBLOCK)
    try:
        count = array.array("i", [0])
        fcntl.ioctl(pipe, termios.FIONREAD, count)
        return count[0]
    finally:
        os.close(pipe)


def test_spawn_is_refused_and_the_next_succeeds_when_the_parser_hangs(server: Server) -> None:
    before = server.steps()

    response = answer_when(server, "hung", lambda _: None)

    assert response.startswith("reader.busy: ")
    assert server.steps() > before


def test_spawn_is_refused_and_the_next_succeeds_when_the_parser_is_killed(server: Server) -> None:
    response = answer_when(server, "killed", lambda reader: reader.send_signal(signal.SIGKILL))

    assert response.startswith("reader.crashed: ")


def test_spawn_succeeds_after_the_parser_was_killed(server: Server) -> None:
    reader = find_parser(server)
    reader.kill()
    eventually(lambda: not psutil.pid_exists(reader.pid), 10.0, "noticing")

    assert answer_to(server, an_order("later")) == ""


def glb_of(text: bytes) -> bytes:
    """Write a GLB file without vertices."""
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


@pytest.mark.long_form
def test_spawn_is_refused_and_the_next_succeeds_when_a_mesh_exceeds_memory(
    server: Server, tmp_path: Path
) -> None:
    tmp_path.joinpath("large.glb").write_bytes(glb_of(EXTRAS))
    file = tmp_path / "large.urdf"
    file.write_text(alone(BODY + solid('<mesh filename="large.glb"/>')), encoding="utf-8")
    cargo = make_payload(
        read_model_argument(str(file), {}, SearchPaths()), SearchPaths(), allow_missing=False
    )
    send_files(server.client, cargo.bundle)
    order = add_payload(cargo, SpawnEntityOrder("large"), "")

    reader, response = find_parser(server), answer_to(server, order)
    while response == SLOW:  # as the message says: on a busy machine, retry
        reader, response = find_parser(server), answer_to(server, order)

    assert response.startswith("reader.memory: ")
    assert find_parser(server) == reader
