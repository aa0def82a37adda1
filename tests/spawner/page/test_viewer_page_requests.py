"""Requests and messages that the page accepts and refuses."""

import asyncio
import random
import socket
import threading

import msgspec
import pytest

from tests.integration.page_client import encode_camera, encode_click, encode_update
from zensim.spawner.page.page_server import LoopEvent, has_token, is_own_origin, is_page_message

OWN = socket.gethostname().lower()


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:8080", "http://127.0.0.1:8080"),
        ("localhost:9000", "http://localhost:9000"),
        ("[::1]:8080", "http://[::1]:8080"),
        ("192.168.1.5:8080", "http://192.168.1.5:8080"),
        (f"{OWN}:8080", f"http://{OWN}:8080"),
        ("sim.lab:8080", "http://sim.lab:8080"),
        ("SIM.lab:8080", "http://sim.LAB:8080"),
        ("127.0.0.1:8080", ""),
    ],
)
def test_request_of_the_own_page_is_accepted(host: str, origin: str) -> None:
    assert is_own_origin([host], [origin] if origin else [], bound_to="sim.lab")


@pytest.mark.parametrize(
    ("hosts", "origins"),
    [
        (["127.0.0.1:8080"], ["http://evil.example"]),
        (["127.0.0.1:8080"], ["http://127.0.0.1:3000"]),
        (["127.0.0.1:8080"], ["null"]),
        (["127.0.0.1:8080"], ["http://[::1"]),
        (["127.0.0.1:8080"], ["http://127.0.0.1:8080", "http://evil.example"]),
        (["evil.example:8080"], ["http://evil.example:8080"]),
        (["evil.example:8080"], []),
        (["127.0.0.1:8080; script-src *"], []),
        (["127.0.0.1:8080", "evil.example"], []),
        ([""], []),
        ([], []),
    ],
)
def test_request_of_another_page_is_refused(hosts: list[str], origins: list[str]) -> None:
    assert not is_own_origin(hosts, origins, bound_to="127.0.0.1")


@pytest.mark.parametrize(
    "message",
    [
        encode_camera(),
        encode_click("/robots/0/0/0", 1),
        encode_update("a-uuid", value=True),
        encode_update("a-uuid", value="Pause"),
    ],
)
def test_message_of_a_page_is_accepted(message: bytes) -> None:
    assert is_page_message(message)


def with_field(message: bytes, **fields: object) -> bytes:
    return msgspec.msgpack.encode(msgspec.msgpack.decode(message) | fields)


@pytest.mark.parametrize(
    "message",
    [
        "text",
        b"",
        b"\x91" * 60_000,
        msgspec.msgpack.encode({"type": "FileTransferStartUpload", "size_bytes": 1 << 40}),
        encode_update("a-uuid", update_cb=[]),
        encode_update("a-uuid", value=True, visible=False),
        encode_update("a-uuid", value=[True]),
        encode_update("a-uuid", value="Explode"),
        with_field(encode_camera(), fov=float("nan")),
        with_field(encode_camera(), position=(0.0, float("inf"), 0.0)),
        with_field(encode_camera(), image_width=-1),
        with_field(encode_camera(), more=1),
        with_field(encode_click("/robots/0/0/0", 1), instance_index=1 << 40),
        with_field(encode_click("/robots/0/0/0", 1), screen_pos=(float("nan"), 0.0)),
    ],
)
def test_message_of_another_program_is_dropped(message: str | bytes) -> None:
    assert not is_page_message(message)


def test_mutated_messages_are_dropped_or_keep_their_types() -> None:
    chance = random.Random(7)
    originals = [encode_camera(), encode_click("/r/0", 1), encode_update("u", value="Play")]
    accepted = 0
    for _ in range(20_000):
        mutant = bytearray(chance.choice(originals))
        for _ in range(chance.randint(1, 4)):
            mutant[chance.randrange(len(mutant))] = chance.randrange(256)
        if is_page_message(bytes(mutant)):
            accepted += 1
            fields = msgspec.msgpack.decode(bytes(mutant))
            assert fields.get("updates", {"value": 0}).keys() == {"value"}
    assert 0 < accepted < 15_000


def test_event_is_set_within_its_loop_only() -> None:
    event = LoopEvent()
    thread = threading.Thread(target=event.set)
    thread.start()
    thread.join()
    assert not event.is_set()

    async def set_here() -> None:
        event.set()

    asyncio.run(set_here())
    assert event.is_set()


@pytest.mark.parametrize(
    ("cookies", "is_known"),
    [
        (["zensim_token=s"], True),
        (["a=b; zensim_token=s"], True),
        (["a=b", "zensim_token=s"], True),
        (["zensim_token=S"], False),
        (["zensim_token="], False),
        (["token=s"], False),
        (["zensim_token=s\u00e9"], False),
        ([], False),
    ],
)
def test_cookie_has_the_token(cookies: list[str], *, is_known: bool) -> None:
    assert has_token(cookies, "s") == is_known
