"""What a restart has to restore is known before its journal is read."""

from pathlib import Path

from tests.sim_server.journal.journaled_server import JournaledServer
from zensim.sim_server.journal.restore_progress import RESTORE_MARK_FILE, count_restorable


def keep_two(folder: Path) -> None:
    """Leave a journal of two entities."""
    server = JournaledServer(folder, "r0", "r1")
    server.tracker.record()
    server.crash()


def test_entities_of_a_journal_are_counted(tmp_path: Path) -> None:
    keep_two(tmp_path)

    assert count_restorable(str(tmp_path)) == 2


def test_nothing_is_counted_after_a_restore_that_crashed(tmp_path: Path) -> None:
    keep_two(tmp_path)
    (tmp_path / RESTORE_MARK_FILE).touch()

    assert count_restorable(str(tmp_path)) == 0


def test_nothing_is_counted_without_a_journal(tmp_path: Path) -> None:
    assert count_restorable("") == 0
    assert count_restorable(str(tmp_path)) == 0
