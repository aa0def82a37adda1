"""Deletions that a visitor could still undo."""

from zensim.spawner.page.pending_deletions import UNDO_S, PendingDeletions


def test_entities_are_deleted_when_their_time_has_passed() -> None:
    deletions = PendingDeletions()
    deletions.add(["a"], 1.0)
    deletions.add(["a", "b"], 3.0)

    assert deletions.take_due(1.0 + UNDO_S - 0.01) == ()
    assert deletions.take_due(1.0 + UNDO_S) == ("a",)
    assert deletions.take_due(3.0 + UNDO_S) == ("b",)
    assert deletions.take_due(1e9) == ()


def test_undo_keeps_all_that_are_pending() -> None:
    deletions = PendingDeletions()
    deletions.add(["a", "b"], 1.0)

    assert deletions.undo() == ("a", "b")

    assert deletions.undo() == ()
    assert deletions.take_due(1e9) == ()


def test_at_the_end_all_are_taken_once() -> None:
    deletions = PendingDeletions()
    deletions.add(["a"], 1.0)

    assert deletions.take_all() == ("a",)
    assert deletions.take_all() == ()
