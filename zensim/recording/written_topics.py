"""What a topic needs to be written to a file, whether it comes from the network or from a file."""

from collections.abc import Hashable, Iterable
from typing import Final, Protocol, TypeVar

OVERHEAD_BYTES: Final = 200
"""Memory of a message besides its payload: a tuple, two times, the head of the payload."""


class WrittenTopic(Hashable, Protocol):
    """A topic with all that its channel and its schema say."""

    @property
    def name(self) -> str:
        """Name with the first slash."""

    @property
    def ros_type(self) -> str:
        """`pkg/msg/Name`."""

    @property
    def encoding(self) -> str:
        """Encoding of messages."""

    @property
    def schema_encoding(self) -> str:
        """Encoding of the definition of the type."""

    @property
    def schema(self) -> bytes:
        """Definition of the type."""

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers get the last message."""

    def metadata(self) -> dict[str, str]:
        """Return what a file keeps with a channel."""


Topic = TypeVar("Topic", bound=WrittenTopic)


def measure_messages(messages: Iterable[tuple[object, int, int, bytes]]) -> int:
    """Measure the memory of messages in bytes: of small ones, the payload is the least part."""
    return sum([OVERHEAD_BYTES + len(payload) for _, _, _, payload in messages])
