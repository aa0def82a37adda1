"""The interface of the journal: record changes, and find out when they are durable."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class JournaledResponse:
    """A response that a repeated request gets, also after a restart."""

    service: str
    request_id: bytes
    payload: bytes
    encoding: str


class ChangeJournal(Protocol):
    """A journal of changes; no method waits for the disk."""

    position: int
    """Position of the newest change."""

    @property
    def earlier_responses(self) -> tuple[JournaledResponse, ...]:
        """Responses of an earlier server, oldest first."""

    @property
    def durable(self) -> int:
        """The newest durable position."""

    @property
    def is_failing(self) -> bool:
        """Whether the last change could not be written, and none was written since."""

    def record(
        self,
        response: JournaledResponse | None = None,
        expired: tuple[tuple[str, bytes], ...] = (),
        *,
        is_requested: bool = False,
    ) -> int:
        """Submit all changes, and a response with them; return the newest position.

        Args:
            response: Response to the request that made the changes; written with them.
            expired: Responses that expired: service and request id.
            is_requested: Whether a request made the changes; it fails if they cannot be written.
        """

    def poll(self) -> str:
        """Submit changes without a request; called once in each turn of the loop.

        Returns:
            Why changes could not be written, and empty otherwise. The spawns and deletes among
            them have been undone.
        """

    def retry(self) -> int:
        """Write a record now, to test the disk; return the number of the attempt."""

    def is_decided(self, attempt: int) -> bool:
        """Whether the result of an attempt is known."""
