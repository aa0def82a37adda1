"""Visitors of the 3D page without a browser, in a process of their own.

`python -m benchmarks.page_visitor URL COUNT [LABEL ...]` opens the page COUNT times; the first
visitor switches the check boxes with these labels on. Each second it prints a line: what one got.
"""

import os
import sys
import threading
import time
from contextlib import ExitStack, closing
from typing import NoReturn

import msgspec
from websockets.sync.client import ClientConnection

from tests.integration.page_client import connect_page, encode_camera, encode_update, read_messages
from zensim.proto.process_limits import die_with_supervisor

SETTLE_S = 2.0
"""For the scene, which is sent first."""


class Second(msgspec.Struct, frozen=True):
    """What one visitor got in a second, on average of all visitors."""

    updates: float
    """Messages with new poses of robots."""
    bytes: float
    first_bytes: float = 0.0
    """What was sent before the first second: the scene."""


class Visitor:
    """One page that reads all that it is sent."""

    def __init__(self, connection: ClientConnection, labels: frozenset[str]) -> None:
        self._connection, self._labels = connection, labels
        self.updates = self.bytes = 0
        connection.send(encode_camera())
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for frame in self._connection:
            self.bytes += len(frame)
            messages = read_messages(frame)
            self.updates += any("batched_positions" in m.get("updates", {}) for m in messages)
            for message in messages:
                props = message.get("props")
                if isinstance(props, dict) and props.get("label") in self._labels:
                    self._connection.send(encode_update(message["uuid"], value=True))


def visit(url: str, count: int, labels: frozenset[str]) -> NoReturn:
    """Open the page, and print what the visitors get until terminated."""
    with ExitStack() as stack:
        visitors = [
            Visitor(
                stack.enter_context(closing(connect_page(url))), labels if not i else frozenset()
            )
            for i in range(count)
        ]
        time.sleep(SETTLE_S)
        first_bytes = sum(visitor.bytes for visitor in visitors) / count
        while True:
            before_s = time.perf_counter()
            before = [(visitor.updates, visitor.bytes) for visitor in visitors]
            time.sleep(1.0)
            share = 1.0 / (count * (time.perf_counter() - before_s))
            gained = [
                (v.updates - u, v.bytes - b) for v, (u, b) in zip(visitors, before, strict=True)
            ]
            updates, received = (share * sum(column) for column in zip(*gained, strict=True))
            second = Second(updates, received, first_bytes)
            sys.stdout.write(msgspec.json.encode(second).decode() + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    visit(sys.argv[1], int(sys.argv[2]), frozenset(sys.argv[3:]))
