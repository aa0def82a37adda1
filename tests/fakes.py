"""In-memory network and clock for tests."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from zensim.proto import memory_bus
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.keys import intersect
from zensim.proto.memory_bus import (
    MemoryCall,
    MemoryPendingCall,
    MemorySubscription,
    MemoryToken,
    MemoryTokenWatch,
)
from zensim.proto.network_protocols import Sample
from zensim.proto.token_thread import TokenThread

__all__ = [
    "CallList",
    "ManualClock",
    "MemoryBus",
    "MemoryCall",
    "MemoryPendingCall",
    "MemoryToken",
    "MemoryTokenWatch",
    "PublishedPayloads",
    "StandingClock",
]


class ManualClock:
    """A clock that advances only in `sleep`."""

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


class StandingClock:
    """The monotonic clock, which stands until it is let go: nothing ends by itself meanwhile."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self.stands = True

    def __call__(self) -> float:
        return self._began_s if self.stands else time.monotonic()


class MemoryBus(memory_bus.MemoryBus):
    """The product's network in memory, which keeps what tests look at."""

    def __init__(self) -> None:
        super().__init__()
        self.expected_keys: list[str] = []
        self.opened_sessions: list[MemoryBus] = []

    def expect_key(self, key: str) -> None:
        """Keep the key."""
        self.expected_keys.append(key)

    def open_session(self) -> "MemoryBus":
        """Open a session of another network, whose tokens and messages are told apart."""
        self.opened_sessions.append(MemoryBus())
        return self.opened_sessions[-1]

    def open_token_queue(self) -> TokenThread:  # type: ignore[override]
        return TokenThread(self.open_session)

    def subscribe_copying(self, key: str, depth: int, max_bytes: int = 0) -> MemorySubscription:
        return self.subscribe(key, depth, max_bytes)

    def ask(self, key: str, payload: bytes, attachment: bytes) -> list[Sample]:
        """Query as a ROS 2 client does."""
        call = self.query(key, payload, "", attachment)
        self.wait(call)
        return call.answers

    def has_subscriber(self, key: str) -> bool:
        """Whether a key has a subscriber."""
        return bool(self.find_subscriptions(key))

    @property
    def subscribed_keys(self) -> list[str]:
        """Keys of all subscriptions."""
        return [one.key for one in self.subscriptions]

    def is_served(self, key: str) -> bool:
        """Whether a key has a queryable."""
        return any(intersect(key, queue.key) for queue in self.queues)

    def put(self, key: str, payload: bytes, encoding: str = "", attachment: bytes = b"") -> None:
        """Publish bytes."""
        self.advertise(key, encoding).send(payload, attachment)

    def put_message(self, key: str, message: msgspec.Struct, format_: Format = Format.CDR) -> None:
        """Publish a message."""
        self.put(key, encode(message, format_), make_encoding(message, format_))


@dataclass
class CallList:
    """A queue of calls that a test fills."""

    calls: list[MemoryCall] = field(default_factory=list)

    def take(self) -> list[MemoryCall]:
        """Take all calls."""
        taken, self.calls = self.calls, []
        return taken


@dataclass
class PublishedPayloads:
    """A publisher with a subscriber, which keeps what was published."""

    is_matched: bool = True
    payloads: list[bytes] = field(default_factory=list)
    latched: bytes = b""

    def send(self, payload: bytes) -> None:
        """Publish."""
        self.payloads.append(payload)

    def reply_to_late_joiners(self, payload: Callable[[], bytes]) -> None:
        """Keep what a late subscriber would receive."""
        self.latched = payload()
