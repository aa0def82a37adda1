"""Topic: the newest message, all messages, and callbacks; typed by its message."""

import math
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from typing import TYPE_CHECKING, Generic

import msgspec
import numpy as np

from zensim.api.api_errors import Invalid, NotFound, Timeout
from zensim.api.argument_checks import check_range, check_whole
from zensim.api.call_deadline import limited
from zensim.api.world_access import Message, WorldAccess
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time

if TYPE_CHECKING:
    from zensim.spawner.client.topic_reader import TopicReader

FEED_DEPTH, LARGE_FEED_DEPTH = 256, 8
"""Messages that wait to be taken; images and clouds are large."""
POLL_S = 0.002
RATE_WINDOW = 32
"""Stamps over which the rate is measured."""
TIMEOUT_S = 10.0
MAX_QUEUE = 10_000


class TopicCallback(Generic[Message]):
    """A function that is called with messages, until `cancel`.

    Attributes:
        dropped: Messages that came while `queue` others waited.
    """

    def __init__(
        self, topic: "Topic[Message]", call: Callable[[Message], object], queue: int
    ) -> None:
        self.dropped = 0
        self.is_canceled = False
        self._topic = topic
        self._call = call
        self._queue: deque[Message] = deque()
        self._limit = queue

    def cancel(self) -> None:
        """End the subscription; may be repeated."""
        self.is_canceled = True
        self._queue.clear()

    def add(self, messages: list[Message]) -> None:
        """Queue messages; the oldest are dropped."""
        self._queue.extend(messages)
        while len(self._queue) > self._limit:
            self._queue.popleft()
            self.dropped += 1

    def take(self) -> list[tuple[int, str, "TopicCallback[Message]", Message]]:
        """Take what is queued, each with its stamp [ns] and key."""
        taken, self._queue = self._queue, deque()
        key = self._topic.key
        return [(find_stamp_ns(message), key, self, message) for message in taken]

    def run(self, message: Message) -> None:
        """Call the function."""
        self._call(message)


class Topic(Generic[Message]):
    """One topic; subscribed from the first use on.

    Attributes:
        key: Its key, such as `r1/scan`.
        kind: Class of its messages.
        kinds: Classes that may be published.
        settings: Of the sensor that publishes it; None for other topics.
        is_latched: Whether late subscribers get its last message.
        before_first_put: Refuses what must not be published.
    """

    def __init__(
        self,
        access: WorldAccess,
        dispatcher: "TopicDispatcher",
        key: str,
        kind: type[Message],
        on_callback: Callable[[], None] = lambda: None,
        on_subscribed: Callable[[], None] = lambda: None,
    ) -> None:
        self.key = key
        self.kind = kind
        self.kinds: tuple[type[msgspec.Struct], ...] = (kind,)
        self.settings: msgspec.Struct | None = None
        self.is_latched = False
        self.before_first_put: Callable[[type[msgspec.Struct]], None] | None = None
        self._on_callback = on_callback
        self._on_subscribed = on_subscribed
        self._access = access
        self._dispatcher = dispatcher
        self._feed: TopicReader[Message] | None = None
        self._lock = threading.RLock()
        self._latest: Message | None = None
        self._unread: deque[Message] = deque(maxlen=FEED_DEPTH)
        self._stamps_ns: deque[int] = deque(maxlen=RATE_WINDOW)
        self._callbacks: list[TopicCallback[Message]] = []
        self._dropped = 0

    @property
    def latest(self) -> Message | None:
        """The newest message, None before the first one; fields of numbers are arrays."""
        self.collect()
        return self._latest

    def newest(self) -> Message:
        """Return the newest message.

        Raises:
            NotFound: There was none yet.
        """
        if (latest := self.latest) is None:
            raise NotFound(
                f"no message on {self.key} yet",
                slug="no_message",
                hint="read() waits for one; check the key with 'zensim topic list'",
            )
        return latest

    @property
    def rate(self) -> float:
        """Messages per second of simulation time, over the last ones; 0 before the second."""
        self.collect()
        stamps = self._stamps_ns
        spent_ns = stamps[-1] - stamps[0] if len(stamps) > 1 else 0
        return (len(stamps) - 1) * NANOSECONDS / spent_ns if spent_ns > 0 else 0.0

    @property
    def next_due(self) -> float:
        """Simulation time [s] at which the next message is expected; infinite if unknown."""
        rate = self.rate
        return self._stamps_ns[-1] / NANOSECONDS + 1.0 / rate if rate else float("inf")

    @property
    def dropped(self) -> int:
        """Messages that callbacks did not get, because newer ones replaced them."""
        return self._dropped + sum(one.dropped for one in self._callbacks)

    def read(self, after: float | None = None, timeout_s: float = TIMEOUT_S) -> Message:
        """Wait for the next unread message.

        Args:
            after: Only messages stamped later than this simulation time [s].
            timeout_s: Wall time.

        Raises:
            Timeout: None came in time.
        """
        check_range("timeout_s", timeout_s, 0.0, math.inf)
        deadline = time.monotonic() + timeout_s
        while True:
            with limited(timeout_s):
                self.collect()
            while self._unread:
                message = self._unread.popleft()
                if after is None or find_stamp_ns(message) > after * NANOSECONDS:
                    return message
            if time.monotonic() >= deadline:
                raise Timeout(
                    f"no message on {self.key} within {timeout_s:g} s",
                    hint="in a paused world step it: run_for() or step()",
                )
            time.sleep(POLL_S)

    def on(self, call: Callable[[Message], object], queue: int = 1) -> TopicCallback[Message]:
        """Call a function with messages; with the last one of a latched topic at once.

        While the caller steps the world it is called in the caller's thread before the step
        returns, else in a thread of the simulation. An exception ends the subscription, and the
        next call of the simulation raises it.

        Args:
            call: Takes a message.
            queue: Messages that may wait; the oldest are dropped. 1 = only the newest.
        """
        if not callable(call):
            raise Invalid(f"{str(call)[:40]} cannot be called", hint="give a function")
        check_whole("queue", queue, 1, MAX_QUEUE)
        self.collect()
        callback = TopicCallback(self, call, queue)
        if self.is_latched and self._latest is not None:
            callback.add([self._latest])
        self._callbacks.append(callback)
        self._dispatcher.add(self)
        self._on_callback()
        return callback

    def put(self, message: msgspec.Struct) -> None:
        """Publish a message.

        Raises:
            Invalid: It has another class, or the simulation publishes this topic of a robot.
        """
        if not isinstance(message, self.kinds):
            names = " or ".join(kind.__name__ for kind in self.kinds)
            raise Invalid(
                f"{self.key} takes {names}, not {type(message).__name__}", slug="wrong_message"
            )
        if self.before_first_put is not None:
            self.before_first_put(type(message))
            self.before_first_put = None
        self._access.publish(self.key, message)

    def __iter__(self) -> Iterator[Message]:
        """Iterate over messages as they come, without end."""
        while True:
            yield self.read(timeout_s=float("inf"))

    async def __aiter__(self) -> AsyncIterator[Message]:
        """Iterate over messages as they come, without end."""
        import asyncio  # noqa: PLC0415  few programs are asynchronous

        while True:
            yield await asyncio.to_thread(self.read, timeout_s=float("inf"))

    def collect(self) -> list[TopicCallback[Message]]:
        """Take the messages received; return the callbacks that are not canceled."""
        with self._lock:
            if self._feed is None:
                depth = LARGE_FEED_DEPTH if _is_large(self.kind) else FEED_DEPTH
                self._feed = self._access.subscribe(self.key, self.kind, depth)
                self._on_subscribed()
            messages = [to_arrays(message) for message in self._feed.take()]
            for message in messages:
                self._stamps_ns.append(find_stamp_ns(message))
            self._unread.extend(messages)
            self._latest = messages[-1] if messages else self._latest
            self._drop_canceled()
            for callback in self._callbacks:
                callback.add(messages)
            return list(self._callbacks)

    def clear(self) -> None:
        """Drop what was received, as the state was replaced; what is latched stays."""
        self.collect()
        if not self.is_latched:
            self._unread.clear()
            self._stamps_ns.clear()
            self._latest = None

    def close(self) -> None:
        """End the subscription and all callbacks."""
        with self._lock:
            for callback in self._callbacks:
                callback.cancel()
            self._drop_canceled()
            if self._feed is not None:
                self._feed.close()
                self._feed = None

    def _drop_canceled(self) -> None:
        gone = [one for one in self._callbacks if one.is_canceled]
        self._dropped += sum(one.dropped for one in gone)
        self._callbacks = [one for one in self._callbacks if not one.is_canceled]

    def __repr__(self) -> str:
        """Write key and class of messages."""
        return f"Topic({self.key!r}, {self.kind.__name__})"


