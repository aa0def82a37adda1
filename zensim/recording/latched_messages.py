"""The last messages of latched topics, with which each file of a recording begins."""

from collections.abc import Hashable, Iterator
from typing import Final, Generic, Protocol, TypeVar

from zensim.proto.topic_catalog import TF_STATIC

SHARED_TOPIC: Final = f"/{TF_STATIC.suffix}"
"""Every agent publishes the transforms of its own robots there."""


class NamedTopic(Hashable, Protocol):
    """A topic with a name."""

    @property
    def name(self) -> str:
        """With the first slash."""


Topic = TypeVar("Topic", bound=NamedTopic)


class LatchedMessages(Generic[Topic]):
    """The last message of each topic; of the shared one, each that differs."""

    def __init__(self) -> None:
        self._payloads: dict[Topic, dict[bytes, None]] = {}

    def add(self, topic: Topic, payload: bytes) -> bool:
        """Keep a message; False if it is known, as a subscriber may get it twice."""
        known = self._payloads.setdefault(topic, {})
        if payload in known:
            return False
        if topic.name != SHARED_TOPIC:
            known.clear()
        known[payload] = None
        return True

    def list_at(self, log_ns: int, publish_ns: int) -> Iterator[tuple[Topic, int, int, bytes]]:
        """List the messages, with these times [ns]."""
        for topic, payloads in self._payloads.items():
            for payload in payloads:
                yield topic, log_ns, publish_ns, payload
