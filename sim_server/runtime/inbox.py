"""Input of the loop, polled from channels: service calls, drive commands, liveliness of agents and bonds."""

from typing import Protocol, TypeVar

import msgspec

from zensim.proto import keys
from zensim.proto.network_protocols import Sample, ServerNetwork, ServiceCall, ServiceCallSource

Message = TypeVar("Message", bound=msgspec.Struct)


COMMAND_DEPTH = 8192


class Inbox(Protocol):
    """What the loop asks at every turn."""

    def take_calls(self) -> list[ServiceCall]:
        """Take the requests that have come."""

    def take_commands(self) -> list[Sample]:
        """Take the drive commands that have come."""

    def take_agents(self) -> list[tuple[str, bool]]:
        """Take who came (True) and went (False)."""

    def take_bonds(self) -> list[tuple[str, bool]]:
        """Take which bonds came (True) and went (False)."""


class BusInbox:
    """The inbox on a bus."""

    def __init__(
        self, bus: ServerNetwork, world: str, others: tuple[ServiceCallSource, ...] = ()
    ) -> None:
        self._agents = bus.watch_tokens(keys.alive_agents(world))
        self._bonds = bus.watch_tokens(keys.bonds(world))
        self._commands = bus.subscribe(keys.drive_commands(world), COMMAND_DEPTH)
        self._calls = bus.serve(keys.services(world))
        self._others = others

    def take_calls(self) -> list[ServiceCall]:
        """See `Inbox`."""
        calls: list[ServiceCall] = [*self._calls.take()]
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
