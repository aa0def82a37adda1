"""Whether what clients saw of one name could have happened one thing after another.

A name is there or it is not. An operation takes effect at one moment between its asking and its
answer; the checker follows every order that real time allows, answer by answer (Lowe, "Testing for
linearizability", 2017: just-in-time linearization).
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

Kind = Literal["spawn", "delete", "look"]
Answer = Literal["done", "taken", "missing", "there"]
Order = tuple[bool, frozenset[int]]
"""Whether the name is there, and which of the open operations have had their effect."""


class Operation(NamedTuple):
    """What one client asked of a name, and what it was told."""

    kind: Kind
    asked_s: float
    answered_s: float
    answer: Answer


def effect(kind: Kind, answer: Answer, *, is_there: bool) -> bool | None:
    """Whether the name is there after an operation; None when it could not be answered so."""
    match kind, answer, is_there:
        case ("spawn", "done", False) | ("spawn", "taken", True) | ("look", "there", True):
            return True
        case ("delete", "done", True) | ("delete", "missing", False) | ("look", "missing", False):
            return False
    return None


def first_fault(operations: Iterable[Operation], *, is_there: bool = False) -> Operation | None:
    """Find the first answer that no order explains; None when the history is linearizable.

    Args:
        operations: All that was asked of one name, all answered, in any order.
        is_there: Whether the name was there at the beginning.
    """
    known = list(operations)
    moments = sorted(
        [(one.asked_s, 0, i) for i, one in enumerate(known)]
        + [(one.answered_s, 1, i) for i, one in enumerate(known)]
    )
    open_ = set[int]()
    orders: set[Order] = {(is_there, frozenset())}
    for _, is_answer, i in moments:
        if not is_answer:
            open_.add(i)
            continue
        orders = {
            (there, had - {i}) for there, had in _all_orders(orders, open_, known) if i in had
        }
        open_.discard(i)
        if not orders:
            return known[i]
    return None


def _all_orders(orders: set[Order], open_: set[int], known: list[Operation]) -> set[Order]:
    """Let any of the open operations have their effects, in any order."""
    found, fresh = set(orders), list(orders)
    while fresh:
        there, had = fresh.pop()
        for i in open_ - had:
            after = effect(known[i].kind, known[i].answer, is_there=there)
            if after is not None and (order := (after, had | {i})) not in found:
                found.add(order)
                fresh.append(order)
    return found
