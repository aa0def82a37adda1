"""Buffer of messages to pages: when the loop that sends them is woken."""

from collections.abc import Callable
from typing import Any, cast

import pytest
from viser._messages import RemoveNotificationMessage

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
