"""Buffer of messages to pages: when the loop that sends them is woken."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, cast

import pytest
from viser._messages import RemoveNotificationMessage
from viser.infra import Message

from zensim.spawner.page.page_server import LoopMessageBuffer


class Loop:
    """Counts how often it is woken."""

    def __init__(self) -> None:
        self.wakes = 0

    def call_soon_threadsafe(self, _: Callable[[], None]) -> None:
        self.wakes += 1


@pytest.fixture
def loop() -> Loop:
    return Loop()


@pytest.fixture
def buffer(loop: Loop) -> LoopMessageBuffer:
    return LoopMessageBuffer(cast("Any", loop), persistent_messages=False)


def push(buffer: LoopMessageBuffer) -> None:
    buffer.push(RemoveNotificationMessage("a"))


def test_atomic_block_without_messages_wakes_nothing(buffer: LoopMessageBuffer, loop: Loop) -> None:
    buffer.atomic_start()
    buffer.atomic_end()

    assert loop.wakes == 0


def test_outermost_atomic_block_with_messages_wakes_once(
    buffer: LoopMessageBuffer, loop: Loop
) -> None:
    buffer.atomic_start()
    buffer.atomic_start()
    push(buffer)
    push(buffer)
    buffer.atomic_end()
    before = loop.wakes
    buffer.atomic_end()

    assert (before, loop.wakes) == (0, 1)


def test_message_before_an_atomic_block_is_not_held_back(
    buffer: LoopMessageBuffer, loop: Loop
) -> None:
    push(buffer)
    before = loop.wakes
    # The loop may look only while the block lasts, and sends nothing then.
    buffer.atomic_start()
    buffer.atomic_end()

    assert (before, loop.wakes) == (1, 2)


def test_block_without_messages_wakes_a_sender_that_is_behind(
    buffer: LoopMessageBuffer, loop: Loop
) -> None:
    buffer.generator_cursors[0] = -1
    buffer.atomic_start()
    push(buffer)
    buffer.atomic_end()
    # The sender looks only while this block lasts, and sends nothing then.
    buffer.atomic_start()
    buffer.atomic_end()
    behind = loop.wakes
    buffer.generator_cursors[0] = 0
    buffer.atomic_start()
    buffer.atomic_end()

    assert (behind, loop.wakes) == (2, 2)


def test_message_is_sent_though_its_sender_looked_during_a_later_block() -> None:
    sent = asyncio.run(send_across_blocks())

    assert len(sent) == 1


async def send_across_blocks() -> Sequence[Message]:
    """Push in one block, let the sender look in another, and wait for what it sends."""
    buffer = LoopMessageBuffer(asyncio.get_running_loop(), persistent_messages=False)
    buffer.window_duration_sec = 0.0
    windows = buffer.window_generator(0)
    sender = asyncio.ensure_future(anext(windows))
    buffer.atomic_start()
    push(buffer)
    buffer.atomic_end()
    buffer.atomic_start()
    for _ in range(100):
        await asyncio.sleep(0.0)
    buffer.atomic_end()
    try:
        return await asyncio.wait_for(sender, 10.0)
    finally:
        await windows.aclose()
