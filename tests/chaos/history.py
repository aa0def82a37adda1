"""Linearizability checker of client histories of one name.

A name exists or not. An operation takes effect at one moment between its request and its
reply; the checker follows every order that real time allows, reply by reply (Lowe, "Testing for
linearizability", 2017: just-in-time linearization).
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

Kind = Literal["spawn", "delete", "look"]
Answer = Literal["done", "taken", "missing", "there"]
Order = tuple[bool, frozenset[int]]
"""Whether the name exists, and which open operations have taken effect."""


class Operation(NamedTuple):
    """One request of a client for a name, and its reply."""

    kind: Kind
    asked_s: float
    answered_s: float
    answer: Answer


def effect(kind: Kind, answer: Answer, *, is_there: bool) -> bool | None:
    """Whether the name exists after an operation; None if its reply is impossible."""
    match kind, answer, is_there:
        case ("spawn", "done", False) | ("spawn", "taken", True) | ("look", "there", True):
            return True
        case ("delete", "done", True) | ("delete", "missing", False) | ("look", "missing", False):
            return False
    return None


def first_fault(operations: Iterable[Operation], *, is_there: bool = False) -> Operation | None:
    """Find the first reply that no order explains; None if the history is linearizable.

    Args:
        operations: All completed operations on one name, in any order.
        is_there: Whether the name existed initially.
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
    """Apply any of the open operations, in any order."""
    found, fresh = set(orders), list(orders)
    while fresh:
        there, had = fresh.pop()
        for i in open_ - had:
            after = effect(known[i].kind, known[i].answer, is_there=there)
            if after is not None and (order := (after, had | {i})) not in found:
                found.add(order)
                fresh.append(order)
    return found
