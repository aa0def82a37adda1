"""The last messages of latched topics, with which each file of a recording begins."""

from collections.abc import Iterator
from typing import Final

from zensim.proto.topic_catalog import TF_STATIC
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic

SHARED_TOPIC: Final = f"/{TF_STATIC.suffix}"
"""Every agent publishes the transforms of its own robots there."""


class LatchedMessages:
    """The last message of each topic; of the shared one, each that differs."""

    def __init__(self) -> None:
        self._payloads: dict[RecordedTopic, dict[bytes, None]] = {}

    def add(self, topic: RecordedTopic, payload: bytes) -> bool:
        """Keep a message; False if it is known, as a subscriber may get it twice."""
        known = self._payloads.setdefault(topic, {})
        if payload in known:
            return False
        if topic.name != SHARED_TOPIC:
            known.clear()
        known[payload] = None
        return True

    def list_at(self, log_ns: int, publish_ns: int) -> Iterator[RecordedMessage]:
        """List the messages, with these times [ns]."""
        for topic, payloads in self._payloads.items():
            for payload in payloads:
                yield topic, log_ns, publish_ns, payload
