"""TopicReader: messages of a topic, all or the newest at a rate, decoded or raw, and their age."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Generic, TypeAlias, TypeVar

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.network_protocols import Closable, Sample, SubscribingNetwork, Subscription

Value = TypeVar("Value")
Message = TypeVar("Message", bound=msgspec.Struct)
Read: TypeAlias = Callable[[Sample], Value]
"""Reads a message; raises MalformedPayload if it is of another type."""
Wish = TypeVar("Wish")
Opened = TypeVar("Opened", bound=Closable)


def read_as(kind: type[Message]) -> Read[Message]:
    """Make the function that decodes messages of a type."""
    return partial(_decode, kind)


def _decode(kind: type[Message], sample: Sample) -> Message:
    return decode(kind, sample.payload, sample.encoding)


def keep_raw(sample: Sample) -> Sample:
    """Return a message as it was received."""
    return sample


class TopicReader(Generic[Value]):
    """Messages of a subscription; those of another type are counted and left out.

    Attributes:
        last: Newest message that was decoded; None before the first.
        heard_s: Time of decoding it, at first of the creation [s of the clock].
        malformed: Messages of another type.
    """

    def __init__(
        self,
        subscription: Subscription,
        read: Read[Value],
        *,
        first: Iterable[Value] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Read nothing yet.

        Args:
            subscription: Closed with this.
            read: Reads a message.
            first: Messages that `take` returns before those of the subscription.
            clock: Wall time from any origin [s].
        """
        self._subscription, self._read, self._clock = subscription, read, clock
        self._first = [*first]
        self._due_s = -float("inf")
        self.last: Value | None = None
        self.heard_s = clock()
        self.malformed = 0

    def take(self) -> list[Value]:
        """Take all messages received, oldest first."""
        found, self._first = self._first, []
        for sample in self._subscription.take():
            self._add(sample, found)
        return found

    def newest(self, period_s: float = 0.0) -> Value | None:
        """Take all messages and read the last; None if there is none.

        Args:
            period_s: Least time between two messages that are returned; the others stay queued.
        """
        now_s = self._clock()
        sample = self._subscription.newest() if now_s >= self._due_s else None
        if sample is None:
            return None
        # From when it was due, as callers come at times of their own; unless that is long ago.
        due_s = self._due_s + period_s
        self._due_s = due_s if due_s > now_s else now_s + period_s
        found: list[Value] = []
        self._add(sample, found)
        return found[0] if found else None

    def is_silent(self, limit_s: float) -> bool:
        """Whether nothing was read for so long."""
        return self._clock() - self.heard_s > limit_s

    def close(self) -> None:
        """End the subscription."""
        self._subscription.close()

    def _add(self, sample: Sample, found: list[Value]) -> None:
        try:
            self.last = self._read(sample)
        except MalformedPayload:
            self.malformed += 1
            return
        self.heard_s = self._clock()
        found.append(self.last)


def read_topic(
    network: SubscribingNetwork,
    key: str,
    kind: type[Message],
    depth: int = 1,
    clock: Callable[[], float] = time.monotonic,
) -> TopicReader[Message]:
    """Subscribe to the messages of a type; see `TopicReader`.

    Args:
        network: Open session.
        key: Key expression.
        kind: Type of the messages.
        depth: Messages that wait; the newest are kept.
        clock: Wall time from any origin [s].
    """
    return TopicReader(network.subscribe(key, depth), read_as(kind), clock=clock)


class WantedTopics(Generic[Wish, Opened]):
    """What is subscribed for exactly the topics that are wanted now."""

    def __init__(self, subscribe: Callable[[str], Opened]) -> None:
        """Subscribe to nothing yet; the function subscribes to a key."""
        self._subscribe = subscribe
        self._opened: dict[Wish, tuple[str, Opened]] = {}

    def follow(self, wanted: Mapping[Wish, str]) -> None:
        """Close what is not wanted, or has another key; subscribe to the new keys."""
        for wish, (key, opened) in [*self._opened.items()]:
            if wanted.get(wish) != key:
                del self._opened[wish]
                opened.close()
        for wish, key in wanted.items():
            if wish not in self._opened:
                self._opened[wish] = key, self._subscribe(key)

    def __iter__(self) -> Iterator[tuple[Wish, Opened]]:
        """Iterate over what is subscribed, in the order of subscription."""
        for wish, (_, opened) in self._opened.items():
            yield wish, opened

    def close(self) -> None:
        """Close all."""
        self.follow({})
