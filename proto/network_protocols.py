"""Protocols of a network session and of what it declares; `bus.Bus` implements them all.

Each consumer names the smallest protocol that it needs; the last ones combine others.
"""

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Final, NewType, Protocol, TypeVar

import msgspec

from zensim.proto.service_catalog import Request, Response, Service

Message = TypeVar("Message", bound=msgspec.Struct)
Stamp = NewType("Stamp", object)
"""Time stamp of a sample, by the clock of its session."""


MAX_REQUEST_ID_BYTES: Final = 64
"""Longest id of a request; ROS 2 uses 24 bytes, our clients 32."""

MAX_REQUEST_BYTES: Final = 3 << 20
"""Encoded size limit: decoding a larger request would delay the physics step."""
MAX_COMMAND_BYTES: Final = 64 << 10
"""Largest command of one robot."""
MAX_FLEET_COMMAND_BYTES: Final = 256 << 10
"""Largest command of all robots of an agent, or of a client: 7000 robots with four wheels."""


class Sample(msgspec.Struct, frozen=True):
    """A message as received."""

    key: str
    payload: bytes
    encoding: str
    attachment: bytes = b""


class Closable(Protocol):
    """Anything declared on the network until it is closed, such as a liveliness token."""

    def close(self) -> None:
        """Undeclare it."""


