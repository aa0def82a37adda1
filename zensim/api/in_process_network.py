"""InProcessNetwork: topics between the parts of one process, without a session or threads."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, Generic, TypeVar, cast

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import decode
from zensim.proto.network_protocols import (
    MAX_FLEET_COMMAND_BYTES,
    Arrivals,
    Query,
    Sample,
    Stamp,
)
from zensim.proto.service_catalog import Request, Response, Service

Message = TypeVar("Message", bound=msgspec.Struct)


class InProcessPublisher:
    """Publisher on one key, or on a key expression that only asks for subscribers."""

    def __init__(self, network: "InProcessNetwork", key: str, encoding: str) -> None:
        self._network = network
        self._key = key
        self._encoding = encoding
        self._version = -1
        self._matching: tuple[InProcessSubscription, ...] = ()

    def __getstate__(self) -> dict[str, object]:
        """Leave out the subscriptions found."""
        return {**self.__dict__, "_version": -1, "_matching": ()}

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        if self._version != self._network.version:
            self._version = self._network.version
            self._matching = self._network.find_subscriptions(self._key)
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


class InProcessSubscription:
    """The newest messages on a key expression."""

    def __init__(self, network: "InProcessNetwork", key: str, depth: int) -> None:
        self.key = key
        self.samples: deque[Sample] = deque(maxlen=depth)
        self.networks = [network]

    def take(self) -> list[Sample]:
        """Take all messages received, oldest first."""
        if not self.samples:
            return []
        taken = list(self.samples)
        self.samples.clear()
        return taken

    def newest(self) -> Sample | None:
        """Take all messages and return the last."""
        taken = self.take()
        return taken[-1] if taken else None

    def close(self) -> None:
        """End the subscription."""
        for network in self.networks:
            network.remove(self)


class Undeclared:
    """Stands for what needs no declaration in one process: a token, or a watch of tokens."""

    def take(self) -> list[tuple[str, bool]]:
        """Return no changes."""
        return []

    def close(self) -> None:
        """Do nothing."""


class LastValueQuery:
    """A query for the last value of one key; it collects the replies."""

    def __init__(self, key: str) -> None:
        self.key = key
        self.payload = b""
        self.encoding = ""
        self.request_id = b""
        self.client = self.session = ""
        self.user = ""
        self.size = 0
        self._replies: dict[str, Sample] = {}

    @property
    def samples(self) -> list[Sample]:
        """The last reply of each key."""
        return list(self._replies.values())

    @property
    def name(self) -> str:
        """Last chunk of the key."""
        return keys.last_chunk(self.key)

    def read(self, kind: type[Message]) -> Message:
        """Decode the request, which is empty."""
        return decode(kind, self.payload, self.encoding)

    def covers(self, key: str) -> bool:
        """Whether the key expression includes a key."""
        return keys.intersect(self.key, key)

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        """Collect a reply."""
        self._keep(Sample(key or self.key, payload, encoding, attachment))

    def reply_each(self, replies: Iterable[tuple[str, bytes]], encoding: str) -> None:
        """Collect several replies."""
        for key, payload in replies:
            self._keep(Sample(key, payload, encoding))

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        """Collect one reply of several."""
        del stamp
        self._keep(Sample(key, payload, encoding, attachment))

    def _keep(self, reply: Sample) -> None:
        self._replies[reply.key] = reply

    def drop(self) -> None:
        """Do nothing: a query ends when it is answered."""


class InProcessQueries:
    """Queries on a key expression, until they are taken."""

    def __init__(self, network: "InProcessNetwork", key: str) -> None:
        self.key = key
        self.queries: list[Query] = []
        self._network = network

    def take(self) -> Sequence[Query]:
        """Take all queries, oldest first."""
        if not self.queries:
            return ()
        taken, self.queries = self.queries, []
        return taken

    def close(self) -> None:
        """Receive no further queries."""
        self._network.queues.remove(self)


class InProcessNetwork:
    """The network of agents and topics of one process."""

    arrivals: Arrivals | None = None
    """Nothing is signalled."""

    def __init__(self, on_call: Callable[[Service[Any, Any], Any], Any]) -> None:
        """Take the function that handles service calls."""
        self.version = 0
        """Counts changes of the subscriptions."""
        self.subscriptions: list[InProcessSubscription] = []
        self.queues: list[InProcessQueries] = []
        self._on_call = on_call

    @property
    def zid(self) -> str:
        """The session's id."""
        return "0"

    def close(self) -> None:
        """Do nothing: sessions of one process are one."""

    def open_session(self) -> "InProcessNetwork":
        """Return this network."""
        return self

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold nothing: a message takes no packet."""
        return nullcontext()

    def send_held(self) -> None:
        """Do nothing: nothing is held."""

    def stamp(self) -> Stamp:
        """Make a time stamp."""
        return cast("Stamp", object())

    def advertise(self, key: str, encoding: str) -> InProcessPublisher:
        """Declare a publisher."""
        return InProcessPublisher(self, key, encoding)

    def subscribe(
        self, key: str, depth: int = 1, max_bytes: int = MAX_FLEET_COMMAND_BYTES
    ) -> InProcessSubscription:
        """Subscribe to a key expression, keeping the newest `depth` messages of any size."""
        del max_bytes
        subscription = InProcessSubscription(self, key, depth)
        self.subscriptions.append(subscription)
        self.version += 1
        return subscription

    def add(self, subscription: InProcessSubscription) -> None:
        """Give the messages of this network to a subscription of another, too."""
        subscription.networks.append(self)
        self.subscriptions.append(subscription)
        self.version += 1

    def remove(self, subscription: InProcessSubscription) -> None:
        """End a subscription; twice is once."""
        if subscription in self.subscriptions:
            self.subscriptions.remove(subscription)
            self.version += 1

    def replace(
        self, subscriptions: list[InProcessSubscription], queues: list[InProcessQueries]
    ) -> None:
        """Replace all subscriptions and queues of queries."""
        self.subscriptions, self.queues = subscriptions, queues
        self.version += 1

    def find_subscriptions(self, key: str) -> tuple[InProcessSubscription, ...]:
        """Find the subscriptions that a key or key expression fits."""
        return tuple(one for one in self.subscriptions if keys.intersect(one.key, key))

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> InProcessQueries:
        """Receive queries for last values."""
        del depth, is_complete
        queue = InProcessQueries(self, key)
        self.queues.append(queue)
        return queue

    def query(self, key: str) -> LastValueQuery:
        """Ask all that serve a key for its last value; replies come when they take the query."""
        query = LastValueQuery(key)
        for queue in self.queues:
            if keys.intersect(queue.key, key):
                queue.queries.append(query)
        return query

    def token(self, key: str) -> Undeclared:
        """Declare nothing: all parts live as long as the process."""
        del key
        return Undeclared()

    def open_token_queue(self) -> "InProcessNetwork":
        """Return this network, which declares nothing."""
        return self

    def watch_tokens(self, key: str, depth: int = 16384) -> Undeclared:
        """Watch nothing."""
        del key, depth
        return Undeclared()

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        """Call a service of this process; the world is the only one."""
        del world, timeout_s, request_id
        return cast("Response", self._on_call(service, request))

    def watch_subscribers(self, patterns: Iterable[str]) -> "InProcessSubscriberWatch":
        """Say which key expressions have subscribers."""
        del patterns
        return InProcessSubscriberWatch(self)

    def begin_call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> "InProcessPendingCall[Response]":
        """Call a service of this process when the reply is polled for."""
        del world, timeout_s, request_id
        return InProcessPendingCall(partial(self._on_call, service, request))


class InProcessPendingCall(Generic[Response]):
    """A call of a service of this process."""

    def __init__(self, make: Callable[[], Response]) -> None:
        self._make = make

    def poll(self) -> Response | None:
        """Make the call, and return the response."""
        return self._make()


class InProcessSubscriberWatch:
    """Says which key expressions have subscribers."""

    def __init__(self, network: InProcessNetwork) -> None:
        self._network = network

    def has_subscribers(self, key: str) -> bool:
        """Whether a key expression has a subscriber."""
        return bool(self._network.find_subscriptions(key))

    def advertise(self, key: str, encoding: str) -> InProcessPublisher:
        """Make a publisher."""
        return self._network.advertise(key, encoding)

    def close(self) -> None:
        """Do nothing: nothing is declared."""
