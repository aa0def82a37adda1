"""Jobs of clients: those that fail, and those that wait; clients that speak no HTTP."""

import json
import logging
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import pytest
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.foxglove.fake_bus import FakeBus
from zensim.foxglove.foxglove_protocol import SUBPROTOCOLS, FetchAsset
from zensim.foxglove.foxglove_server import (
    MAX_RUNNING_JOBS,
    MAX_WAITING_BYTES,
    MAX_WAITING_JOBS,
    TOO_MANY,
    ClientJobs,
    FoxgloveServer,
    ServedAddress,
)
from zensim.foxglove.live_hub import ClientJob, LiveHub
from zensim.foxglove.world_control import WorldControl
from zensim.proto.web_access import PageAccess

WITHIN_S = 20.0


def fail(_: object) -> bytes:
    raise KeyError("unforeseen")


@contextmanager
def served(notes: list[str], call: Callable[[object], bytes] = fail) -> Iterator[int]:
    """Serve a hub whose jobs fail, or whose calls are of this kind; yield its port."""
    bus = FakeBus()
    control = WorldControl(bus.as_bus, "w", None)
    control.call = call  # type: ignore[assignment,method-assign]
    control.read_parameters = fail  # type: ignore[assignment,method-assign]
    hub = LiveHub(bus.as_bus, "w", None, control=control, read_asset=fail)
    server = FoxgloveServer(hub, ServedAddress("127.0.0.1", 0, PageAccess()), notes.append)
    is_over = Event()
    thread = Thread(target=server.run, args=(is_over.is_set,))
    thread.start()
    try:
        yield server.port
    finally:
        is_over.set()
        thread.join(WITHIN_S)


@contextmanager
def joined(notes: list[str]) -> Iterator[Any]:
    """Serve a hub whose jobs fail; yield a client."""
    with served(notes) as port, open_client(port) as client:
        yield client


def open_client(port: int) -> Any:  # noqa: ANN401
    return connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol(SUBPROTOCOLS[0])])


def make_call(number: int) -> bytes:
    """Make a call of service 1 with this number."""
    return b"\x02" + struct.pack("<III", 1, number, 4) + b"json{}"


def read_text(client: Any, op: str) -> dict[str, Any]:  # noqa: ANN401
    """Read messages until a text of this kind."""
    while True:
        message = client.recv(WITHIN_S)
        if isinstance(message, str) and (found := json.loads(message))["op"] == op:
            return dict(found)


def test_failed_download_has_a_reply_and_a_line() -> None:
    notes: list[str] = []

    with joined(notes) as client:
        client.send(json.dumps({"op": "fetchAsset", "uri": "package://a", "requestId": 7}))
        while isinstance(message := client.recv(WITHIN_S), str) or message[0] != 4:
            pass

    assert int.from_bytes(message[1:5], "little") == 7
    assert message[5] == 1
    assert [line for line in notes if "KeyError" in line]


def test_failed_call_has_a_reply_and_a_line() -> None:
    notes: list[str] = []

    with joined(notes) as client:
        client.send(make_call(9))
        failure = read_text(client, "serviceCallFailure")

    assert (failure["serviceId"], failure["callId"]) == (1, 9)
    assert [line for line in notes if "KeyError" in line]


def test_failed_job_without_a_number_has_a_status() -> None:
    notes: list[str] = []

    with joined(notes) as client:
        client.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "a"}))
        status = read_text(client, "status")

    assert "KeyError" in status["message"]
    assert [line for line in notes if "KeyError" in line]


def test_calls_of_one_client_do_not_keep_another_waiting() -> None:
    release = Event()

    def block(_: object) -> bytes:
        release.wait(WITHIN_S)
        return b"{}"

    with served([], block) as port, open_client(port) as busy, open_client(port) as other:
        for number in range(8):
            busy.send(make_call(number))
        busy.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [1]}))
        read_text(busy, "status")
        other.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "a"}))
        try:
            status = read_text(other, "status")
        finally:
            release.set()

    assert "KeyError" in status["message"]


def test_calls_beyond_what_may_wait_are_refused() -> None:
    release = Event()

    def block(_: object) -> bytes:
        release.wait(WITHIN_S)
        return b"{}"

    with served([], block) as port, open_client(port) as client:
        try:
            for number in range(MAX_WAITING_JOBS + MAX_RUNNING_JOBS + 1):
                client.send(make_call(number))
            failure = read_text(client, "serviceCallFailure")
        finally:
            release.set()

    assert failure["callId"] == MAX_WAITING_JOBS + MAX_RUNNING_JOBS
    assert failure["message"] == TOO_MANY


def make_job(size: int) -> ClientJob:
    return ClientJob(lambda: None, FetchAsset("package://a", 1), size)


def test_work_that_waits_is_bounded_in_bytes() -> None:
    jobs = ClientJobs()

    assert jobs.add(make_job(MAX_WAITING_BYTES))
    assert not jobs.add(make_job(1))
    assert jobs.take() is not None
    assert jobs.add(make_job(1))


def test_some_work_of_a_client_runs_and_the_rest_waits() -> None:
    jobs = ClientJobs()
    made = [make_job(1) for _ in range(MAX_RUNNING_JOBS + 1)]
    for job in made:
        jobs.add(job)

    running = [jobs.take() for _ in made]
    jobs.finish()

    assert running == [*made[:-1], None]
    assert jobs.take() is made[-1]


def test_client_that_speaks_no_http_has_a_line_and_no_traceback(
    caplog: pytest.LogCaptureFixture,
) -> None:
    notes: list[str] = []

    with caplog.at_level(logging.DEBUG), served(notes) as port:
        with socket.create_connection(("127.0.0.1", port), WITHIN_S) as link:
            link.sendall(b"no HTTP\r\n\r\n")
            while link.recv(1024):
                pass
        with open_client(port) as client:
            read_text(client, "serverInfo")

    assert [one for one in caplog.records if one.exc_info] == []
    assert len(notes) == 1
    assert "\n" not in notes[0]
