"""Requests and messages that the page accepts and refuses."""

import asyncio
import random
import threading

import msgspec
import pytest

from tests.integration.page_client import encode_camera, encode_click, encode_update
from zensim.spawner.page.page_messages import read_page_message
from zensim.spawner.page.page_server import LoopEvent


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
    assert read_page_message(message) is not None


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
        encode_update("a-uuid", value=[1.0] * 5),
        encode_update("a-uuid", value="x" * 2000),
        encode_update("a-uuid", value=float("nan")),
        encode_update("a-uuid", value=[1.0, float("inf")]),
        with_field(encode_camera(), fov=float("nan")),
        with_field(encode_camera(), position=(0.0, float("inf"), 0.0)),
        with_field(encode_camera(), image_width=-1),
        with_field(encode_camera(), more=1),
        with_field(encode_click("/robots/0/0/0", 1), instance_index=1 << 40),
        with_field(encode_click("/robots/0/0/0", 1), screen_pos=(float("nan"), 0.0)),
    ],
)
def test_message_of_another_program_is_dropped(message: str | bytes) -> None:
    assert read_page_message(message) is None


def test_mutated_messages_are_dropped_or_keep_their_types() -> None:
    chance = random.Random(7)
    originals = [encode_camera(), encode_click("/r/0", 1), encode_update("u", value="Play")]
    accepted = 0
    for _ in range(20_000):
        mutant = bytearray(chance.choice(originals))
        for _ in range(chance.randint(1, 4)):
            mutant[chance.randrange(len(mutant))] = chance.randrange(256)
        if read_page_message(bytes(mutant)) is not None:
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
