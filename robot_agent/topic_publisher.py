"""Publisher of one topic of one robot that encodes only when matched, and replies with the last value."""

from collections.abc import Callable
from typing import TypeAlias

import msgspec

from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.topic_endpoints import TopicFactory

QUERY_DEPTH = 64
MakePayload: TypeAlias = Callable[[], msgspec.Struct | bytes | None]
"""Makes the last value, as a message or as its CDR bytes; None while there is none."""


class LazyTopicPublisher:
    """A topic whose value is made only when it is wanted."""

    def __init__(
        self,
        faces: TopicFactory,
        topic: Topic,
        value: MakePayload,
        *,
        is_shared: bool = False,
    ) -> None:
        """Declare the topic.

        Args:
            faces: Where.
            topic: What to put on, and to be asked for.
            value: What is told.
            is_shared: Whether others tell this topic too, so that who asks has to ask all.
        """
        self._key = topic.key
        self._encoding = make_encoding(topic.kind, Format.CDR)
        self._value = value
        self._publisher = faces.publisher(topic)
        self._queries = faces.serve(topic.key, QUERY_DEPTH, is_complete=not is_shared)

    def publish(self) -> None:
        """Put the value if anybody listens."""
        self._publisher.publish(self._payload)

    def announce(self) -> None:
        """Put the value now, and later each time that somebody begins to listen."""
        self._publisher.publish_to_new(self._payload)

    def answer(self) -> None:
        """Tell the value to everybody who has asked."""
        for call in self._queries.take():
            payload = self._payload()
            if payload is None:
                call.drop()
            else:
                call.reply(payload, self._encoding, self._key)
        self._publisher.reply_to_late_joiners(self._payload)

    def close(self) -> None:
        """Withdraw the topic."""
        self._publisher.close()
        self._queries.close()

    def _payload(self) -> bytes | None:
        value = self._value()
        return encode(value, Format.CDR) if isinstance(value, msgspec.Struct) else value
