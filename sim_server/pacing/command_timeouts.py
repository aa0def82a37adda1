"""Command timeouts: which agents have claims, but have sent no command for too long."""

from collections import OrderedDict
from typing import NamedTuple

COMMAND_TIMEOUT_NS = 400_000_000
"""Simulation time without a command after which the robots of an agent are stopped: with the time
to brake they rest within the 0.5 s after which agents let a `cmd_vel` expire.

As much wall time must have passed: faster than real time, agents need more simulation time."""


class CommandReceipt(NamedTuple):
    """When an agent last sent a command, and for which claims."""

    time_ns: int
    wall_ns: int
    claims: bytes


class CommandTimeouts:
    """The last command of each agent, oldest first, so that a check looks at one agent only."""

    def __init__(self) -> None:
        self._last: OrderedDict[str, CommandReceipt] = OrderedDict()

    def __contains__(self, agent: str) -> bool:
        """Whether the agent is watched."""
        return agent in self._last

    def note(self, agent: str, last: CommandReceipt) -> None:
        """Note a command, or the first state that an agent is to reply to."""
        self._last[agent] = last
        self._last.move_to_end(agent)

    def forget(self, agent: str) -> None:
        """Watch an agent no more, until it is noted again."""
        self._last.pop(agent, None)

    def find_silent(self, time_ns: int, wall_ns: int) -> tuple[str, bytes] | None:
        """Find an agent that has been silent for too long, and the claims that it knew.

        Args:
            time_ns: Simulation time.
            wall_ns: Monotonic wall time.
        """
        if not self._last:
            return None
        agent = next(iter(self._last))
        last = self._last[agent]
        if time_ns < last.time_ns:
            self._restart(time_ns, wall_ns)
            return None
        silent_ns = min(time_ns - last.time_ns, wall_ns - last.wall_ns)
        return (agent, last.claims) if silent_ns >= COMMAND_TIMEOUT_NS else None

    def _restart(self, time_ns: int, wall_ns: int) -> None:
        """Count from now on: a reset has set time back."""
        for agent, last in self._last.items():
            self._last[agent] = CommandReceipt(time_ns, wall_ns, last.claims)
