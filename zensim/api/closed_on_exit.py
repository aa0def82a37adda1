"""ClosedOnExit: objects that a `with` block closes at its end."""

from abc import ABC, abstractmethod
from types import TracebackType
from typing import TypeVar

SelfType = TypeVar("SelfType", bound="ClosedOnExit")


class ClosedOnExit(ABC):
    """An object that is closed at the end of its `with` block."""

    @abstractmethod
    def close(self) -> None:
        """Free what it holds."""

    def __enter__(self: SelfType) -> SelfType:
        """Return the object."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()
