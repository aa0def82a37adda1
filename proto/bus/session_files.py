"""Open files that the sessions of a router need."""

from typing import Final

from zensim.proto.bus.bus_errors import TooFewFiles
from zensim.proto.process_limits import raise_file_limit

RESERVED_FILES: Final = 200
"""Open files that a server keeps for itself: its own, and those of its worlds and clients."""
FILES_OF_SESSION: Final = 2
FEW_SESSIONS: Final = 4
"""Fewest sessions of a router that is of use: a robot's agent, a page, and two clients."""
MAX_SESSIONS: Final = 4000


def require_files(sessions: int, what: str) -> None:
    """Check that this process, or its children, can be a router of so many sessions.

    The limit is raised as far as it may.

    Raises:
        TooFewFiles: It cannot.
    """
    needed, limit = RESERVED_FILES + FILES_OF_SESSION * sessions, raise_file_limit()
    if limit < needed:
        raise TooFewFiles(what, needed, limit)


def find_max_sessions(file_limit: int) -> int:
    """Find how many sessions a router may hold without using up its open files."""
    return max(1, min(MAX_SESSIONS, (file_limit - RESERVED_FILES) // FILES_OF_SESSION))
