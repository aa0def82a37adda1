"""What reaches the loop: requests, drive commands, agents that come and go. Channels, polled."""

from typing import Protocol

from zensim.proto import keys
from zensim.proto.bus import Bus, Sample
from zensim.sim_server.traffic.calls import Call
from zensim.sim_server.traffic.ros_side import Source

COMMAND_DEPTH = 8192


class Inbox(Protocol):
    """What the loop asks at every turn."""

    def take_calls(self) -> list[Call]:
        """Take the requests that have come."""

    def take_commands(self) -> list[Sample]:
        """Take the drive commands that have come."""

    def take_agents(self) -> list[tuple[str, bool]]:
        """Take who came (True) and went (False)."""

    def take_bonds(self) -> list[tuple[str, bool]]:
        """Take which bonds came (True) and went (False)."""


class BusInbox:
    """The inbox on a bus."""

    def __init__(self, bus: Bus, world: str, others: tuple[Source, ...] = ()) -> None:
        self._agents = bus.watch_tokens(keys.alive_agents(world))
        self._bonds = bus.watch_tokens(keys.bonds(world))
        self._commands = bus.subscribe(keys.drive_commands(world), COMMAND_DEPTH)
        self._calls = bus.serve(keys.services(world))
        self._others = others

    def take_calls(self) -> list[Call]:
        """See `Inbox`."""
        calls: list[Call] = [*self._calls.take()]
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
