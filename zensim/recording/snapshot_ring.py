"""The messages of the last seconds, kept in memory until they are written."""

from collections import deque

from zensim.recording.latched_messages import LatchedMessages
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic
from zensim.recording.written_topics import OVERHEAD_BYTES


class SnapshotRing:
    """Messages of a span of log time, and the last one of each latched topic."""

    def __init__(self, span_ns: int, max_bytes: int) -> None:
        """Create an empty ring.

        Args:
            span_ns: Of log time; 0 = no limit.
            max_bytes: Memory of the messages; the oldest are removed.
        """
        self._span_ns = span_ns
        self._max_bytes = max_bytes
        self._messages: deque[RecordedMessage] = deque()
        self._latched: LatchedMessages[RecordedTopic] = LatchedMessages()
        self._bytes = 0

    def __len__(self) -> int:
        """Count the messages, without latched ones."""
        return len(self._messages)

    def add(self, message: RecordedMessage) -> None:
        """Add a message, and remove those that are too old."""
        topic, log_ns, _, payload = message
        if topic.is_latched:
            self._latched.add(topic, payload)
            return
        self._messages.append(message)
        self._bytes += OVERHEAD_BYTES + len(payload)
        while self._messages and self._is_too_much(log_ns):
            self._bytes -= OVERHEAD_BYTES + len(self._messages.popleft()[3])

    def take(self) -> list[RecordedMessage]:
        """Remove all messages, and return them after the latched ones, which remain."""
        messages = list(self._messages)
        self._messages.clear()
        self._bytes = 0
        if not messages:
            return []
        first_ns, publish_ns = messages[0][1:3]
        return [*self._latched.list_at(first_ns, publish_ns), *messages]

    def _is_too_much(self, newest_ns: int) -> bool:
        if self._bytes > self._max_bytes:
            return True
        return bool(self._span_ns) and self._messages[0][1] < newest_ns - self._span_ns
