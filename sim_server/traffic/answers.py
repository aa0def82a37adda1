"""Answers already given, by request id: a retry gets the same answer and changes nothing twice."""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from zensim.proto.service_catalog import CLAIM_ENTITY, CLAIM_SHARE, SERVICES
from zensim.sim_server.durable import Told
from zensim.sim_server.traffic.calls import Call

KEPT = 4096
KEPT_BYTES = 32 << 20
PASSING = frozenset({CLAIM_ENTITY.name, CLAIM_SHARE.name})
"""Services whose answers mean nothing to another server."""


@dataclass(frozen=True)
class Answer:
    """A reply as it was sent."""

    payload: bytes
    encoding: str


class Answers:
    """The newest answers of services that change something."""

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[str, bytes], Answer] = OrderedDict()
        self._bytes = 0

    def known(self, call: Call) -> Answer | None:
        """Find the answer that this very request has had."""
        return self._answers.get((call.name, call.request_id)) if call.request_id else None

    def keep(self, call: Call, answer: Answer) -> tuple[tuple[str, bytes], ...]:
        """Remember an answer; forget the oldest when there are many, and say which."""
        if not call.request_id or not is_mutating(call.name):
            return ()
        self._add((call.name, call.request_id), answer)
        forgotten = []
        while len(self._answers) > KEPT or (self._bytes > KEPT_BYTES and len(self._answers) > 1):
            oldest = next(iter(self._answers))
            self._remove(oldest)
            forgotten.append(oldest)
        return tuple(forgotten)

    def forget(self, call: Call) -> None:
        """Forget an answer: what it told of has been taken back."""
        if (call.name, call.request_id) in self._answers:
            self._remove((call.name, call.request_id))

    def load(self, told: Iterable[Told]) -> None:
        """Remember what another server answered, oldest first."""
        for one in told:
            self._add((one.service, one.request_id), Answer(one.payload, one.encoding))

    def _add(self, key: tuple[str, bytes], answer: Answer) -> None:
        if key in self._answers:
            self._remove(key)
        self._answers[key] = answer
        self._bytes += len(answer.payload)

    def _remove(self, key: tuple[str, bytes]) -> None:
        self._bytes -= len(self._answers.pop(key).payload)


def is_mutating(name: str) -> bool:
    """Whether a service changes something."""
    service = SERVICES.get(name)
    return service is not None and service.is_mutating


def told(call: Call, answer: Answer) -> Told | None:
    """Say what a journal keeps of an answer; nothing when no retry could ask for it."""
    if not call.request_id or not is_mutating(call.name) or call.name in PASSING:
        return None
    return Told(call.name, call.request_id, answer.payload, answer.encoding)
