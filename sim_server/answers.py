"""Answers already given, by request id: a retry gets the same answer and changes nothing twice."""

from collections import OrderedDict
from dataclasses import dataclass

from proto.bus import Call
from proto.catalog import SERVICES

KEPT = 4096


@dataclass(frozen=True)
class Answer:
    """A reply as it was sent."""

    payload: bytes
    encoding: str


class Answers:
    """The newest answers of services that change something."""

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[str, bytes], Answer] = OrderedDict()

    def known(self, call: Call) -> Answer | None:
        """Find the answer that this very request has had."""
        return self._answers.get((call.name, call.request_id)) if call.request_id else None

    def keep(self, call: Call, answer: Answer) -> None:
        """Remember an answer, and forget the oldest when there are many."""
        service = SERVICES.get(call.name)
        if not call.request_id or service is None or not service.is_mutating:
            return
        self._answers[call.name, call.request_id] = answer
        if len(self._answers) > KEPT:
            self._answers.popitem(last=False)
