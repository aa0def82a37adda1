"""What a restart restores, and how far it is; known before the journal is read."""

from dataclasses import dataclass
from pathlib import Path

from zensim.sim_server.journal.sqlite_store import count_unchecked_rows

RESTORE_MARK_FILE = "restoring"
"""Exists during a restore: a server that finds it crashed while restoring."""


@dataclass
class RestoreProgress:
    """How many entities are restored; read by other threads."""

    total: int = 0
    done: int = 0


def count_restorable(folder: str) -> int:
    """Count the entities of a journal before it is read and checked; 0 if a restore crashed."""
    path = Path(folder)
    if not folder or (path / RESTORE_MARK_FILE).exists():
        return 0
    return count_unchecked_rows(path, "entity")
