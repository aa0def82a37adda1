"""Agents that need no drive state for some time, as they said in their last command."""

from typing import Final, NamedTuple

MAX_REST_NS: Final = 200_000_000
"""Longest time without a state; an agent counts as hung after twice as long."""


class _Rest(NamedTuple):
    until_ns: int
    """Simulation time."""
    wall_until_ns: int
    version: tuple[int, int]


class RestingAgents:
    """Agents by the end of their rest, which a change of claims or a reset ends, too."""

    def __init__(self) -> None:
        self._rests: dict[str, _Rest] = {}

    def note(
        self, agent: str, rest_ns: int, *, time_ns: int, now_ns: int, version: tuple[int, int]
    ) -> None:
        """Note a command.

        Args:
            agent: That sent it.
            rest_ns: Simulation and wall time for which it needs no state; 0 ends its rest.
            time_ns: Simulation time.
            now_ns: Wall time.
            version: Of epoch and claims.
        """
        if rest_ns:
            lasts_ns = min(rest_ns, MAX_REST_NS)
            self._rests[agent] = _Rest(time_ns + lasts_ns, now_ns + lasts_ns, version)
        else:
            self._rests.pop(agent, None)

    def forget(self, agent: str) -> None:
        """Forget an agent that has ended."""
        self._rests.pop(agent, None)

    def find(self, *, time_ns: int, now_ns: int, version: tuple[int, int]) -> frozenset[str]:
        """Find the agents that need no state now; arguments as of `note`."""
        return frozenset(
            agent
            for agent, rest in self._rests.items()
            if time_ns < rest.until_ns and now_ns < rest.wall_until_ns and rest.version == version
        )
