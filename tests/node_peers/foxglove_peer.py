"""A client of the Foxglove WebSocket protocol that shares no code with zensim, in Node."""

import json
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from tests.node_peers.node_packages import FOLDER, start_script

if TYPE_CHECKING:
    import subprocess

Event = dict[str, Any]
SUBPROTOCOL = "foxglove.websocket.v1"
WITHIN_S = 60.0


class FoxglovePeer:
    """Sends commands to the program, and keeps its events."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.events: list[Event] = []
        threading.Thread(target=self._read, daemon=True).start()

    def do(self, action: str, **fields: object) -> None:
        """Give a command."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": action, **fields}) + "\n")
        self._process.stdin.flush()

    def wait(
        self,
        event: str,
        accept: Callable[[Event], bool] = lambda _: True,
        within_s: float = WITHIN_S,
    ) -> Event:
        """Wait for an event, also one that came before and was not waited for; take it."""
        deadline = time.monotonic() + within_s
        while True:
            for one in self.events:
                if one["event"] == event and accept(one):
                    self.events.remove(one)
                    return one
            left = deadline - time.monotonic()
            assert left > 0, f"no {event} within {within_s:g} s; there were {self._describe()}"
            try:
                self.events.append(json.loads(self._lines.get(timeout=left)))
            except queue.Empty:
                continue

    def drain(self) -> list[Event]:
        """Take all events that have come."""
        while not self._lines.empty():
            self.events.append(json.loads(self._lines.get()))
        found, self.events = self.events, []
        return found

    def wait_for_topics(self, *topics: str) -> None:
        """Wait until these topics have been advertised."""
        missing = set(topics)
        while missing:
            missing -= set(self.wait("advertise")["topics"])

    def subscribe(self, topic: str) -> Event:
        """Subscribe; return the first message."""
        self.do("subscribe", topic=topic)
        return self.wait("message", lambda one: one["topic"] == topic)

    def _describe(self) -> list[str]:
        return [json.dumps(one)[:200] for one in self.events[-5:]]

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)


@contextmanager
def connect_peer(
    url: str, *, subprotocol: str = SUBPROTOCOL, origin: str = ""
) -> Iterator[FoxglovePeer]:
    """Connect the program to a server; it is ended with the context."""
    arguments = (url, subprotocol, *((origin,) if origin else ()))
    with start_script(FOLDER / "foxglove_client.cjs", *arguments) as process:
        yield FoxglovePeer(process)
