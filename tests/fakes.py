"""In-memory network and clock for tests."""

import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, NoReturn, TypeVar, cast

import msgspec

from zensim.api.in_process_network import (
    InProcessNetwork,
    InProcessPublisher,
    InProcessSubscriberWatch,
    InProcessSubscription,
)
from zensim.proto import keys
from zensim.proto.bus.bus_config import MAX_MESSAGE_BYTES
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import LATEST
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.keys import intersect
from zensim.proto.network_protocols import Arrivals, Sample, Stamp
from zensim.proto.service_catalog import Request, Response, Service, require_ok
from zensim.proto.token_thread import TokenThread

Message = TypeVar("Message", bound=msgspec.Struct)
MAX_PUMP_ROUNDS, MAX_PUMP_S = 100, 2.0


def _refuse_call(service: Service[Any, Any], request: object) -> NoReturn:
    raise NotImplementedError(f"{service.name}: {request}")


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


class MemoryBus:
    """In-memory replacement of `zensim.proto.bus.Bus`; all its users share one session.

    While a caller waits for a reply, the functions in `pumps` run.
    """

    arrivals: Arrivals | None = None

    def __init__(self) -> None:
        self.pumps: list[Callable[[], object]] = []
        self.expected_keys: list[str] = []
        self.is_closed = False
        self.opened_sessions: list[MemoryBus] = []
        self._network = InProcessNetwork(_refuse_call)
        self._queues: list[MemoryCallQueue] = []
        self._tokens: list[MemoryToken] = []
        self._watches: list[MemoryTokenWatch] = []

    def close(self) -> None:
        self.is_closed = True
        for token in list(self._tokens):
            token.close()

    @property
    def zid(self) -> str:
        return "ab12"

    def expect_key(self, key: str) -> None:
        """Keep the key."""
        self.expected_keys.append(key)

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold nothing: a message takes no packet."""
        return nullcontext()

    def send_held(self) -> None:
        """Do nothing: nothing is held."""

    def stamp(self) -> Stamp:
        return cast("Stamp", object())

    def open_session(self) -> "MemoryBus":
        self.opened_sessions.append(MemoryBus())
        return self.opened_sessions[-1]

    def advertise(self, key: str, encoding: str) -> InProcessPublisher:
        return self._network.advertise(key, encoding)

    def subscribe(
        self, key: str, depth: int = LATEST, max_bytes: int = MAX_MESSAGE_BYTES
    ) -> InProcessSubscription:
        del max_bytes
        return self._network.subscribe(key, depth)

    def subscribe_copying(self, key: str, depth: int, max_bytes: int = 0) -> InProcessSubscription:
        del max_bytes
        return self._network.subscribe(key, depth)

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> "MemoryCallQueue":
        del is_complete
        queue = MemoryCallQueue(self._queues, key, depth)
        self._queues.append(queue)
        return queue

    def has_reply_backlog(self, client: str) -> bool:
        del client
        return False

    def settle_replies(self, timeout_s: float) -> None:
        pass

    def token(self, key: str) -> "MemoryToken":
        token = MemoryToken(self._tokens, self._watches, key)
        self._tokens.append(token)
        token.notify(is_alive=True)
        return token

    def open_token_queue(self) -> TokenThread:
        return TokenThread(self.open_session)

    def watch_tokens(self, key: str, depth: int = 16384) -> "MemoryTokenWatch":
        watch = MemoryTokenWatch(self._watches, key, depth)
        watch.changes.extend((token, True) for token in self.list_tokens(key))
        self._watches.append(watch)
        return watch

    def list_tokens(self, key: str, timeout_s: float = 1.0) -> list[str]:
        del timeout_s
        return [token.key for token in self._tokens if intersect(key, token.key)]

    def get(self, key: str, timeout_s: float = 1.0, payload: bytes = b"") -> list[Sample]:
        del timeout_s
        answers = [answer for call in self._query(key, payload, "") for answer in call.answers]
        return list({answer.key: answer for answer in answers}.values())

    def ask(self, key: str, payload: bytes, attachment: bytes) -> list[Sample]:
        """Query as a ROS 2 client does."""
        calls = self._query(key, payload, "", attachment)
        return [answer for call in calls for answer in call.answers]

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        key = keys.service(world, service.name)
        encoding = make_encoding(request, Format.MSGPACK)
        calls = self._query(key, encode(request, Format.MSGPACK), encoding, request_id.encode())
        if not calls:
            raise NoServer(f"no server replies on {key}")
        answers = [answer for call in calls for answer in call.answers]
        if not answers:
            raise TimeoutError(f"no reply from {key} within {timeout_s:g} s")
        response = decode(service.response, answers[0].payload, answers[0].encoding)
        return require_ok(service, response)

    def watch_subscribers(self, patterns: Iterable[str]) -> InProcessSubscriberWatch:
        return self._network.watch_subscribers(patterns)

    def begin_call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> "MemoryPendingCall[Response]":
        return MemoryPendingCall(
            partial(
                self.call,
                service,
                request,
                world=world,
                timeout_s=timeout_s,
                request_id=request_id,
            )
        )

    def has_subscriber(self, key: str) -> bool:
        """Whether a key has a subscriber."""
        return bool(self._network.find_subscriptions(key))

    @property
    def subscribed_keys(self) -> list[str]:
        """Keys of all subscriptions."""
        return [one.key for one in self._network.subscriptions]

    def is_served(self, key: str) -> bool:
        """Whether a key has a queryable."""
        return any(intersect(key, queue.key) for queue in self._queues)

    def put(self, key: str, payload: bytes, encoding: str = "", attachment: bytes = b"") -> None:
        """Publish bytes."""
        self._network.advertise(key, encoding).send(payload, attachment)

    def put_message(self, key: str, message: msgspec.Struct, format_: Format = Format.CDR) -> None:
        """Publish a message."""
        self.put(key, encode(message, format_), make_encoding(message, format_))

    def _query(
        self, key: str, payload: bytes, encoding: str, request_id: bytes = b""
    ) -> "list[MemoryCall]":
        queues = [queue for queue in self._queues if intersect(key, queue.key)]
        calls = [MemoryCall(key, payload, encoding, request_id) for _ in queues]
        for queue, call in zip(queues, calls, strict=True):
            queue.calls.append(call)
        rounds, deadline_s = 0, time.monotonic() + MAX_PUMP_S
        while not all(call.is_over for call in calls):
            # What a thread makes ready takes time, however often the loop turns.
            is_late = not self.pumps or time.monotonic() > deadline_s
            if rounds >= MAX_PUMP_ROUNDS and is_late:
                break
            for pump in self.pumps:
                pump()
            rounds += 1
        return calls


@dataclass
class MemoryPendingCall(Generic[Response]):
    """A call that is made when the reply is polled for."""

    make: Callable[[], Response]

    def poll(self) -> Response | None:
        return self.make()


class MemoryCall:
    def __init__(self, key: str, payload: bytes, encoding: str, request_id: bytes) -> None:
        self.key = key
        self.payload = payload
        self.size = len(payload)
        self.encoding = encoding
        self.user = keys.parse_user(key)
        self.request_id = request_id
        self.client = self.session = ""
        self.answers: list[Sample] = []
        self.is_over = False

    @property
    def name(self) -> str:
        return keys.last_chunk(self.key)

    def read(self, kind: type[Message]) -> Message:
        return decode(kind, self.payload, self.encoding)

    def covers(self, key: str) -> bool:
        return intersect(self.key, key)

    def reply_each(self, replies: Iterable[tuple[str, bytes]], encoding: str) -> None:
        self.answers += [Sample(key, payload, encoding) for key, payload in replies]
        self.is_over = True

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        del stamp
        self.answers.append(Sample(key, payload, encoding, attachment))

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        self.answers.append(Sample(key or self.key, payload, encoding, attachment))
        self.is_over = True

    def drop(self) -> None:
        self.is_over = True


class MemoryCallQueue:
    def __init__(self, owner: "list[MemoryCallQueue]", key: str, depth: int) -> None:
        self._owner = owner
        self.key = key
        self.calls: deque[MemoryCall] = deque(maxlen=depth)

    def take(self) -> list[MemoryCall]:
        taken = list(self.calls)
        self.calls.clear()
        return taken

    def close(self) -> None:
        self._owner.remove(self)


class MemoryToken:
    def __init__(
        self, owner: "list[MemoryToken]", watches: "list[MemoryTokenWatch]", key: str
    ) -> None:
        self._owner = owner
        self._watches = watches
        self.key = key

    def notify(self, *, is_alive: bool) -> None:
        for watch in self._watches:
            if intersect(watch.key, self.key):
                watch.changes.append((self.key, is_alive))

    def close(self) -> None:
        self._owner.remove(self)
        self.notify(is_alive=False)


class MemoryTokenWatch:
    def __init__(self, owner: "list[MemoryTokenWatch]", key: str, depth: int) -> None:
        self._owner = owner
        self.key = key
        self.changes: deque[tuple[str, bool]] = deque(maxlen=depth)

    def take(self) -> list[tuple[str, bool]]:
        taken = list(self.changes)
        self.changes.clear()
        return taken

    def close(self) -> None:
        self._owner.remove(self)


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
