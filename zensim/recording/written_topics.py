"""What a topic needs to be written to a file, whether it comes from the network or from a file."""

from collections.abc import Hashable
from typing import Protocol, TypeVar


class WrittenTopic(Hashable, Protocol):
    """A topic with all that its channel and its schema say."""

    @property
    def name(self) -> str:
        """With the first slash."""

    @property
    def ros_type(self) -> str:
        """`pkg/msg/Name`."""

    @property
    def encoding(self) -> str:
        """Of messages."""

    @property
    def schema_encoding(self) -> str:
        """Of the definition of the type."""

    @property
    def schema(self) -> bytes:
        """Definition of the type."""

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers get the last message."""

    def metadata(self) -> dict[str, str]:
        """Return what a file keeps with a channel."""


Topic = TypeVar("Topic", bound=WrittenTopic)
