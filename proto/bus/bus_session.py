"""A session of Zenoh, and what it declares, asks and calls."""

import os
import threading
import time
import uuid
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cached_property, partial
from itertools import cycle
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeVar, cast

import msgspec
import zenoh
from zenoh.handlers import Callback, FifoChannel, RingChannel

from zensim.proto import keys
from zensim.proto.bus.bus_config import MAX_MESSAGE_BYTES, BusConfig
from zensim.proto.bus.bus_errors import EndpointUnreachable, JoinRefused, NoServer, SessionClosed
from zensim.proto.bus.join_attempt import ask_for_refusal
from zensim.proto.bus.session_opening import OPEN_TIMEOUTS_S, open_session
from zensim.proto.bus_traffic import BusTraffic
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.near_names import name_choices
from zensim.proto.network_protocols import MAX_REQUEST_BYTES, MAX_REQUEST_ID_BYTES, Sample, Stamp
from zensim.proto.newest_messages import NewestMessages
from zensim.proto.renewed_session import RENEW_AFTER, RenewedSession
from zensim.proto.reply_sender import REPLY_BYTES, ReplySender, Send
from zensim.proto.service_catalog import (
    SPAWN_ENTITIES,
    SPAWN_ENTITY,
    Request,
    Response,
    Service,
    require_ok,
)
from zensim.proto.sha256 import sha256
from zensim.proto.token_thread import TokenThread

if TYPE_CHECKING:
    from zenoh.handlers import Handler

RUNTIME_VARIABLE: Final = "ZENOH_RUNTIME"
"""Read by Zenoh when the first session of a process is opened."""
LEAST_ATTEMPT_S: Final = 0.05
"""Least time between attempts: a join token is refused at once where nothing listens."""
MOVE_TIMEOUT_S, MOVE_POLL_S = 0.2, 0.001
"""Patience with subscribers of a moved publisher: how long, and how often it looks [s]."""
Item = TypeVar("Item")
Item_co = TypeVar("Item_co", covariant=True)
MAX_COPIED_BYTES: Final = 32 << 20
"""Most bytes of payloads that a subscription of `subscribe_copying` keeps."""
LATEST: Final = 1
"""Subscription depth that keeps only the newest sample, for one publisher on one key."""
Message = TypeVar("Message", bound=msgspec.Struct)
MAX_TAKEN: Final = 256
"""Requests that one `take` returns, so that it takes about a millisecond at most."""
EMPTY_PAYLOAD: Final = zenoh.ZBytes(b"")
RETRY_AFTER_S: Final = (0.01, 0.03, 0.1, 0.2, 0.0)
"""A query may return nothing after a reconnect (zenoh#2767): retry with the same id."""
SPAWNS: Final = frozenset({SPAWN_ENTITY.name, SPAWN_ENTITIES.name})
LIST_WORLDS_S: Final = 0.3
MAX_UNREAD_BYTES: Final = 4096
"""Most bytes of a request that is refused unread which are copied to see its format."""
MAX_UNANSWERED: Final = 64
"""Spawns that got no reply in time, and whose ids are kept for a retry."""
MAX_EXPECTED_KEYS: Final = 4096
"""Keys that a session declares for what it receives: 0.2 ms each, and memory of the router."""
NEVER: Final = 1 << 62
"""A router keeps no key of its own session."""
MAX_LINK_EVENTS: Final = 65536
"""Links that opened or closed, and were not taken yet."""
MAX_REPLIES: Final = 16384
"""Queue length for the replies to a query; a ring channel loses replies when the query ends."""
LEAST_TIMEOUT_S: Final = 0.01
"""Least timeout of a retried query, even if the time of its call is over."""


def receive_in_one_thread() -> None:
    """Let one thread receive for all sessions of this process; call it before the first one.

    Two of them take each other's work, which wakes both: 30 % more CPU time of a recorder.
    """
    os.environ.setdefault(RUNTIME_VARIABLE, "(rx: (worker_threads: 1))")


