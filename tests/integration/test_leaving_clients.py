"""Servers whose clients come and go over slow links, politely or not: all others are served."""

import json
import random
import socket
import ssl
import struct
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from hashlib import sha256
from http.client import HTTPConnection, HTTPException
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import viser
from websockets.exceptions import InvalidHandshake, WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from tests.foxglove.fake_bus import FakeBus
from tests.integration.page_client import PROTOCOL, encode_camera
from tests.integration.processes import eventually
from tests.integration.test_page import make_certificate
from tests.tcp_relay import RESET_AT_ONCE, TcpRelay
from zensim.foxglove.foxglove_protocol import SUBPROTOCOLS
from zensim.foxglove.foxglove_server import FoxgloveServer, ServedAddress
from zensim.foxglove.live_hub import LiveHub
from zensim.proto.codec.message_codec import encode
from zensim.proto.messages.standard_messages import Time
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.program_status import ProgramStatus
from zensim.proto.served_status import served_status
from zensim.proto.topic_catalog import CLOCK
from zensim.proto.web_access import PageAccess
from zensim.sim_server.parser_process.mesh_server import MeshServer
from zensim.spawner.page.page_server import close_server, open_server

CLIENTS, TOGETHER = 200, 20
WITHIN_S = 20.0
CLOSE_S = 1.0
"""Patience of a client that leaves; those that are not polite get no reply."""
HOST = "127.0.0.1"
HANDSHAKE = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
GARBAGE = bytes(random.Random(1).randbytes(4000))
PERIOD_S = 0.01

Ask = Callable[[int], None]
"""Asks a port as a well-behaved client does; raises where it is not served."""


class SocketServer:
    """A server of websockets: how its clients connect, and what they say first."""

    def __init__(self, protocol: Subprotocol, files: tuple[str, str] | None) -> None:
        self._protocol = protocol
        self.access = PageAccess("", *files) if files else PageAccess()
        self._trust = ssl.create_default_context(cafile=files[0]) if files else None

    def greet(self, client: Connection) -> None:
        """Say what makes the server send messages again and again."""

    def open(self, port: int) -> ClientConnection:
        """Connect."""
        scheme = "wss" if self._trust else "ws"
        return connect(
            f"{scheme}://{HOST}:{port}",
            subprotocols=[self._protocol],
            origin=Origin(f"{scheme.replace('ws', 'http')}://{HOST}:{port}"),
            ssl=self._trust,
            max_size=None,
            ping_interval=None,
            close_timeout=CLOSE_S,
        )

    def ask(self, port: int) -> None:
        """Connect, read some messages, and leave."""
        with self.open(port) as client:
            self.greet(client)
            for _ in range(3):
                client.recv(WITHIN_S)


class FoxgloveCase(SocketServer):
    """`FoxgloveServer`, with a clock that is published all the time."""

    def greet(self, client: Connection) -> None:
        """Subscribe to all topics."""
        while json.loads(text := client.recv(WITHIN_S))["op"] != "advertise":
            pass
        numbers = [one["id"] for one in json.loads(text)["channels"]]
        asked = [{"id": number, "channelId": number} for number in numbers]
        client.send(json.dumps({"op": "subscribe", "subscriptions": asked}))

    @contextmanager
    def serve(self) -> Iterator[int]:
        """Serve, and yield the port."""
        bus, is_over = FakeBus(), threading.Event()
        hub = LiveHub(bus.as_bus, "w", None, control=None, read_asset=lambda _: b"")
        times = count(1)

        def should_stop() -> bool:
            clock = WorldClock(Time(next(times)))
            bus.publish(CLOCK.key("w"), encode(clock, CLOCK.format), CLOCK.encoding)
            return is_over.is_set()

        server = FoxgloveServer(hub, ServedAddress(HOST, 0, self.access), lambda _: None)
        with ThreadPoolExecutor(1) as runner:
            running = runner.submit(server.run, should_stop)
            try:
                yield server.port
            finally:
                is_over.set()
            running.result(WITHIN_S)


class PageCase(SocketServer):
    """The page, with a frame that moves all the time."""

    def greet(self, client: Connection) -> None:
        """Say where the camera is, as pages do first."""
        client.send(encode_camera())

    @contextmanager
    def serve(self) -> Iterator[int]:
        """Serve, and yield the port."""
        server, is_over = open_server(HOST, 0, lambda: b"{}", self.access), threading.Event()

        def move(frame: viser.FrameHandle) -> None:
            x = 0.0
            while not is_over.wait(PERIOD_S):
                frame.position = (x := x + 0.01, 0.0, 0.0)

        with ThreadPoolExecutor(1) as runner:
            moving = runner.submit(move, server.scene.add_frame("/moving"))
            try:
                yield server.get_port()
            finally:
                is_over.set()
            moving.result(WITHIN_S)
            close_server(server)


def visit(server: SocketServer, port: int, kind: str, is_over: threading.Event) -> None:
    """Connect to a server of websockets, and leave in a way; whatever that raises."""
    if kind in ("half a handshake", "garbage"):
        with socket.create_connection((HOST, port), WITHIN_S) as raw:
            raw.sendall(HANDSHAKE if kind == "half a handshake" else GARBAGE)
        return
    with suppress(OSError, WebSocketException, InvalidHandshake, EOFError):
        client = server.open(port)
        if kind != "says nothing":
            server.greet(client)
            client.recv(WITHIN_S)
        if kind == "stalls":
            is_over.wait(WITHIN_S)
        leave(client, kind)


