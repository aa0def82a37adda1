"""Inputs of a world: what changed it, with the step at which it took effect."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.scalar_types import UInt32, UInt64


class ServiceRequest(msgspec.Struct, frozen=True):
    """A request of a service that changes the world, when its response was made."""

    step: UInt64 = 0
    """Steps made before it took effect."""
    service: str = ""
    client: str = ""
    """Session that called, as it says itself; empty if it does not."""
    request: str = ""
    """The request as JSON, cut after 64 KiB; empty where it has the bytes of a file."""
    code: int = 1
    """Result code of the response."""
    message: str = ""
    """Reason of a refusal."""


class Inputs(msgspec.Struct, frozen=True):
    """All that changed a world since the last message, in the order in which it took effect.

    A server publishes it only while there is a subscriber, or keeps it from its start.
    """

    ros_type: ClassVar[str] = "zensim/msg/Inputs"

    log: str = ""
    """Changes when a server begins a new log; sequence numbers start at 0 then."""
    sequence: UInt64 = 0
    """Number of this message; a gap means that messages were lost."""
    epoch: UInt32 = 0
    """Epoch of the records."""
    step: UInt64 = 0
    """When the message was made."""
    requests: tuple[ServiceRequest, ...] = ()
    """Requests for people to read: records have all that they did."""
    records: bytes = b""
    """MessagePack with every call of the engine that changes it, and hashes of states."""
