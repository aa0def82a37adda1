"""What the loop knows of a request, whichever way it came."""

from typing import Protocol, TypeVar

import msgspec

Message = TypeVar("Message", bound=msgspec.Struct)


class Call(Protocol):
    """A request that waits for its answer; reply once, or the caller gets nothing."""

    payload: bytes
    encoding: str
    request_id: bytes
    """The same for a retry; empty when nobody will retry."""
    size: int
    """Bytes as they were sent."""

    @property
    def name(self) -> str:
        """The service asked for, or whatever else was written."""

    def read(self, kind: type[Message]) -> Message:
        """Decode the request.

        Raises:
            MalformedPayload: The bytes are not that message.
        """

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """Answer, and let the caller go; `key` when the request's is a pattern."""

    def drop(self) -> None:
        """Let the caller go without an answer."""
