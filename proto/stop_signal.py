"""SIGINT and SIGTERM as a flag that a program loop polls."""

import signal
from collections.abc import Callable

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopFlag:
    """Set by the first stop signal, which also raises KeyboardInterrupt before `arm`.

    Attributes:
        is_urgent: Whether a further signal came: the program ends without finishing what it does.
        on_stop: Called in the handler of the first signal.
    """

    def __init__(
        self, *, is_armed: bool = True, on_stop: Callable[[], None] = lambda: None
    ) -> None:
        self.is_set = self.is_urgent = False
        self.on_stop = on_stop
        self._is_armed = is_armed
        for number in STOP_SIGNALS:
            signal.signal(number, self._set)

    def arm(self) -> None:
        """Let signals only set the flag from now on."""
        self._is_armed = True

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.is_set

    def _set(self, _number: int, _frame: object) -> None:
        was_set, self.is_set = self.is_set, True
        self.is_urgent = was_set
        if not was_set:
            self.on_stop()
        if not self._is_armed and not was_set:
            raise KeyboardInterrupt
