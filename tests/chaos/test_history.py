"""The history checker finds impossible histories, and no others."""

import random

import pytest

from tests.chaos.history import Operation, effect, first_fault


def op(kind: str, asked_s: float, answered_s: float, answer: str) -> Operation:
    return Operation(kind, asked_s, answered_s, answer)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "operations",
    [
        [],
        [op("spawn", 0, 1, "done"), op("look", 2, 3, "there"), op("delete", 4, 5, "done")],
        # The lookup overlaps the spawn: either order is possible.
        [op("spawn", 0, 5, "done"), op("look", 1, 2, "missing"), op("look", 3, 4, "there")],
        [op("spawn", 0, 5, "done"), op("spawn", 0, 5, "taken"), op("spawn", 1, 4, "taken")],
        [op("spawn", 0, 9, "done"), op("delete", 0, 9, "done"), op("spawn", 0, 9, "done")],
    ],
)
def test_history_is_explained(operations: list[Operation]) -> None:
    assert first_fault(operations) is None


@pytest.mark.parametrize(
    ("operations", "fault"),
    [
        # Acknowledged, then lost.
        ([op("spawn", 0, 1, "done"), op("look", 2, 3, "missing")], 1),
        # Deleted, then existing again.
        ([op("spawn", 0, 1, "done"), op("delete", 2, 3, "done"), op("look", 4, 5, "there")], 2),
        # Two owners of one name.
        ([op("spawn", 0, 5, "done"), op("spawn", 1, 6, "done")], 1),
        # Seen by one client, and missed by a later request of another.
        ([op("look", 1, 2, "there"), op("look", 3, 4, "missing"), op("spawn", 0, 5, "done")], 1),
        ([op("delete", 0, 1, "done")], 0),
    ],
)
def test_history_has_a_fault(operations: list[Operation], fault: int) -> None:
    assert first_fault(operations) == operations[fault]


def test_history_of_a_correct_register_is_linearizable_with_slow_replies() -> None:
    draw = random.Random(3)
    operations, is_there = [], False
    for moment in range(400):
        kind = draw.choice(["spawn", "delete", "look"])
        for answer in ("done", "taken", "missing", "there"):
            after = effect(kind, answer, is_there=is_there)  # type: ignore[arg-type]
            if after is not None:
                early, late = draw.uniform(0, 5), draw.uniform(0, 5)
                operations.append(op(kind, moment - early, moment + late, answer))
                is_there = after
                break

    assert first_fault(operations) is None
