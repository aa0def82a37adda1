"""The deadline of a call of the API: it limits every wait inside the call."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from zensim.api.api_errors import Timeout
from zensim.api.argument_checks import check_range

LEAST_S = 0.01
"""Shortest wait: a reply that is on its way is not missed."""
_DEADLINE_S: ContextVar[float] = ContextVar("deadline of a call", default=math.inf)


@contextmanager
def limited(timeout_s: float | None) -> Iterator[None]:
    """Limit all waits of this thread inside the block.

    Args:
        timeout_s: Wall time; None = only by the limits that they have anyway.

    Raises:
        Invalid: It is negative, or no number.
    """
    if timeout_s is not None:
        check_range("timeout_s", timeout_s, 0.0, math.inf)
    before_s = _DEADLINE_S.get()
    if timeout_s is None:
        yield
        return
    token = _DEADLINE_S.set(min(before_s, time.monotonic() + timeout_s))
    try:
        yield
    finally:
        _DEADLINE_S.reset(token)


def check_deadline() -> None:
    """Check that the call has time left; loops of many short waits call it.

    Raises:
        Timeout: It has none.
    """
    if time.monotonic() > _DEADLINE_S.get():
        raise Timeout("the call took longer than its timeout_s", hint="give it more time")


def limit(timeout_s: float) -> float:
    """Limit a wait [s] by the deadline of the call."""
    return max(LEAST_S, min(timeout_s, _DEADLINE_S.get() - time.monotonic()))
