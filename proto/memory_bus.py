"""MemoryBus: a network within one process, without a session or threads; as `bus.Bus` otherwise."""

import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar, cast

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.network_protocols import (
    MAX_FLEET_COMMAND_BYTES,
    Arrivals,
    Sample,
    Stamp,
    Subscription,
)
from zensim.proto.service_catalog import Request, Response, Service, require_ok

Message = TypeVar("Message", bound=msgspec.Struct)
Item = TypeVar("Item")
OnCall = Callable[[Service[Any, Any], Any], Any]
MAX_PUMP_ROUNDS, MAX_PUMP_S = 100, 2.0
"""How often, and how long at most, `MemoryBus.pumps` run for one query."""


def _drain(queue: deque[Item]) -> list[Item]:
    """Take all items of a queue, oldest first."""
    taken = list(queue)
    queue.clear()
    return taken


class MemoryPublisher:
    """Publisher on one key, or on a key expression that only asks for subscribers."""

    def __init__(self, bus: "MemoryBus", key: str, encoding: str) -> None:
        self._bus = bus
        self._key = key
        self._encoding = encoding
        self._version = -1
        self._matching: tuple[MemorySubscription, ...] = ()

    def __getstate__(self) -> dict[str, object]:
        """Leave out the subscriptions found."""
        return {**self.__dict__, "_version": -1, "_matching": ()}

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        if self._version != self._bus.version:
            self._version = self._bus.version
            self._matching = self._bus.find_subscriptions(self._key)
        return bool(self._matching)

    def send(self, payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
        """Give a message to all subscribers."""
        del stamp
        if self.is_matched:
            sample = Sample(self._key, payload, self._encoding, attachment)
            for subscription in self._matching:
                subscription.samples.append(sample)

    def close(self) -> None:
        """Do nothing: a publisher has nothing to undeclare."""


class MemorySubscription(Subscription):
    """The newest messages on a key expression."""

    def __init__(self, bus: "MemoryBus", key: str, depth: int) -> None:
        self.key = key
        self.samples: deque[Sample] = deque(maxlen=depth)
        self.networks = [bus]

    def take(self) -> list[Sample]:
        """Take all messages received, oldest first."""
        return _drain(self.samples)

    def close(self) -> None:
        """End the subscription."""
        for bus in self.networks:
            bus.remove(self)


class MemoryCall:
    """A request on a key or key expression; it collects the replies."""

    def __init__(
        self, key: str, payload: bytes, encoding: str, request_id: bytes, *, owed: int = 1
    ) -> None:
        """Collect replies.

        Args:
            key: Of the request.
            payload: Of the request.
            encoding: Of the payload.
            request_id: The same for a retry; empty without one.
            owed: Number of those that have to reply, or to drop it.
        """
        self.key = key
        self.payload = payload
        self.size = len(payload)
        self.start = payload[:1]
        self.encoding = encoding
        self.user = keys.parse_user(key)
        self.request_id = request_id
        self.client = self.session = ""
        self.answers: list[Sample] = []
        self._owed = owed

    @property
    def is_over(self) -> bool:
        """Whether all have replied to it or dropped it."""
        return self._owed <= 0

    @property
    def samples(self) -> list[Sample]:
        """The last reply of each key."""
        return list({answer.key: answer for answer in self.answers}.values())

    @property
    def name(self) -> str:
        """Last chunk of the key."""
        return keys.last_chunk(self.key)

    def read(self, kind: type[Message]) -> Message:
        """Decode the request."""
        return decode(kind, self.payload, self.encoding)

    def covers(self, key: str) -> bool:
        """Whether the key expression includes a key."""
        return keys.intersect(self.key, key)

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        """Collect a reply."""
        self.answers.append(Sample(key or self.key, payload, encoding, attachment))
        self.drop()

    def reply_each(self, replies: Iterable[tuple[str, bytes]], encoding: str) -> None:
        """Collect several replies."""
        self.answers += [Sample(key, payload, encoding) for key, payload in replies]
        self.drop()

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        """Collect one reply of several."""
        del stamp
        self.answers.append(Sample(key, payload, encoding, attachment))

    def drop(self) -> None:
        """End the reply of one of those that owe it."""
        self._owed -= 1


class MemoryQueries:
    """Requests on a key expression, until they are taken."""

    def __init__(self, bus: "MemoryBus", key: str, depth: int) -> None:
        self.key = key
        self.calls: deque[MemoryCall] = deque(maxlen=depth)
        self._bus = bus

    def take(self) -> list[MemoryCall]:
        """Take all requests, oldest first."""
        return _drain(self.calls)

    def close(self) -> None:
        """Receive no further requests."""
        self._bus.queues.remove(self)


class MemoryToken:
    """A liveliness token."""

    def __init__(self, bus: "MemoryBus", key: str) -> None:
        self._bus = bus
        self.key = key

    def close(self) -> None:
        """Undeclare it."""
        self._bus.tokens.remove(self)
        self._bus.note_token(self.key, is_alive=False)


class MemoryTokenWatch:
    """Appearing and disappearing tokens on a key expression."""

    def __init__(self, bus: "MemoryBus", key: str, depth: int) -> None:
        self._bus = bus
        self.key = key
        self.changes: deque[tuple[str, bool]] = deque(maxlen=depth)

    def take(self) -> list[tuple[str, bool]]:
        """Take all changes: key, and whether the token is alive."""
        return _drain(self.changes)

    def close(self) -> None:
        """Watch no more."""
        self._bus.watches.remove(self)


@dataclass
class MemoryPendingCall(Generic[Response]):
    """A call that is made when the reply is polled for."""

    make: Callable[[], Response]

    def poll(self) -> Response | None:
        """Make the call, and return the response."""
        return self.make()


class MemorySubscriberWatch:
    """Says which key expressions have subscribers."""

    def __init__(self, bus: "MemoryBus") -> None:
        self._bus = bus

    def has_subscribers(self, key: str) -> bool:
        """Whether a key expression has a subscriber."""
        return bool(self._bus.find_subscriptions(key))

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        """Make a publisher."""
        return MemoryPublisher(self._bus, key, encoding)

    def close(self) -> None:
        """Do nothing: nothing is declared."""


class MemoryBus:
    """The network of the parts of one process, which share this session.

    While a caller waits for a reply, the functions in `pumps` run.
    """

    arrivals: Arrivals | None = None
    """Nothing is signalled."""

    def __init__(self, on_call: OnCall | None = None) -> None:
        """Make a network without subscriptions.

        Args:
            on_call: Handles service calls; None = those handle them that serve their keys.
        """
        self.version = 0
        """Counts changes of the subscriptions."""
        self.subscriptions: list[MemorySubscription] = []
        self.queues: list[MemoryQueries] = []
        self.tokens: list[MemoryToken] = []
        self.watches: list[MemoryTokenWatch] = []
        self.pumps: list[Callable[[], object]] = []
        self.is_closed = False
        self._on_call = on_call

    @property
    def zid(self) -> str:
        """The session's id."""
        return "ab12"

    def close(self) -> None:
        """Undeclare the tokens."""
        self.is_closed = True
        for token in list(self.tokens):
            token.close()

    def open_session(self) -> "MemoryBus":
        """Return this session: there is one in a process."""
        return self

    def open_token_queue(self) -> "MemoryBus":
        """Return this session, which declares at once."""
        return self

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold nothing: a message takes no packet."""
        return nullcontext()

    def send_held(self) -> None:
        """Do nothing: nothing is held."""

    def stamp(self) -> Stamp:
        """Make a time stamp."""
        return cast("Stamp", object())

    def has_reply_backlog(self, client: str) -> bool:
        """Return False: replies arrive at once."""
        del client
        return False

    def settle_replies(self, timeout_s: float) -> None:
        """Do nothing: replies arrive at once."""

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        """Declare a publisher."""
        return MemoryPublisher(self, key, encoding)

    def subscribe(
        self, key: str, depth: int = 1, max_bytes: int = MAX_FLEET_COMMAND_BYTES
    ) -> MemorySubscription:
        """Subscribe to a key expression, keeping the newest `depth` messages of any size."""
        del max_bytes
        subscription = MemorySubscription(self, key, depth)
        self.subscriptions.append(subscription)
        self.version += 1
        return subscription

    def add(self, subscription: MemorySubscription) -> None:
        """Give the messages of this network to a subscription of another, too."""
        subscription.networks.append(self)
        self.subscriptions.append(subscription)
        self.version += 1

    def remove(self, subscription: MemorySubscription) -> None:
        """End a subscription; twice is once."""
        if subscription in self.subscriptions:
            self.subscriptions.remove(subscription)
            self.version += 1

    def replace(self, subscriptions: list[MemorySubscription], queues: list[MemoryQueries]) -> None:
        """Replace all subscriptions and queues of requests."""
        self.subscriptions, self.queues = subscriptions, queues
        self.version += 1

    def find_subscriptions(self, key: str) -> tuple[MemorySubscription, ...]:
        """Find the subscriptions that a key or key expression fits."""
        return tuple(one for one in self.subscriptions if keys.intersect(one.key, key))

    def watch_subscribers(self, patterns: Iterable[str]) -> MemorySubscriberWatch:
        """Say which key expressions have subscribers."""
        del patterns
        return MemorySubscriberWatch(self)

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> MemoryQueries:
        """Receive requests on a key expression."""
        del is_complete
        queue = MemoryQueries(self, key, depth)
        self.queues.append(queue)
        return queue

    def query(
        self, key: str, payload: bytes = b"", encoding: str = "", request_id: bytes = b""
    ) -> MemoryCall:
        """Ask all that serve a key; replies come when they take the request."""
        queues = [queue for queue in self.queues if keys.intersect(queue.key, key)]
        call = MemoryCall(key, payload, encoding, request_id, owed=len(queues))
        for queue in queues:
            queue.calls.append(call)
        return call

    def get(self, key: str, timeout_s: float = 1.0, payload: bytes = b"") -> list[Sample]:
        """Get the last values of a key expression from those that serve it."""
        del timeout_s
        call = self.query(key, payload)
        self.wait(call)
        return call.samples

    def wait(self, call: MemoryCall) -> None:
        """Run `pumps` until all have replied to a request, or seem not to."""
        rounds, deadline_s = 0, time.monotonic() + MAX_PUMP_S
        while not call.is_over:
            # What a thread makes ready takes time, however often the loop turns.
            is_late = not self.pumps or time.monotonic() > deadline_s
            if rounds >= MAX_PUMP_ROUNDS and is_late:
                break
            for pump in self.pumps:
                pump()
            rounds += 1

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        """Call a service.

        Raises:
            NoServer: Nobody serves it.
            TimeoutError: There was no reply.
            ServiceError: The request was refused.
        """
        if self._on_call is not None:
            return cast("Response", self._on_call(service, request))
        key, encoding = keys.service(world, service.name), make_encoding(request, Format.MSGPACK)
        asked = self.query(key, encode(request, Format.MSGPACK), encoding, request_id.encode())
        if asked.is_over:
            raise NoServer(f"no server replies on {key}")
        self.wait(asked)
        if not asked.answers:
            raise TimeoutError(f"no reply from {key} within {timeout_s:g} s")
        answer = asked.answers[0]
        return require_ok(service, decode(service.response, answer.payload, answer.encoding))

    def begin_call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> MemoryPendingCall[Response]:
        """Call a service when the reply is polled for."""
        options: dict[str, Any] = {"timeout_s": timeout_s, "request_id": request_id}
        return MemoryPendingCall(partial(self.call, service, request, world=world, **options))

    def token(self, key: str) -> MemoryToken:
        """Declare a part of the process alive under a key."""
        token = MemoryToken(self, key)
        self.tokens.append(token)
        self.note_token(key, is_alive=True)
        return token

    def note_token(self, key: str, *, is_alive: bool) -> None:
        """Tell those that watch a token that it appeared or disappeared."""
        for watch in self.watches:
            if keys.intersect(watch.key, key):
                watch.changes.append((key, is_alive))

    def list_tokens(self, key: str, timeout_s: float = 1.0) -> list[str]:
        """List the tokens on a key expression."""
        del timeout_s
        return [token.key for token in self.tokens if keys.intersect(key, token.key)]

    def list_worlds(self, timeout_s: float = 1.0) -> list[str]:
        """List the names of the worlds that servers serve, sorted."""
        return keys.list_served_worlds(self.list_tokens(keys.alive_server("*"), timeout_s))

    def watch_tokens(self, key: str, depth: int = 16384) -> MemoryTokenWatch:
        """Watch tokens, present ones first."""
        watch = MemoryTokenWatch(self, key, depth)
        watch.changes.extend((token, True) for token in self.list_tokens(key))
        self.watches.append(watch)
        return watch
