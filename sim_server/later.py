"""An answer that is not there yet."""

from collections.abc import Callable
from dataclasses import dataclass

import msgspec


@dataclass(frozen=True)
class Later:
    """What a handler returns when it has begun, and something must happen before it can answer.

    Attributes:
        is_ready: Asked at every turn of the loop, so it must cost nothing.
        outcome: Called once, when ready; raises as a handler does.
    """

    is_ready: Callable[[], bool]
    outcome: Callable[[], msgspec.Struct]