def leave(client: ClientConnection, kind: str) -> None:
    """End a connection."""
    raw = client.socket
    if kind == "resets":
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_ONCE)
        raw.close()
    elif kind == "ends half":
        raw.shutdown(socket.SHUT_WR)
    elif kind == "lies":
        raw.sendall(b"\xff\xff" + struct.pack(">Q", 2**62) + GARBAGE)
    elif kind == "goes on after the end":
        raw.sendall(b"\x88\x80\0\0\0\0" + b"\x81\x81\0\0\0\0{" * 100)
    client.close()


WAYS = (
    *("polite", "polite", "polite", "says nothing", "resets", "ends half", "lies"),
    *("goes on after the end", "half a handshake", "garbage"),
)


def send_and_leave(port: int, kind: str, is_over: threading.Event) -> None:
    """Send something to a server of HTTP, and leave in a way."""
    requests = {
        "polite": b"GET /livez HTTP/1.0\r\n\r\n",
        "resets": b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n",
        "ends half": b"GET /livez HTTP/1.1\r\n\r\n",
        "lies": b"POST / HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n" + GARBAGE,
        "garbage": GARBAGE,
        "goes on after the end": b"GET / HTTP/1.0\r\n\r\n" * 100,
    }
    with suppress(OSError), socket.create_connection((HOST, port), WITHIN_S) as raw:
        raw.sendall(requests.get(kind, b"GET / HT"))
        if kind == "stalls":
            is_over.wait(WITHIN_S)
        elif kind == "resets":
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_ONCE)
        elif kind == "ends half":
            raw.shutdown(socket.SHUT_WR)
        if kind in ("polite", "ends half"):
            raw.recv(1000)


def come_and_go(visit_once: Callable[[str, threading.Event], None]) -> None:
    """Let many clients come and leave in every way, some at the same time; some stall."""
    choose, is_over = random.Random(1), threading.Event()
    with ThreadPoolExecutor(TOGETHER + 2) as pool:
        stalled = [pool.submit(visit_once, "stalls", is_over) for _ in range(2)]
        visits = [pool.submit(visit_once, choose.choice(WAYS), is_over) for _ in range(CLIENTS)]
        try:
            for one in visits:
                one.result()
        finally:
            is_over.set()
        for one in stalled:
            one.result()


def relayed(port: int, round_trip_s: float) -> "closing[TcpRelay]":
    return closing(TcpRelay(port, round_trip_s / 2.0))


LINKS = [
    pytest.param(0.0, "TCP", id="0 ms"),
    pytest.param(0.02, "TCP", id="20 ms", marks=pytest.mark.long_form),
    pytest.param(0.1, "TCP", id="100 ms"),
    pytest.param(0.0, "TLS", id="0 ms, TLS", marks=pytest.mark.long_form),
    pytest.param(0.02, "TLS", id="20 ms, TLS", marks=pytest.mark.long_form),
    pytest.param(0.1, "TLS", id="100 ms, TLS"),
]


@pytest.mark.parametrize(("round_trip_s", "link"), LINKS)
@pytest.mark.parametrize(
    ("make", "protocol"),
    [(FoxgloveCase, Subprotocol(SUBPROTOCOLS[0])), (PageCase, PROTOCOL)],
    ids=["foxglove", "page"],
)
def test_server_of_websockets_serves_all_others_when_clients_leave(
    make: Any,  # noqa: ANN401
    protocol: Subprotocol,
    round_trip_s: float,
    link: str,
    tmp_path: Path,
) -> None:
    case = make(protocol, make_certificate(tmp_path) if link == "TLS" else None)
    with case.serve() as port, relayed(port, round_trip_s) as relay, case.open(port) as stays:
        case.greet(stays)

        come_and_go(lambda kind, is_over: visit(case, relay.port, kind, is_over))

        drained = 0
        with suppress(TimeoutError):
            while stays.recv(0.0) is not None:
                drained += 1
        assert drained > 0
        stays.recv(WITHIN_S)
        case.ask(relay.port)


@contextmanager
def serve_status(_: Path) -> Iterator[int]:
    with served_status("0", ProgramStatus()) as server:
        assert server is not None
        yield server.port


@contextmanager
def serve_meshes(folder: Path) -> Iterator[int]:
    (folder / f"{sha256(b'solid').hexdigest()}.stl").write_bytes(b"solid")
    with closing(MeshServer(f"{HOST}:0", str(folder))) as server:
        yield server.port


def is_answered(port: int) -> bool:
    """Whether a server of HTTP answers; it may have as many connections as it takes."""
    with closing(HTTPConnection(HOST, port, timeout=WITHIN_S)) as client:
        try:
            client.request("GET", "/livez")
            return client.getresponse().status > 0
        except (OSError, HTTPException):
            return False


@pytest.mark.parametrize(
    "round_trip_s", [0.0, pytest.param(0.02, marks=pytest.mark.long_form), 0.1]
)
@pytest.mark.parametrize("serve", [serve_status, serve_meshes], ids=["status", "meshes"])
def test_server_of_http_answers_when_clients_have_left(
    serve: Callable[[Path], AbstractContextManager[int]], round_trip_s: float, tmp_path: Path
) -> None:
    with serve(tmp_path) as port, relayed(port, round_trip_s) as relay:
        come_and_go(lambda kind, is_over: send_and_leave(relay.port, kind, is_over))

        eventually(lambda: is_answered(relay.port), WITHIN_S, "an answer")
