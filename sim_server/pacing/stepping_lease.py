"""SteppingLease: which client steps the simulation, and the mode to return to when it ends."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

Mode = TypeVar("Mode")


@dataclass
class SteppingLease(Generic[Mode]):
    """The client that steps, from its first request until its liveliness token disappears."""

    alive: set[str] = field(default_factory=set)
    """Clients that have a liveliness token."""
    holder: str = ""
    _former: Mode | None = None

    def find_other(self, client: str) -> str:
        """Name the client that steps; empty if it is this one or none."""
        return "" if self.holder == client else self.holder

    def take(self, client: str, mode: Mode) -> None:
        """Make a client with a token the holder, unless it is; keep the mode."""
        if client in self.alive and not self.holder:
            self.holder, self._former = client, mode

    def revise(self, change: Callable[[Mode], Mode]) -> None:
        """Change the mode to return to, after a request that sets it."""
        if self._former is not None:
            self._former = change(self._former)

    def end(self, client: str) -> Mode | None:
        """Forget a client whose token has disappeared; return the mode that it found, if any."""
        self.alive.discard(client)
        if client != self.holder:
            return None
        former, self._former, self.holder = self._former, None, ""
        return former
