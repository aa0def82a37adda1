"""Order of messages by time, topic and content, so that equal runs give equal files."""

from collections.abc import Iterable
from typing import Final

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.recording.recorded_topics import RecordedMessage

HOLD_NS: Final = NANOSECONDS
"""Log time that a message waits for earlier ones of slower publishers."""
PERIOD_NS: Final = NANOSECONDS // 4
"""Log time between two releases: each sorts what is held."""


class MessageOrder:
    """Messages in the order of their log times; the order of arrival differs from run to run."""

    def __init__(self) -> None:
        self._held: list[RecordedMessage] = []
        self._newest_ns = 0
        self._released_ns = 0

    def add(self, batch: Iterable[RecordedMessage]) -> list[RecordedMessage]:
        """Hold messages; return those which no earlier one can follow, in order."""
        for message in batch:
            self._held.append(message)
            self._newest_ns = max(self._newest_ns, message[1])
        until_ns = self._newest_ns - HOLD_NS
        if until_ns < self._released_ns + PERIOD_NS:
            return []
        self._released_ns = until_ns
        due = sorted((one for one in self._held if one[1] <= until_ns), key=_rank)
        self._held = [one for one in self._held if one[1] > until_ns]
        return due

    def release(self) -> list[RecordedMessage]:
        """Return all that are held, in order: time ends, or begins anew."""
        due, self._held = sorted(self._held, key=_rank), []
        self._newest_ns = self._released_ns = 0
        return due


def _rank(message: RecordedMessage) -> tuple[int, str, bytes]:
    topic, log_ns, _, payload = message
    return log_ns, topic.name, payload
