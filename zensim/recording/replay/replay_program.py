"""The loop of `zensim replay`: messages, requests, keys, late subscribers."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Protocol

from zensim.proto.raw_terminal import RawTerminal, SignalPipe, open_signals, wait_for_input
from zensim.recording.replay.replay_keyboard import ReplayKeyboard
from zensim.recording.replay.replay_publishers import ReplayPublishers
from zensim.recording.replay.replay_requests import ReplayRequests
from zensim.recording.replay.replayer import Replayer

POLL_S: Final = 0.02
"""Time between two polls of requests and signals."""
LEAST_WAIT_S: Final = 0.001
"""Messages of a millisecond are published together."""
SPARE_S: Final = 0.004
"""Least wait in which messages are read ahead."""
LATCHED_PERIOD_S: Final = 0.2
SHOW_PERIOD_S: Final = 0.1


class Waiting(Protocol):
    """How the loop waits."""

    def wait(self, timeout_s: float) -> bool:
        """Wait; False when the replay is to end."""


class SleepingWait:
    """Waits where there is no terminal."""

    def __init__(self, should_stop: Callable[[], bool]) -> None:
        self._should_stop = should_stop

    def wait(self, timeout_s: float) -> bool:
        """Wait; False after a signal."""
        time.sleep(timeout_s)
        return not self._should_stop()


class TerminalWait:
    """Waits for keys and signals."""

    def __init__(
        self,
        terminal: RawTerminal,
        signals: SignalPipe,
        keyboard: ReplayKeyboard,
        replayer: Replayer,
    ) -> None:
        self._terminal, self._signals = terminal, signals
        self._keyboard, self._replayer = keyboard, replayer
        self._descriptors = [terminal.descriptor, signals.descriptor]
        self._show_s = 0.0

    def wait(self, timeout_s: float) -> bool:
        """Wait; False after a signal that ends the program."""
        ready = wait_for_input(self._descriptors, timeout_s)
        if self._terminal.descriptor in ready:
            self._take_keys()
        if (now_s := time.monotonic()) >= self._show_s:
            self._show_s = now_s + SHOW_PERIOD_S
            self._terminal.show(self._keyboard.describe())
        return self._signals.descriptor not in ready or self._take_signals()

    def _take_keys(self) -> None:
        data = self._terminal.read()
        if data is None:
            self._descriptors = [self._signals.descriptor]  # the terminal is gone
        else:
            self._keyboard.take(data)

    def _take_signals(self) -> bool:
        for number in self._signals.take():
            if not self._signals.suspends(number):
                return False
            was_paused = self._replayer.is_paused
            self._replayer.pause()
            self._terminal.leave()
            self._signals.suspend()
            self._terminal.enter()
            if not was_paused:
                self._replayer.resume()
        return True


@contextmanager
def open_terminal_wait(
    terminal: RawTerminal, keyboard: ReplayKeyboard, replayer: Replayer
) -> Iterator[TerminalWait]:
    """Take the keys of a terminal while the block runs; put the terminal back as it was."""
    with open_signals() as signals:
        terminal.enter()
        try:
            yield TerminalWait(terminal, signals, keyboard, replayer)
        finally:
            terminal.leave()


def run_replay(
    replayer: Replayer, publishers: ReplayPublishers, requests: ReplayRequests, waiting: Waiting
) -> None:
    """Replay until the end, or until the wait returns False.

    Raises:
        OSError: A file cannot be read.
    """
    requests_s = latched_s = 0.0
    while not replayer.is_done:
        next_s = replayer.advance()
        now_s = time.monotonic()
        if now_s >= requests_s:
            requests.serve()
            requests_s = now_s + POLL_S
        if now_s >= latched_s:
            publishers.serve()
            latched_s = now_s + LATCHED_PERIOD_S
        if next_s - now_s > SPARE_S:
            replayer.read_ahead(next_s - SPARE_S / 2)
        timeout_s = min(next_s, now_s + POLL_S) - time.monotonic()
        # At rate 0 there is no wait, but signals and keys are read.
        if not waiting.wait(0.0 if timeout_s <= 0 else max(LEAST_WAIT_S, timeout_s)):
            return
