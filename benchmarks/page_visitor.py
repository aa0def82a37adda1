"""Visitors of the 3D page without a browser, in a process of their own.

`python -m benchmarks.page_visitor URL COUNT ENTITY [LABEL ...]` opens the page COUNT times, with
the token that the address may have; the first visitor selects the entity, unless its name is empty,
and switches the check boxes with these labels on. Each second it prints a line: what one got.
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

from tests.integration.page_client import (
    connect_page,
    encode_camera,
    encode_selection,
    encode_update,
    read_messages,
)
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.web_access import TOKEN_NAME, name_cookie

SETTLE_S = 2.0
"""Time for the scene, which is sent first."""
SELECTED = "Stop following"
"""Label of a control that is there while an entity is selected."""


class Second(msgspec.Struct, frozen=True):
    """What one visitor got in a second, on average of all visitors."""

    updates: float
    """Messages with new poses of robots."""
    drawings: float
    """Messages with trails, charts and scans."""
    bytes: float
    first_bytes: float = 0.0
    """What was sent before the first second: the scene."""


class Visitor:
    """One page that reads all that it is sent."""

    def __init__(
        self, connection: ClientConnection, entity: str = "", labels: frozenset[str] = frozenset()
    ) -> None:
        self._connection, self._entity, self._labels = connection, entity, labels
        self.updates = self.drawings = self.bytes = 0
        connection.send(encode_camera())
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for frame in self._connection:
            self.bytes += len(frame)
            messages = read_messages(frame)
            changes = [message.get("updates", {}) for message in messages]
            self.updates += any("batched_positions" in change for change in changes)
            self.drawings += sum("points" in change or "data" in change for change in changes)
            for message in messages:
                props = message.get("props")
                if isinstance(props, dict) and props.get("label"):
                    self._use(str(props["label"]), str(message["uuid"]))
            if self._entity:
                self._connection.send(encode_selection(self._entity))

    def _use(self, label: str, uuid: str) -> None:
        """Switch a new check box on, and end selecting when there are the controls for it."""
        if label in self._labels:
            self._connection.send(encode_update(uuid, value=True))
        if label == SELECTED:
            self._entity = ""


def split_token(url: str) -> tuple[str, str]:
    """Split the address of a page into that of its server and the cookie that it admits."""
    parts = urlsplit(url)
    page = f"{parts.scheme}://{parts.netloc}"
    token = parse_qs(parts.query).get(TOKEN_NAME, [""])[0]
    return page, f"{name_cookie(parts.port or 0)}={token}" if token else ""


def visit(url: str, count: int, entity: str, labels: frozenset[str]) -> NoReturn:
    """Open the page, and print what the visitors get until terminated."""
    with ExitStack() as stack:
        page, cookie = split_token(url)
        connections = [
            stack.enter_context(closing(connect_page(page, cookie=cookie))) for _ in range(count)
        ]
        first, *others = connections
        visitors = [Visitor(first, entity, labels), *map(Visitor, others)]
        time.sleep(SETTLE_S)
        first_bytes = sum(visitor.bytes for visitor in visitors) / count
        while True:
            before_s = time.perf_counter()
            before = [(one.updates, one.drawings, one.bytes) for one in visitors]
            time.sleep(1.0)
            share = 1.0 / (count * (time.perf_counter() - before_s))
            gained = [
                (one.updates - updates, one.drawings - drawings, one.bytes - size)
                for one, (updates, drawings, size) in zip(visitors, before, strict=True)
            ]
            updates, drawings, size = (share * sum(column) for column in zip(*gained, strict=True))
            second = Second(updates, drawings, size, first_bytes)
            sys.stdout.write(msgspec.json.encode(second).decode() + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    visit(sys.argv[1], int(sys.argv[2]), sys.argv[3], frozenset(sys.argv[4:]))
