"""Input of the loop, polled from channels: service calls, drive commands, liveliness of agents and bonds."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

import msgspec

from zensim.proto import keys
from zensim.proto.bus import Bus, Sample

Message = TypeVar("Message", bound=msgspec.Struct)


class IncomingCall(Protocol):
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


class CallSource(Protocol):
    """Where requests come from."""

    def take(self) -> Sequence[IncomingCall]:
        """Take what has come."""


COMMAND_DEPTH = 8192


class Inbox(Protocol):
    """What the loop asks at every turn."""

    def take_calls(self) -> list[IncomingCall]:
        """Take the requests that have come."""

    def take_commands(self) -> list[Sample]:
        """Take the drive commands that have come."""

    def take_agents(self) -> list[tuple[str, bool]]:
        """Take who came (True) and went (False)."""

    def take_bonds(self) -> list[tuple[str, bool]]:
        """Take which bonds came (True) and went (False)."""


class BusInbox:
    """The inbox on a bus."""

    def __init__(self, bus: Bus, world: str, others: tuple[CallSource, ...] = ()) -> None:
        self._agents = bus.watch_tokens(keys.alive_agents(world))
        self._bonds = bus.watch_tokens(keys.bonds(world))
        self._commands = bus.subscribe(keys.drive_commands(world), COMMAND_DEPTH)
        self._calls = bus.serve(keys.services(world))
        self._others = others

    def take_calls(self) -> list[IncomingCall]:
        """See `Inbox`."""
        calls: list[IncomingCall] = [*self._calls.take()]
        for source in self._others:
            calls += source.take()
        return calls

    def take_commands(self) -> list[Sample]:
        """See `Inbox`."""
        return self._commands.take()

    def take_agents(self) -> list[tuple[str, bool]]:
        """See `Inbox`."""
        return [(keys.parse_agent(key), alive) for key, alive in self._agents.take()]

    def take_bonds(self) -> list[tuple[str, bool]]:
        """See `Inbox`."""
        return [(keys.last_chunk(key), alive) for key, alive in self._bonds.take()]
