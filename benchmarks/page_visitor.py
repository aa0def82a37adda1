"""Visitors of the 3D page without a browser, in a process of their own.

`python -m benchmarks.page_visitor URL COUNT` opens the page COUNT times, with the token that the
address may have. Each second it prints a line: what one got.
"""

import os
import sys
import threading
import time
from contextlib import ExitStack, closing
from typing import NoReturn
from urllib.parse import parse_qs, urlsplit

import msgspec
from websockets.sync.client import ClientConnection

from tests.integration.page_client import connect_page, encode_camera, read_messages
from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.web_access import TOKEN_NAME, name_cookie

SETTLE_S = 2.0
"""Time for the scene, which is sent first."""


class Second(msgspec.Struct, frozen=True):
    """What one visitor got in a second, on average of all visitors."""

    updates: float
    """Messages with new poses of robots."""
    bytes: float
    first_bytes: float = 0.0
    """What was sent before the first second: the scene."""


class Visitor:
    """One page that reads all that it is sent."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.updates = self.bytes = 0
        connection.send(encode_camera())
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for frame in self._connection:
            self.bytes += len(frame)
            changes = [message.get("updates", {}) for message in read_messages(frame)]
            self.updates += any("batched_positions" in change for change in changes)


def split_token(url: str) -> tuple[str, str]:
    """Split the address of a page into that of its server and the cookie that it admits."""
    parts = urlsplit(url)
    page = f"{parts.scheme}://{parts.netloc}"
    token = parse_qs(parts.query).get(TOKEN_NAME, [""])[0]
    return page, f"{name_cookie(parts.port or 0)}={token}" if token else ""


def visit(url: str, count: int) -> NoReturn:
    """Open the page, and print what the visitors get until terminated."""
    with ExitStack() as stack:
        page, cookie = split_token(url)
        visitors = [
            Visitor(stack.enter_context(closing(connect_page(page, cookie=cookie))))
            for _ in range(count)
        ]
        time.sleep(SETTLE_S)
        first_bytes = sum(visitor.bytes for visitor in visitors) / count
        while True:
            before_s = time.perf_counter()
            before = [(one.updates, one.bytes) for one in visitors]
            time.sleep(1.0)
            share = 1.0 / (count * (time.perf_counter() - before_s))
            updates = sum(one.updates - old for one, (old, _) in zip(visitors, before, strict=True))
            size = sum(one.bytes - old for one, (_, old) in zip(visitors, before, strict=True))
            second = Second(share * updates, share * size, first_bytes)
            sys.stdout.write(msgspec.json.encode(second).decode() + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    visit(sys.argv[1], int(sys.argv[2]))