class HeldMessages:
    """Messages of one thread that leave right after one another.

    A session sends each message in a packet of its own, unless the next one comes while the packet
    is written: a message between two computations costs sender, router and receiver a wake-up.
    """

    def __init__(self) -> None:
        self._thread = 0
        """Thread whose messages are held; 0 = none."""
        self._waiting: list[Callable[[], None]] = []

    @property
    def is_holding(self) -> bool:
        """Whether a message of this thread is held."""
        return self._thread != 0 and self._thread == threading.get_ident()

    def add(self, put: Callable[[], None]) -> None:
        """Hold what sends a message."""
        self._waiting.append(put)

    def send(self) -> None:
        """Send what is held."""
        waiting, self._waiting = self._waiting, []
        for put in waiting:
            put()

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Hold the messages of this thread until the block ends; blocks do not nest."""
        self._thread = threading.get_ident()
        try:
            yield
        finally:
            self._thread = 0
            self.send()


def to_sample(sample: zenoh.Sample) -> Sample:
    """Convert a Zenoh sample."""
    return copy_sample(sample, sample.payload)


def copy_sample(sample: zenoh.Sample, payload: zenoh.ZBytes) -> Sample:
    """Copy a message whose payload was read already."""
    attachment = sample.attachment
    return Sample(
        str(sample.key_expr),
        payload.to_bytes(),
        str(sample.encoding),
        attachment.to_bytes() if attachment else b"",
    )


def to_key_expression(key: str) -> zenoh.KeyExpr:
    """Check a key or pattern.

    Raises:
        ValueError: It is not a valid key expression of Zenoh.
    """
    try:
        canonical: zenoh.KeyExpr = zenoh.KeyExpr.autocanonize(key)
    except zenoh.ZError as error:
        raise ValueError(f"key {key[:80]!r} is not valid; use names joined by '/'") from error
    return canonical


class BusPublisher:
    """Publisher on one key. Never blocks: a congested network drops messages.

    It declares nothing, so that a silent key costs the network nothing: a router compares the key
    of each message with all declared ones. `Session.declare_keyexpr` would not help: it stays in
    the session.
    """

    def __init__(self, put: Callable[..., None], traffic: BusTraffic, held: HeldMessages) -> None:
        self._put, self._traffic, self._held = put, traffic, held

    @property
    def is_matched(self) -> bool:
        """Whether there may be a subscriber; nothing says otherwise."""
        return True

    def send(self, payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
        """Publish a message; subscribers drop a second one with the same timestamp."""
        self._traffic.sent += 1
        self._traffic.sent_bytes += len(payload)
        if self._held.is_holding:
            self._held.add(partial(self._send_now, payload, attachment, stamp))
        else:
            self._send_now(payload, attachment, stamp)

    def _send_now(self, payload: bytes, attachment: bytes, stamp: Stamp | None) -> None:
        # Each argument costs a tenth of the put.
        if stamp is not None:
            self._put(
                payload, attachment=attachment or None, timestamp=cast("zenoh.Timestamp", stamp)
            )
        elif attachment:
            self._put(payload, attachment=attachment)
        else:
            self._put(payload)

    def close(self) -> None:
        """Do nothing: nothing is declared."""


class DeclaredPublisher(BusPublisher):
    """Publisher on a key that the network knows of."""

    def __init__(
        self,
        declare: Callable[[zenoh.Session], zenoh.Publisher],
        names: "RenewedSession[zenoh.Session]",
        traffic: BusTraffic,
        held: HeldMessages,
    ) -> None:
        self._declare = declare
        self._names = names
        self._publisher = names.declare(self, declare)
        super().__init__(self._publisher.put, traffic, held)
        self._changes: zenoh.MatchingListener[Handler[zenoh.MatchingStatus]] | None = None
        self._was_matched = False

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        if self._changes is None:
            # A query of the status costs ten times as much as a listener.
            self._changes = self._publisher.declare_matching_listener(RingChannel(1))
            self._was_matched = is_matched_by_any(self._publisher)
        while (change := self._changes.try_recv()) is not None:
            self._was_matched = change.matching
        return self._was_matched

    def move(self, session: zenoh.Session) -> object:
        """See `Declaration`; what is sent meanwhile leaves by one of both sessions."""
        before = self._publisher, self._changes
        publisher = self._declare(session)
        if self._changes is not None:
            changes = publisher.declare_matching_listener(RingChannel(1))
            deadline_s = time.monotonic() + MOVE_TIMEOUT_S
            while self._was_matched and not is_matched_by_any(publisher):
                if time.monotonic() > deadline_s:
                    self._was_matched = False
                time.sleep(MOVE_POLL_S)
            self._changes = changes
        self._publisher, self._put = publisher, publisher.put
        return before

    def close(self) -> None:
        """Undeclare the publisher."""
        if self._held.is_holding:
            self._held.send()
        if self._changes is not None:
            self._changes.undeclare()
        self._publisher.undeclare()
        self._names.remove(self)


def is_matched_by_any(publisher: zenoh.Publisher) -> bool:
    """Whether a publisher has subscribers."""
    # The stub says bool; it is a MatchingStatus.
    return bool(publisher.matching_status.matching)  # type: ignore[attr-defined]


class BusSubscriberWatch:
    """A session that says which key expressions have subscribers, at little cost to the router.

    Its publishers join those on the patterns, so that the router knows of these only; which
    subscribers match them the session knows itself.
    """

    def __init__(
        self,
        session: zenoh.Session,
        patterns: Iterable[str],
        *,
        traffic: BusTraffic,
        held: HeldMessages,
        close: Callable[[], None],
    ) -> None:
        self._session = session
        self._standing = [session.declare_publisher(to_key_expression(one)) for one in patterns]
        self._traffic = traffic
        self._held = held
        self.close = close
        """Closes the session."""

    def has_subscribers(self, key: str) -> bool:
        """Whether a key expression has a subscriber."""
        tried = self._session.declare_publisher(key)
        is_matched = is_matched_by_any(tried)
        tried.undeclare()
        return is_matched

    def advertise(self, key: str, encoding: str) -> BusPublisher:
        """Make a publisher that declares nothing."""
        put = partial(
            self._session.put,
            zenoh.KeyExpr(key),
            encoding=zenoh.Encoding(encoding),
            congestion_control=zenoh.CongestionControl.DROP,
        )
        return BusPublisher(put, self._traffic, self._held)


class ArrivalSignal:
    """Ends the pause of a loop when messages or requests arrive at its session.

    It costs a call of Python in the thread that receives, less than two polls that find nothing.
    """

    def __init__(self) -> None:
        # A lock is the cheapest that a thread can wait for. It is held until something arrives.
        self._lock = threading.Lock()
        self._lock.acquire()
        self._requests: deque[None] = deque(maxlen=1)

    def make_queue(self, depth: int, *, is_of_requests: bool) -> "ArrivedQueue[Item]":
        """Make a queue whose arrivals are signalled; requests are queries and changed tokens."""
        return ArrivedQueue(depth, self._lock, self._requests if is_of_requests else None)

    def take_requests(self) -> bool:
        """Whether there were queries or changed tokens since the last call."""
        if not self._requests:  # to clear it anyway could lose a request that arrives now
            return False
        self._requests.clear()
        return True

    def wait(self, timeout_s: float) -> None:
        """Pause until something arrives, or arrived since the last call, or time is over."""
        self._lock.acquire(timeout=timeout_s)


class ArrivedQueue(Generic[Item]):
    """The newest of what arrived; each is signalled."""

    def __init__(
        self, depth: int, lock: threading.Lock, requests: "deque[None] | None" = None
    ) -> None:
        """See `ArrivalSignal.make_queue`."""
        self._items: deque[Item] = deque(maxlen=depth)
        self.add = _make_adder(self._items.append, lock, requests)
        """Adds one, in any thread; the oldest is dropped where there is no room."""

    def try_recv(self) -> Item | None:
        """Take the oldest; None if there is none. One thread may call it."""
        return self._items.popleft() if self._items else None


def _make_adder(
    append: Callable[[Item], None], lock: threading.Lock, requests: "deque[None] | None"
) -> Callable[[Item], None]:
    """Make one function of few calls: it is called for each message, in a cold cache."""
    is_locked, release = lock.locked, lock.release

    def add(item: Item) -> None:
        append(item)
        if requests is not None:
            requests.append(None)
        if is_locked():
            try:
                release()
            except RuntimeError:  # another thread was first
                return

    return add


class ItemQueue(Protocol[Item_co]):
    """A queue of Zenoh, or `ArrivedQueue`."""

    def try_recv(self) -> Item_co | None:
        """Take the oldest; None if there is none."""


QueueHandler = tuple[Callable[[Item], object], ItemQueue[Item]]
"""Handler that Zenoh declares: what is called with each message, and the queue."""


def make_queue(
    depth: int, signal: ArrivalSignal | None, *, is_of_requests: bool = False
) -> QueueHandler[Item]:
    """Make the queue of a declaration, which signals what arrives, or which is polled."""
    if signal is None:
        return cast("QueueHandler[Item]", RingChannel(depth))
    queue: ArrivedQueue[Item] = signal.make_queue(depth, is_of_requests=is_of_requests)
    return Callback(queue.add, indirect=False), queue


class ReceivedSamples(Protocol):
    """Messages of a subscription that wait to be taken."""

    def take(self) -> list[Sample]:
        """Take all messages, oldest first."""

    def take_payloads(self) -> list[bytes]:
        """Take the bytes of all messages, oldest first."""

    def newest(self) -> Sample | None:
        """Take all messages and return the last."""


class QueuedSamples:
    """Messages in a queue of limited length; they are copied when they are taken."""

    def __init__(self, queue: ItemQueue[zenoh.Sample], max_bytes: int) -> None:
        """Read a queue; messages of more than `max_bytes` are dropped."""
        self._queue, self._max_bytes = queue, max_bytes

    def take(self) -> list[Sample]:
        """See `ReceivedSamples`."""
        found, receive, max_bytes = [], self._queue.try_recv, self._max_bytes
        while (sample := receive()) is not None:
            payload = sample.payload  # a copy of a reference, which takes a tenth of the time
            if len(payload) <= max_bytes:  # before it is copied
                found.append(copy_sample(sample, payload))
        return found

    def take_payloads(self) -> list[bytes]:
        """See `ReceivedSamples`; at half the cost of `take`."""
        found, receive = [], self._queue.try_recv
        while (sample := receive()) is not None:
            if len(sample.payload) <= self._max_bytes:
                found.append(sample.payload.to_bytes())
        return found

    def newest(self) -> Sample | None:
        """See `ReceivedSamples`."""
        last, receive = None, self._queue.try_recv
        while (sample := receive()) is not None:
            if len(sample.payload) <= self._max_bytes:
                last = sample
        return None if last is None else to_sample(last)


class BusSubscription:
    """Subscription on a key expression; the oldest messages are dropped where there is no room."""

    def __init__(
        self, subscriber: "zenoh.Subscriber[Any]", samples: ReceivedSamples, traffic: BusTraffic
    ) -> None:
        self._subscriber = subscriber
        self._samples = samples
        self._traffic = traffic

    def take(self) -> list[Sample]:
        """Take all messages, oldest first."""
        if found := self._samples.take():
            self._traffic.received += len(found)
            self._traffic.received_bytes += sum([len(one.payload) for one in found])
        return found

    def take_payloads(self) -> list[bytes]:
        """Take the bytes of all messages, oldest first, at no more cost than `take`."""
        if found := self._samples.take_payloads():
            self._traffic.received += len(found)
            self._traffic.received_bytes += sum(map(len, found))
        return found

    def newest(self) -> Sample | None:
        """Take all messages and return the last."""
        if (last := self._samples.newest()) is not None:
            self._traffic.received += 1
            self._traffic.received_bytes += len(last.payload)
        return last

    def close(self) -> None:
        """Undeclare the subscription."""
        self._subscriber.undeclare()


class CopiedSamples:
    """Messages that are copied as they come; beyond its limits the oldest are dropped.

    A Zenoh sample that waits keeps the whole buffer that it was received in, up to 64 KiB.
    """

    def __init__(self, max_count: int, max_bytes: int) -> None:
        self.dropped = 0
        """Messages that were dropped for newer ones."""
        self._max_count = max_count
        self._max_bytes = max_bytes
        self._samples: deque[Sample] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    def add(self, sample: Sample) -> None:
        """Add a message; the newest is kept, whatever its size."""
        with self._lock:
            self._samples.append(sample)
            self._bytes += len(sample.payload)
            while len(self._samples) > 1 and (
                self._bytes > self._max_bytes or len(self._samples) > self._max_count
            ):
                self._bytes -= len(self._samples.popleft().payload)
                self.dropped += 1

    def take(self) -> list[Sample]:
        """Take all messages, oldest first."""
        with self._lock:
            taken, self._bytes = list(self._samples), 0
            self._samples.clear()
        return taken

    def take_payloads(self) -> list[bytes]:
        """See `ReceivedSamples`."""
        return [one.payload for one in self.take()]

    def newest(self) -> Sample | None:
        """See `ReceivedSamples`."""
        return next(reversed(self.take()), None)


class BusReceiver:
    """Subscription of a caller that waits for each message."""

    def __init__(
        self, subscriber: "zenoh.Subscriber[None]", queue: "SimpleQueue[zenoh.Sample]"
    ) -> None:
        self._subscriber = subscriber
        self._queue = queue

    def wait(self, timeout_s: float) -> tuple[bytes, bytes] | None:
        """Wait for the next message: payload and attachment; None if there is none in time."""
        try:
            sample = self._queue.get(timeout=max(0.0, timeout_s))
        except Empty:
            return None
        # The texts of key and encoding would cost as much again.
        return sample.payload.to_bytes(), sample.attachment.to_bytes() if sample.attachment else b""

    def close(self) -> None:
        """Undeclare the subscription."""
        self._subscriber.undeclare()


class BusQuery:
    """A query that waits for its reply. Replies leave from other threads and never block."""

    def __init__(self, query: zenoh.Query, sender: ReplySender, traffic: BusTraffic) -> None:
        self._query = query
        self._sender = sender
        self._traffic = traffic
        self._has_replies = False
        self.key = str(query.key_expr)
        source = query.source_info
        self.user = keys.parse_user(self.key)
        self.session = "" if source is None else str(source.source_id.zid)
        self.client = self.user or self.session

    # The rest is read when it is needed: a query that is dropped unread should cost little.
    @cached_property
    def encoding(self) -> str:
        """Zenoh Encoding; empty if there is none."""
        encoding = self._query.encoding
        return str(encoding) if encoding else ""

    @cached_property
    def size(self) -> int:
        """Bytes of the request as received."""
        return len(self._query.payload or EMPTY_PAYLOAD)

    @cached_property
    def payload(self) -> bytes:
        """Bytes of the request; empty if it is too large, as it is refused by its size."""
        payload = self._query.payload
        self._traffic.received_bytes += self.size
        return payload.to_bytes() if payload and self.size <= MAX_REQUEST_BYTES else b""

    @property
    def start(self) -> bytes:
        """First byte of the request; empty if it is long and was refused unread."""
        is_read = "payload" in self.__dict__
        return self.payload[:1] if is_read or self.size <= MAX_UNREAD_BYTES else b""

    @cached_property
    def request_id(self) -> bytes:
        """Attachment, cut where it is too long for an id; differs from that of other users."""
        attachment = self._query.attachment
        given = attachment.to_bytes()[: MAX_REQUEST_ID_BYTES + 1] if attachment else b""
        if not (self.user and given) or len(given) > MAX_REQUEST_ID_BYTES:
            return given
        return sha256(b"%s/%s" % (self.user.encode(), given)).digest()

    @property
    def name(self) -> str:
        """Service name: the last chunk of the key."""
        return keys.last_chunk(self.key)

    def read(self, kind: type[Message]) -> Message:
        """Decode the request.

        Raises:
            MalformedPayload: The bytes are not that message.
        """
        return decode(kind, self.payload, self.encoding)

    def covers(self, key: str) -> bool:
        """Whether the queried key expression includes the key."""
        return bool(zenoh.KeyExpr(self.key).intersects(key))

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        """Reply once and finish the query; give `key` if the queried one is a pattern."""
        reply = partial(
            self._query.reply,
            key or self.key,
            payload,
            encoding=encoding,
            attachment=attachment or None,
        )
        self._send(len(payload), partial(self._finish_with, (reply,)))

    def reply_each(self, replies: Iterable[tuple[str, bytes]], encoding: str) -> None:
        """Reply with several values, each on its own key, and finish the query."""
        values = tuple(replies)
        sends = [
            partial(self._query.reply, key, payload, encoding=encoding) for key, payload in values
        ]
        size = sum(len(payload) for _, payload in values)
        self._send(size, partial(self._finish_with, sends))

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        """Send one reply of several, if the query accepts its key; `drop` finishes the query."""
        self._has_replies = True
        reply = partial(
            self._query.reply,
            key,
            payload,
            encoding=encoding,
            attachment=attachment,
            timestamp=cast("zenoh.Timestamp", stamp),
        )
        self._send(len(payload), partial(_send_if_accepted, reply), lambda: None)

    def drop(self) -> None:
        """Finish the query."""
        if self._has_replies:
            self._send(0, self._query.drop)  # after them
        else:
            self._sender.finish(self._query.drop)

    def _send(self, size: int, send: Send, finish: Send | None = None) -> None:
        self._traffic.sent += 1
        self._traffic.sent_bytes += size
        self._sender.send(self.client, size + REPLY_BYTES, send, finish or self._query.drop)

    def _finish_with(self, replies: Iterable[Callable[[], None]]) -> None:
        with self._query:
            for reply in replies:
                _send_if_accepted(reply)


def _send_if_accepted(reply: Callable[[], None]) -> None:
    """Send a reply, unless its key does not match or its link is closed."""
    with suppress(zenoh.ZError):
        reply()


class BusQueryQueue:
    """Queue of queries on a key expression; a full queue drops the oldest without a reply."""

    def __init__(
        self,
        queryable: "zenoh.Queryable[ItemQueue[zenoh.Query]]",
        sender: ReplySender,
        traffic: BusTraffic,
    ) -> None:
        self._queryable = queryable
        self._queue = queryable.handler
        self._sender = sender
        self._traffic = traffic

    def take(self) -> list[BusQuery]:
        """Take queued queries, oldest first, `MAX_TAKEN` at most; none while replies pile up."""
        calls: list[BusQuery] = []
        if self._sender.is_full:
            return calls
        while len(calls) < MAX_TAKEN and (query := self._queue.try_recv()) is not None:
            calls.append(BusQuery(query, self._sender, self._traffic))
        self._traffic.received += len(calls)
        return calls

    def close(self) -> None:
        """Undeclare the queryable."""
        self._queryable.undeclare()


class LivelinessToken:
    """Liveliness token of this process, until it is closed or the process ends."""

    def __init__(self, key: str, names: "RenewedSession[zenoh.Session]") -> None:
        self._key = key
        self._names = names
        self._token = names.declare(self, self._declare)

    def _declare(self, session: zenoh.Session) -> zenoh.LivelinessToken:
        return session.liveliness().declare_token(self._key)

    def move(self, session: zenoh.Session) -> object:
        """See `Declaration`; nobody sees it go, and some see it come again."""
        before, self._token = self._token, self._declare(session)
        return before

    def close(self) -> None:
        """Undeclare the token."""
        self._token.undeclare()
        self._names.remove(self)


class LivelinessWatch:
    """Changes of liveliness tokens."""

    def __init__(self, subscriber: "zenoh.Subscriber[ItemQueue[zenoh.Sample]]") -> None:
        self._subscriber = subscriber
        self._queue = subscriber.handler

    def take(self) -> list[tuple[str, bool]]:
        """Take all queued changes: key, and whether it is alive."""
        changes = []
        while (sample := self._queue.try_recv()) is not None:
            changes.append((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))
        return changes

    def close(self) -> None:
        """Undeclare the subscription."""
        self._subscriber.undeclare()


class LinkWatch:
    """Links of other sessions to this one, as they open and close."""

    def __init__(self, listener: "zenoh.LinkEventsListener[Handler[zenoh.LinkEvent]]") -> None:
        self._listener = listener

    def take(self) -> list[tuple[str, str, bool]]:
        """Take all queued changes: session, its address, and whether the link is open."""
        changes = []
        while (event := self._listener.try_recv()) is not None:
            link = event.link
            # What follows the address is not a part of a key.
            address = str(link.dst).partition("?")[0].partition("#")[0]
            changes.append((str(link.zid), address, event.kind == zenoh.SampleKind.PUT))
        return changes


class PendingBusCall(Generic[Response]):
    """A service call whose reply is polled for; it never blocks."""

    def __init__(
        self,
        query: "Callable[[], Handler[zenoh.Reply]]",
        read: Callable[[Sample], Response],
        fail: Callable[[type[Exception]], Exception],
    ) -> None:
        """Query for the first time.

        Args:
            query: Sends the request; the same each time, with the same id.
            read: Reads the response from the reply.
            fail: Makes the error of a call without a reply: `TimeoutError` or `NoServer`.
        """
        self._query, self._read, self._fail = query, read, fail
        self._pauses = iter(RETRY_AFTER_S)
        self._retry_s = 0.0
        self._replies: Handler[zenoh.Reply] | None = query()

    def poll(self) -> Response | None:
        """Return the response; None while there is none yet.

        Raises:
            ServiceError: See `Bus.call`, as for the others.
            TimeoutError: See there.
            NoServer: See there.
            MalformedPayload: See there.
        """
        if self._replies is None:
            if time.monotonic() < self._retry_s:
                return None
            self._replies = self._query()
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:  # there are no more
            self._retry_later()
            return None
        if reply is None:
            return None
        if reply.ok:
            return self._read(to_sample(reply.ok))
        raise self._fail(TimeoutError)

    def _retry_later(self) -> None:
        pause_s = next(self._pauses, None)
        if pause_s is None:
            raise self._fail(NoServer)
        self._replies, self._retry_s = None, time.monotonic() + pause_s


def read_response(service: Service[Request, Response], reply: Sample) -> Response:
    """Read the response of a service; raises ServiceError and MalformedPayload."""
    return require_ok(service, decode(service.response, reply.payload, reply.encoding))


class Bus:
    """A Zenoh session: `with open_bus(...) as bus`."""

    def __init__(self, session: zenoh.Session, config: BusConfig) -> None:
        self._session = session
        self._sender = ReplySender()
        self.held_messages = HeldMessages()
        """Held messages of this session and of those that it opens."""
        self._names = RenewedSession(
            session, self._open_for_names, RENEW_AFTER if config.mode == "client" else NEVER
        )
        """Declares what comes and goes with robots."""
        self._expected_keys: dict[str, zenoh.KeyExpr] = {}
        self._user_token: zenoh.LivelinessToken | None = None
        self.unanswered: OrderedDict[tuple[str, bytes], str] = OrderedDict()
        """Ids of spawns without a reply, by key and digest of the request."""
        # Names this session in its requests: a server shares its time among sessions.
        self._source = zenoh.SourceInfo(session.id, 0)
        self.config = config
        self.traffic = BusTraffic()
        self.arrivals: ArrivalSignal | None = None
        """Arrivals at subscriptions that were declared since `watch_arrivals`."""

    def __enter__(self) -> "Bus":
        """Return the bus."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the session."""
        self.close()

    @property
    def endpoint(self) -> str:
        """First endpoint to listen at, else to connect to."""
        return (self.config.listen or self.config.connect or ("",))[0]

    @property
    def user(self) -> str:
        """User of this session on a secured server; empty on others."""
        return self.config.credentials.user if self.config.credentials else ""

    @property
    def zid(self) -> str:
        """Session id, in hexadecimal digits."""
        return str(self._session.info.zid())

    def watch_links(self) -> LinkWatch:
        """Watch the links of other sessions to this one, beginning with the present ones."""
        listener = self._session.info.declare_link_events_listener(
            FifoChannel(MAX_LINK_EVENTS), history=True
        )
        return LinkWatch(listener)

    def announce_user(self, world: str) -> None:
        """Declare whose session this is, until it closes: the server of that world records it."""
        key = keys.user_session(world, self.user, self.zid)
        self._user_token = self._session.liveliness().declare_token(key)

    def stamp(self) -> Stamp:
        """Make a timestamp of now."""
        return Stamp(self._session.new_timestamp())

    def open_session(self, joined_publishers: tuple[str, ...] = ()) -> "Bus":
        """Open another session to the same network; the caller closes it.

        Args:
            joined_publishers: See `BusConfig`.

        Raises:
            BusError: See `open_bus`.
        """
        at = self.config.listen if self.config.mode == "router" else self.config.connect
        config = msgspec.structs.replace(
            self.config,
            mode="client",
            connect=at,
            listen=(),
            # That of the attempt that succeeded may be short.
            open_timeout_s=max(self.config.open_timeout_s, OPEN_TIMEOUTS_S[-1]),
            joined_publishers=joined_publishers,
        )
        opened = open_bus(config)
        opened.traffic, opened.held_messages = self.traffic, self.held_messages
        return opened

    def _open_for_names(self) -> tuple[zenoh.Session, Callable[[], None]]:
        opened = self.open_session(self.config.joined_publishers)
        return opened._session, opened.close  # noqa: SLF001 - of this class

    def watch_subscribers(self, patterns: Iterable[str]) -> BusSubscriberWatch:
        """Open a session that finds out which key expressions have subscribers.

        Args:
            patterns: Key expressions; what is asked for should be within one of them.

        Raises:
            BusError: See `open_bus`.
        """
        listed = tuple(patterns)
        opened = self.open_session(joined_publishers=listed)
        return BusSubscriberWatch(
            opened._session,  # noqa: SLF001 - of this class
            listed,
            traffic=self.traffic,
            held=self.held_messages,
            close=opened.close,
        )

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold what this thread publishes until the block ends, so that it takes few packets."""
        return self.held_messages.hold()

    def send_held(self) -> None:
        """Send at once what is held."""
        self.held_messages.send()

    def watch_arrivals(self) -> None:
        """Signal all that arrives at what is declared from now on."""
        self.arrivals = ArrivalSignal()

    def close(self) -> None:
        """Send the replies that wait, and close the session and all that it declared."""
        self._sender.close()
        self._names.close()
        if self._user_token is not None:
            self._user_token.undeclare()
            self._user_token = None
        self._session.close()

    def prepare_reply_threads(self, prepare: Callable[[], object]) -> None:
        """Set what each thread that sends replies calls first, such as for its priority."""
        self._sender.prepare_thread = prepare

    def has_reply_backlog(self, client: str) -> bool:
        """Whether many replies to a client wait to be sent."""
        return self._sender.has_backlog(client)

    def settle_replies(self, timeout_s: float) -> None:
        """Wait until replies are sent, except to clients that have stopped reading."""
        self._sender.settle(timeout_s)

    def advertise(self, key: str, encoding: str) -> BusPublisher:
        """Declare a publisher; `encoding` is the Zenoh Encoding of its payloads."""
        expression = to_key_expression(key)

        def declare(session: zenoh.Session) -> zenoh.Publisher:
            return session.declare_publisher(
                expression, encoding=encoding, congestion_control=zenoh.CongestionControl.DROP
            )

        return DeclaredPublisher(declare, self._names, self.traffic, self.held_messages)

    def subscribe(
        self, key: str, depth: int = LATEST, max_bytes: int = MAX_MESSAGE_BYTES
    ) -> BusSubscription:
        """Subscribe to a key expression.

        Args:
            key: Key expression.
            depth: Queue length; the newest messages are kept.
            max_bytes: Larger messages are dropped.
        """
        handler: QueueHandler[zenoh.Sample] = make_queue(depth, self.arrivals)
        declared = self._session.declare_subscriber(to_key_expression(key), handler)
        return BusSubscription(declared, QueuedSamples(declared.handler, max_bytes), self.traffic)

    def expect_key(self, key: str) -> None:
        """Declare a key on which many messages come, for a session with many subscriptions.

        They then come with a number, by which the session finds its subscriptions; else it compares
        the key with each of them. Beyond `MAX_EXPECTED_KEYS` nothing changes.
        """
        if len(self._expected_keys) < MAX_EXPECTED_KEYS and key not in self._expected_keys:
            self._expected_keys[key] = self._session.declare_keyexpr(key)

    def subscribe_newest(
        self, key: str, depth: int, keeps_all: Callable[[str], bool]
    ) -> NewestMessages[zenoh.Sample]:
        """Subscribe to a key expression, for a caller that needs the newest message of each key.

        Args:
            key: Key expression.
            depth: Queue length between two calls of `collect`; the newest messages are kept.
            keeps_all: Whether all messages of a key are kept.
        """
        declared = self._session.declare_subscriber(to_key_expression(key), RingChannel(depth))

        def receive() -> Iterator[tuple[str, zenoh.Sample]]:
            while (sample := declared.try_recv()) is not None:
                yield str(sample.key_expr), sample

        def copy(kept: list[zenoh.Sample]) -> list[Sample]:
            self.traffic.received += len(kept)
            self.traffic.received_bytes += sum(len(one.payload) for one in kept)
            return [to_sample(one) for one in kept if len(one.payload) <= MAX_MESSAGE_BYTES]

        return NewestMessages(receive, copy, declared.undeclare, keeps_all)

    def subscribe_copying(
        self, key: str, depth: int, max_bytes: int = MAX_COPIED_BYTES
    ) -> BusSubscription:
        """Subscribe to a key expression, for a caller that may take messages late.

        Args:
            key: Key expression.
            depth: Most messages that wait.
            max_bytes: Most bytes of payloads that wait; the newest messages are kept.
        """
        samples = CopiedSamples(depth, max_bytes)

        def copy(sample: zenoh.Sample) -> None:
            samples.add(to_sample(sample))

        declared = self._session.declare_subscriber(
            to_key_expression(key), Callback(copy, indirect=False)
        )
        return BusSubscription(declared, samples, self.traffic)

    def receive(self, key: str) -> BusReceiver:
        """Subscribe to a key, for a caller that waits for each message."""
        queue: SimpleQueue[zenoh.Sample] = SimpleQueue()
        # Put by the thread of the session: a thread of its own would cost a switch.
        handler = Callback(queue.put, indirect=False)
        return BusReceiver(self._session.declare_subscriber(to_key_expression(key), handler), queue)

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> BusQueryQueue:
        """Declare a queryable.

        Args:
            key: Key expression.
            depth: Queue length.
            is_complete: Whether no other queryable has a part of the reply; else Zenoh queries all.
        """
        handler: QueueHandler[zenoh.Query] = make_queue(depth, self.arrivals, is_of_requests=True)
        declared = self._session.declare_queryable(
            to_key_expression(key), handler, complete=is_complete
        )
        return BusQueryQueue(declared, self._sender, self.traffic)

    def token(self, key: str) -> LivelinessToken:
        """Declare a liveliness token."""
        return LivelinessToken(key, self._names)

    def open_token_queue(self) -> TokenThread:
        """Declare tokens in a thread, on a session of its own."""
        return TokenThread(self.open_session)

    def watch_tokens(self, key: str, depth: int = 16384) -> LivelinessWatch:
        """Watch liveliness tokens, beginning with the present ones."""
        liveliness = self._session.liveliness()
        handler: QueueHandler[zenoh.Sample] = make_queue(depth, self.arrivals, is_of_requests=True)
        return LivelinessWatch(liveliness.declare_subscriber(key, handler, history=True))

    def list_tokens(self, key: str, timeout_s: float = 1.0) -> list[str]:
        """List the present liveliness tokens."""
        replies = self._session.liveliness().get(key, FifoChannel(MAX_REPLIES), timeout=timeout_s)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]

    def list_worlds(self, timeout_s: float = 1.0) -> list[str]:
        """List the names of the worlds that servers serve on this network, sorted."""
        return keys.list_served_worlds(self.list_tokens(keys.alive_server("*"), timeout_s))

    def get(self, key: str, timeout_s: float = 1.0, payload: bytes = b"") -> list[Sample]:
        """Query a key expression and collect the replies."""
        replies = self._session.get(
            to_key_expression(key),
            FifoChannel(MAX_REPLIES),
            payload=payload or None,
            timeout=timeout_s,
            source_info=self._source,
        )
        return [to_sample(reply.ok) for reply in replies if reply.ok]

    def get_all(self, key: str, timeout_s: float = 1.0) -> list[Sample]:
        """Query every queryable of a key expression, and collect all replies on any key.

        A late subscriber of ROS 2 queries the caches of latched publishers so.
        """
        replies = self._session.get(
            to_key_expression(key),
            FifoChannel(MAX_REPLIES),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            accept_replies=zenoh.ReplyKeyExpr.ANY,
            timeout=timeout_s,
        )
        return [to_sample(reply.ok) for reply in replies if reply.ok]

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        """Call a service; a retry has the same `request_id`.

        A spawn that got no reply in time may be carried out all the same. The same request of this
        session, without an id, is its retry.

        Raises:
            ServiceError: The server refused the request, or would refuse it for its size.
            TimeoutError: The server did not reply in time.
            NoServer: No server of this world is running.
            MalformedPayload: The reply is not a response of this service.
        """
        key = keys.service(world, service.name, self.user)
        retry = self._find_retry(key, service, request)
        request_id = request_id or self.unanswered.pop(retry, "") or uuid.uuid4().hex
        query = self._make_query(key, service, request, timeout_s, request_id)
        deadline_s = time.monotonic() + timeout_s
        for pause_s in RETRY_AFTER_S:
            for reply in query(timeout=max(LEAST_TIMEOUT_S, deadline_s - time.monotonic())):
                if reply.ok:
                    return read_response(service, to_sample(reply.ok))
                self._keep_for_retry(retry, request_id)
                raise self._make_call_error(key, timeout_s, TimeoutError)
            time.sleep(pause_s)
        raise self._make_call_error(key, timeout_s, NoServer)

    def _find_retry(
        self, key: str, service: Service[Request, Response], request: Request
    ) -> tuple[str, bytes]:
        """Find by what the retry of a spawn is known; empty for other services."""
        if service.name not in SPAWNS:
            return "", b""
        return key, sha256(encode(request, Format.MSGPACK)).digest()

    def _keep_for_retry(self, retry: tuple[str, bytes], request_id: str) -> None:
        if retry[0]:
            self.unanswered[retry] = request_id
            while len(self.unanswered) > MAX_UNANSWERED:
                self.unanswered.popitem(last=False)

    def begin_call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> PendingBusCall[Response]:
        """Call a service, and poll for the reply later; a retry has the same `request_id`.

        Raises:
            ServiceError: The server would refuse the request for its size.
        """
        key = keys.service(world, service.name, self.user)
        return PendingBusCall(
            self._make_query(key, service, request, timeout_s, request_id),
            partial(read_response, service),
            partial(self._make_call_error, key, timeout_s),
        )

    def _make_query(
        self,
        key: str,
        service: Service[Request, Response],
        request: Request,
        timeout_s: float,
        request_id: str,
    ) -> "partial[Handler[zenoh.Reply]]":
        """Make what sends a request, each time with the same id."""
        payload = encode(request, Format.MSGPACK)
        limit = min(MAX_REQUEST_BYTES, self.config.max_message_bytes)
        if len(payload) > limit:
            raise ServiceError(
                service.name,
                ResultCode.OPERATION_FAILED,
                "OPERATION_FAILED",
                f"request.size: a request of {len(payload)} bytes; send {limit} at most, "
                "and meshes as files",
            )
        return partial(
            self._send_query,
            key,
            FifoChannel(16),
            payload=payload,
            encoding=make_encoding(request, Format.MSGPACK),
            attachment=request_id or uuid.uuid4().hex,
            timeout=timeout_s,
            source_info=self._source,
        )

    def _send_query(self, *given: Any, **more: Any) -> "Handler[zenoh.Reply]":  # noqa: ANN401
        try:
            return cast("Handler[zenoh.Reply]", self._session.get(*given, **more))
        except zenoh.ZError as error:
            raise SessionClosed(f"no request can be sent: {error}") from error

    def _make_call_error(self, key: str, timeout_s: float, kind: type[Exception]) -> Exception:
        if kind is TimeoutError:
            return TimeoutError(f"no reply from {key} within {timeout_s:g} s")
        return NoServer(self._explain_absence(key))

    def _explain_absence(self, key: str) -> str:
        given = self.config.credentials
        if given is not None and not self._session.info.routers_zid():
            # The link was there: perhaps the user was revoked meanwhile.
            return str(ask_for_refusal(self.endpoint, given))
        if worlds := [w for w in self.list_worlds(LIST_WORLDS_S) if w != key.split("/")[1]]:
            shown = name_choices("", worlds)
            return f"no server replies on {key} at {self.endpoint}; its worlds are {shown}"
        what_to_do = "check --world-name, and that it runs"
        if given is None:
            what_to_do = "start one with 'zensim serve'"
        return f"no server replies on {key} at {self.endpoint}; {what_to_do}"


def open_bus(config: BusConfig) -> Bus:
    """Open a session.

    Raises:
        TooFewFiles: It is a router, and the limit of open files is too low for a few sessions.
        ForkedProcess: This process was forked after a session was opened.
        EndpointUnreachable: No router or server listens at the endpoints to connect to.
        EndpointTaken: Another process listens at an endpoint to listen at.
        JoinRefused: A secured server does not admit the session, or is another one.
        ValueError: An endpoint or a join token is not valid.
    """
    session, settled = open_session(config)
    bus = Bus(session, settled)
    if settled.credentials is not None and settled.credentials.world:
        bus.announce_user(settled.credentials.world)
    return bus


def open_bus_with_retry(config: BusConfig, wait_s: float) -> Bus:
    """Open a session as soon as a router or server listens at the endpoints.

    Raises:
        EndpointUnreachable: None did within `wait_s`.
        BusError: See `open_bus`.
    """
    deadline_s = time.monotonic() + wait_s
    timeouts = cycle(OPEN_TIMEOUTS_S)
    while True:
        left_s = max(OPEN_TIMEOUTS_S[0], deadline_s - time.monotonic())
        attempt = msgspec.structs.replace(config, open_timeout_s=min(next(timeouts), left_s))
        next_s = time.monotonic() + LEAST_ATTEMPT_S
        try:
            return open_bus(attempt)
        except EndpointUnreachable:
            if time.monotonic() >= deadline_s:
                raise
        except JoinRefused as error:
            # Who has credentials, not a token, has them from the folder of this very router.
            is_busy = config.credentials is not None and error.reason == "user"
            if not is_busy or time.monotonic() >= deadline_s:
                raise
        time.sleep(max(0.0, next_s - time.monotonic()))
