"""Replies on their way out, in the order of answering; each leaves once what it tells is kept."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from zensim.sim_server.traffic.answers import Answer
from zensim.sim_server.traffic.calls import Call


@dataclass(frozen=True)
class Waiting:
    """A reply, and how far the journal must have come for it."""

    call: Call
    answer: Answer
    position: int


class Replies:
    """First in, first out."""

    def __init__(self, key_of: Callable[[str], str]) -> None:
        self._key_of = key_of
        self._waiting: deque[Waiting] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, waiting: Waiting) -> None:
        """Take a reply in."""
        self._waiting.append(waiting)

    def let_go(self, durable: int) -> None:
        """Send what may be known."""
        while self._waiting and self._waiting[0].position <= durable:
            self.send(self._waiting.popleft())

    def take_back(self) -> list[Waiting]:
        """Take all that nobody has been told yet."""
        taken, self._waiting = list(self._waiting), deque()
        return taken

    def send(self, waiting: Waiting) -> None:
        """Send one at once."""
        call, answer = waiting.call, waiting.answer
        call.reply(answer.payload, answer.encoding, self._key_of(call.name))