class TopicDispatcher:
    """Calls the callbacks of all topics, in order of stamp and key."""

    def __init__(self) -> None:
        self._topics: list[Topic[msgspec.Struct]] = []
        self._lock = threading.RLock()
        self._failure: BaseException | None = None

    @property
    def has_callbacks(self) -> bool:
        """Whether a topic has a callback."""
        return bool(self._topics)

    def add(self, topic: "Topic[Message]") -> None:
        """Call the callbacks of this topic, too."""
        if topic not in self._topics:
            self._topics.append(topic)  # type: ignore[arg-type]  # its messages are only passed on

    def dispatch(self) -> None:
        """Call callbacks with all messages received."""
        with self._lock:
            due = []
            for topic in self._topics[:]:
                callbacks = topic.collect()
                if not callbacks:
                    self._topics.remove(topic)
                due += [one for callback in callbacks for one in callback.take()]
            for _, _, callback, message in sorted(due, key=lambda one: one[:2]):
                self._run(callback, message)

    def raise_failure(self) -> None:
        """Raise what a callback has raised, once."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _run(self, callback: TopicCallback[msgspec.Struct], message: msgspec.Struct) -> None:
        if callback.is_canceled:
            return
        try:
            callback.run(message)
        except Exception as error:  # noqa: BLE001  the caller's next call raises it
            callback.cancel()
            self._failure = self._failure or error


def find_stamp_ns(message: msgspec.Struct) -> int:
    """Find the simulation time [ns] of a message; 0 if it has none."""
    header = getattr(message, "header", None)
    stamp = getattr(message if header is None else header, "stamp", None)
    return 0 if stamp is None else ns_from_time(stamp)


def to_arrays(message: Message) -> Message:
    """Replace sequences of numbers of a new message by arrays, in place."""
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if isinstance(value, tuple) and value and isinstance(value[0], float | int):
            array = np.array(value)
            array.flags.writeable = False
            msgspec.structs.force_setattr(message, name, array)
    return message


def _is_large(kind: type[msgspec.Struct]) -> bool:
    return "data" in kind.__struct_fields__ and "height" in kind.__struct_fields__
