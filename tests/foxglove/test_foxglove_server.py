"""Jobs of clients that fail with an error that no job foresees."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.foxglove.fake_bus import FakeBus
from zensim.foxglove.foxglove_protocol import SUBPROTOCOLS
from zensim.foxglove.foxglove_server import FoxgloveServer, ServedAddress
from zensim.foxglove.live_hub import LiveHub
from zensim.foxglove.world_control import WorldControl
from zensim.proto.web_access import PageAccess

WITHIN_S = 20.0


def fail(_: object) -> bytes:
    raise KeyError("unforeseen")


@contextmanager
def served(notes: list[str]) -> Iterator[Any]:
    """Serve a hub whose jobs fail; yield a client."""
    bus = FakeBus()
    control = WorldControl(bus.as_bus, "w", None)
    control.call = fail  # type: ignore[assignment,method-assign]
    control.read_parameters = fail  # type: ignore[assignment,method-assign]
    hub = LiveHub(bus.as_bus, "w", None, control=control, read_asset=fail)
    server = FoxgloveServer(hub, ServedAddress("127.0.0.1", 0, PageAccess()), notes.append)
    is_over = Event()
    thread = Thread(target=server.run, args=(is_over.is_set,))
    thread.start()
    try:
        with connect(
            f"ws://127.0.0.1:{server.port}", subprotocols=[Subprotocol(SUBPROTOCOLS[0])]
        ) as client:
            yield client
    finally:
        is_over.set()
        thread.join(WITHIN_S)


def read_text(client: Any, op: str) -> dict[str, Any]:  # noqa: ANN401
    """Read messages until a text of this kind."""
    while True:
        message = client.recv(WITHIN_S)
        if isinstance(message, str) and (found := json.loads(message))["op"] == op:
            return dict(found)


def test_failed_download_has_a_reply_and_a_line() -> None:
    notes: list[str] = []

    with served(notes) as client:
        client.send(json.dumps({"op": "fetchAsset", "uri": "package://a", "requestId": 7}))
        while isinstance(message := client.recv(WITHIN_S), str) or message[0] != 4:
            pass

    assert int.from_bytes(message[1:5], "little") == 7
    assert message[5] == 1
    assert [line for line in notes if "KeyError" in line]


def test_failed_call_has_a_reply_and_a_line() -> None:
    notes: list[str] = []

    with served(notes) as client:
        client.send(
            b"\x02"
            + (1).to_bytes(4, "little")
            + (9).to_bytes(4, "little")
            + (4).to_bytes(4, "little")
            + b"json{}"
        )
        failure = read_text(client, "serviceCallFailure")

    assert (failure["serviceId"], failure["callId"]) == (1, 9)
    assert [line for line in notes if "KeyError" in line]


def test_failed_job_without_a_number_has_a_status() -> None:
    notes: list[str] = []

    with served(notes) as client:
        client.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "a"}))
        status = read_text(client, "status")

    assert "KeyError" in status["message"]
    assert [line for line in notes if "KeyError" in line]
