"""The journal as the request dispatcher uses it: record a change, and know when it is durable."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class JournaledResponse:
    """An answer that a retry gets, after a restart too."""

    service: str
    request_id: bytes
    payload: bytes
    encoding: str


class ChangeJournal(Protocol):
    """The journal, as the loop sees it; nothing here waits for the disk."""

    position: int
    """Of the newest change."""

    @property
    def earlier_responses(self) -> tuple[JournaledResponse, ...]:
        """Responses of an earlier server, oldest first."""

    @property
    def durable(self) -> int:
        """The newest position that is on the disk."""

    @property
    def is_failing(self) -> bool:
        """Whether the disk refused the last change, and has taken none since."""

    def note(
        self,
        answer: JournaledResponse | None = None,
        forgotten: tuple[tuple[str, bytes], ...] = (),
        *,
        is_asked: bool = False,
    ) -> int:
        """Hand over what has changed, and an answer with it; return the newest position.

        Args:
            answer: Kept together with what it tells of.
            forgotten: Answers that need not be kept any more: service and request id.
            is_asked: Whether a request changed it, and is refused when it cannot be written.
        """

    def poll(self) -> str:
        """Hand over what changed without a request; once a turn.

        Returns:
            Why changes could not be written; spawns and deletes among them have been taken back.
            Empty when all is well.
        """

    def retry(self) -> int:
        """Write something at once, to see whether the disk works again; return the attempt."""

    def is_decided(self, attempt: int) -> bool:
        """Whether it is known how an attempt went."""
