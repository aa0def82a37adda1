"""The last messages of latched topics, with which each file of a recording begins."""

from collections.abc import Hashable, Iterator
from typing import Final, Generic, Protocol, TypeVar

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, make_encoding
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.topic_catalog import TF_STATIC

SHARED_TOPIC: Final = f"/{TF_STATIC.suffix}"
"""Every agent publishes the transforms of its own robots there."""
MAX_SHARED_BYTES: Final = 16 << 20
"""Most bytes of the messages of the shared topic; the oldest are forgotten."""
TRANSFORMS: Final = make_encoding(TFMessage, Format.CDR)


class NamedTopic(Hashable, Protocol):
    """A topic with a name."""

    @property
    def name(self) -> str:
        """Name with the first slash."""


Topic = TypeVar("Topic", bound=NamedTopic)


class LatchedMessages(Generic[Topic]):
    """The last message of each topic; of the shared one, the last with each child frame."""

    def __init__(self) -> None:
        self._payloads: dict[Topic, dict[bytes, frozenset[str]]] = {}

    def add(self, topic: Topic, payload: bytes) -> bool:
        """Keep a message; False if it is known, as a subscriber may get it twice."""
        known = self._payloads.setdefault(topic, {})
        if payload in known:
            return False
        if topic.name != SHARED_TOPIC:
            known.clear()
            known[payload] = frozenset()
            return True
        frames = find_child_frames(payload)
        for older in [one for one, replaced in known.items() if replaced <= frames]:
            del known[older]
        known[payload] = frames
        while len(known) > 1 and sum(map(len, known)) > MAX_SHARED_BYTES:
            del known[next(iter(known))]
        return True

    def list_at(self, log_ns: int, publish_ns: int) -> Iterator[tuple[Topic, int, int, bytes]]:
        """List the messages, with these times [ns]."""
        for topic, payloads in self._payloads.items():
            for payload in payloads:
                yield topic, log_ns, publish_ns, payload


def find_child_frames(payload: bytes) -> frozenset[str]:
    """Find the frames that a message of transforms places; none if it is malformed."""
    try:
        message = decode(TFMessage, payload, TRANSFORMS)
    except MalformedPayload:
        return frozenset()
    return frozenset(one.child_frame_id for one in message.transforms)
