"""Protocols of the network that agents need; `proto.bus.Bus` implements them."""

from collections.abc import Iterable, Sequence
from typing import Protocol

from zensim.proto import topic_endpoints
from zensim.proto.bus import Sample
from zensim.proto.service_catalog import Request, Response, Service


class AgentSubscription(topic_endpoints.TransportSubscription, Protocol):
    """Messages on a key expression."""

    def newest(self) -> Sample | None:
        """Take all and keep the last."""


class AgentCall(topic_endpoints.TransportQuery, Protocol):
    """A request that waits for its answer."""

    @property
    def key(self) -> str:
        """What was asked for; it may be a pattern."""

    def covers(self, key: str) -> bool:
        """Whether this asks for that key, perhaps among others."""

    def reply_each(self, answers: Iterable[tuple[str, bytes]], encoding: str) -> None:
        """Answer with many values, each on a key of its own."""


class AgentCallQueue(topic_endpoints.TransportQueryQueue, Protocol):
    """Requests on a key expression."""

    def take(self) -> Sequence[AgentCall]:
        """Take all that have come, oldest first."""


class AgentToken(Protocol):
    """Says that this process is alive."""

    def close(self) -> None:
        """Withdraw the token."""


class AgentTokenWatch(Protocol):
    """Comings and goings of tokens."""

    def take(self) -> list[tuple[str, bool]]:
        """Take all changes: key, and whether it is alive."""

    def close(self) -> None:
        """Stop watching."""


class AgentNetwork(topic_endpoints.TopicTransport, Protocol):
    """One session."""

    @property
    def zid(self) -> str:
        """The session's id."""

    def open_session(self) -> "AgentNetwork":
        """Open another session."""

    def close(self) -> None:
        """End the session."""

    def subscribe(self, key: str, depth: int = 1) -> AgentSubscription:
        """Listen to a key expression, keeping the newest `depth` messages."""

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> AgentCallQueue:
        """Answer requests on a key expression, alone unless it is said that others do too."""

    def token(self, key: str) -> AgentToken:
        """Declare this process alive under a key."""

    def watch_tokens(self, key: str, depth: int = 16384) -> AgentTokenWatch:
        """Watch tokens, those that are up already first."""

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