class Publisher(Closable, Protocol):
    """Publisher on one key."""

    @property
    def is_matched(self) -> bool:
        """Whether the key has a subscriber."""

    def send(self, payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
        """Publish one message; subscribers drop a second one with the same stamp."""


class Subscription(Closable, Protocol):
    """Messages on a key expression."""

    def take(self) -> list[Sample]:
        """Take all messages received, oldest first."""

    def newest(self) -> Sample | None:
        """Take all messages and return the last."""
        taken = self.take()
        return taken[-1] if taken else None


class ServiceCall(Protocol):
    """A request that must be replied to or dropped, once."""

    user: str
    """Who calls a secured server; empty on others."""
    client: str
    """Session that called, as it says itself; empty for clients that do not. On a secured server
    the user, which is true."""
    session: str
    """Zenoh id of that session; empty where there is none."""

    @property
    def encoding(self) -> str:
        """Zenoh Encoding of the request; empty if there is none."""

    @property
    def size(self) -> int:
        """Bytes of the request as received; `payload` is empty where that is too many."""

    @property
    def payload(self) -> bytes:
        """Bytes of the request."""

    @property
    def start(self) -> bytes:
        """First byte of the request, or more; empty if it is long and was refused unread."""

    @property
    def request_id(self) -> bytes:
        """The same for a retry; empty when the caller does not retry.

        One byte longer than `MAX_REQUEST_ID_BYTES` when it is too long.
        """

    @property
    def name(self) -> str:
        """The service, as the caller wrote it."""

    def read(self, kind: type[Message]) -> Message:
        """Decode the request.

        Raises:
            MalformedPayload: The bytes are not that message.
        """

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """Reply once; `key` when the request's is an expression."""

    def drop(self) -> None:
        """End the request without a reply."""


class Query(ServiceCall, Protocol):
    """A request on a key expression."""

    key: str

    def covers(self, key: str) -> bool:
        """Whether the key expression includes a key."""

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        """Reply once; `key` when the request's is an expression."""

    def reply_each(self, replies: Iterable[tuple[str, bytes]], encoding: str) -> None:
        """Reply with several values, each on its own key."""

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        """Reply with one sample of several; `drop` ends the reply."""


class QuerySource(Protocol):
    """Requests received on one or more keys."""

    def take(self) -> Sequence[Query]:
        """Take all requests received, oldest first."""


class QueryQueue(QuerySource, Closable, Protocol):
    """Requests on a key expression that is served until closed."""


class ServiceCallSource(Protocol):
    """Service requests received."""

    def take(self) -> Sequence[ServiceCall]:
        """Take all requests received, oldest first."""


class TokenWatch(Closable, Protocol):
    """Appearing and disappearing liveliness tokens."""

    def take(self) -> list[tuple[str, bool]]:
        """Take all changes: key, and whether the token is alive."""


class Arrivals(Protocol):
    """What arrived at a session since the last look."""

    def take_requests(self) -> bool:
        """Whether there were queries or changed tokens since the last call."""

    def wait(self, timeout_s: float) -> None:
        """Pause until something arrives, or arrived since the last call, or time is over."""


class SubscriberWatch(Closable, Protocol):
    """Says which key expressions have subscribers, and publishes without declaring anything."""

    def has_subscribers(self, key: str) -> bool:
        """Whether a key expression has a subscriber; it is false at first."""

    def advertise(self, key: str, encoding: str) -> Publisher:
        """Make a publisher that declares nothing."""


class CallingNetwork(Protocol):
    """Calls services."""

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        """Call a service and return its response."""


ResponseT_co = TypeVar("ResponseT_co", bound=msgspec.Struct, covariant=True)


class PendingCall(Protocol[ResponseT_co]):
    """A service call whose reply is polled for."""

    def poll(self) -> ResponseT_co | None:
        """Return the response; None while there is none yet. Raises what the call would raise."""


class TokenQueue(Closable, Protocol):
    """Declares tokens later, beside the caller."""

    def token(self, key: str) -> Closable:
        """Declare this process alive under a key soon."""


class TokenSession(Closable, Protocol):
    """A session that declares liveliness tokens."""

    @property
    def zid(self) -> str:
        """The session's id, in hexadecimal digits."""

    def token(self, key: str) -> Closable:
        """Declare this process alive under a key."""

    def open_session(self) -> "TokenSession":
        """Open another session to the same network."""

    def open_token_queue(self) -> TokenQueue:
        """Open a queue with a session of its own."""


class SubscribingNetwork(Protocol):
    """Declares subscriptions and watches of tokens."""

    def subscribe(self, key: str, depth: int = 1, max_bytes: int = ...) -> Subscription:
        """Subscribe to a key expression, keeping the newest `depth` messages up to a size."""

    def watch_tokens(self, key: str, depth: int = 16384) -> TokenWatch:
        """Watch tokens, present ones first."""


class TopicNetwork(SubscribingNetwork, Protocol):
    """Network for topics: publishers, subscriptions, and requests for last values."""

    def stamp(self) -> Stamp:
        """Make a time stamp."""

    def advertise(self, key: str, encoding: str) -> Publisher:
        """Declare a publisher."""

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold what this thread publishes until the block ends, so that it takes few packets."""

    def send_held(self) -> None:
        """Send at once what is held."""

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> QueryQueue:
        """Receive requests on a key expression; not complete if others have parts of the reply."""


class FollowingNetwork(SubscribingNetwork, CallingNetwork, Protocol):
    """Network for a program that follows a world."""


class ServerNetwork(TopicNetwork, TokenSession, Protocol):
    """Network for the server."""

    def has_reply_backlog(self, client: str) -> bool:
        """Whether many replies to a client wait to be sent."""

    def settle_replies(self, timeout_s: float) -> None:
        """Wait until replies are sent, except to clients that have stopped reading."""


class AgentNetwork(TopicNetwork, FollowingNetwork, TokenSession, Protocol):
    """Network for agents."""

    @property
    def arrivals(self) -> Arrivals | None:
        """What arrives; None where an agent polls for it."""

    def open_session(self) -> "AgentNetwork":
        """Open another session to the same network."""

    def watch_subscribers(self, patterns: Iterable[str]) -> SubscriberWatch:
        """Watch the subscribers of key expressions within some patterns."""

    def begin_call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> PendingCall[Response]:
        """Call a service, and poll for the reply later; a retry has the same `request_id`."""
