"""When states are answered: once more for a late command, or later than they came."""

import math

from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.network_protocols import Sample

WINDOW_PERIODS = 2.0
"""Duration of the window, in periods between states; after it, time is taken to be stopped."""
MIN_WINDOW_S, MAX_WINDOW_S = 0.05, 1.0
"""Limits of the duration [s]."""


class LateCommandWindow:
    """Time in which the answer to the newest state may be revised once.

    If time waits for agents or is stepped by requests, each state has one answer: later commands
    count for the next state, so that equal requests give equal bytes.
    """

    def __init__(self) -> None:
        self._state: DriveState | None = None
        self._came_s = self._until_s = -math.inf

    def note_state(self, state: DriveState, now_s: float) -> None:
        """Note a state that was answered."""
        before, self._state = self._state, state
        has_run = (
            before is not None
            and (before.epoch, before.claims) == (state.epoch, state.claims)
            and before.step < state.step
        )
        gap_s, self._came_s = now_s - self._came_s, now_s
        lasts_s = min(max(MIN_WINDOW_S, WINDOW_PERIODS * gap_s), MAX_WINDOW_S)
        self._until_s = now_s + lasts_s if has_run and not state.is_awaited else -math.inf

    def is_open(self, now_s: float) -> bool:
        """Whether a command may change the last answer now."""
        return now_s < self._until_s

    def close(self) -> None:
        """Note that the answer was revised."""
        self._until_s = -math.inf


class EarlyState:
    """Keeps a state that came before the reply with its claims, for when that is here.

    Else it is never answered: a server that waits for it, or whose world is paused, has no newer.
    """

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._sample: Sample | None = None
        self._has_new_claims = False

    def keep(self, sample: Sample) -> None:
        """Keep a state whose claims are not held."""
        self._sample = sample

    def forget(self) -> None:
        """Keep nothing: there is a newer state, or the server is gone."""
        self._sample = None

    def note_new_claims(self) -> None:
        """Note that the state may be answered now."""
        self._has_new_claims = True

    def take(self) -> Sample | None:
        """Take the state, if there are new claims since the last call."""
        if not self._has_new_claims:
            return None
        sample, self._sample, self._has_new_claims = self._sample, None, False
        return sample
