"""When an answer may be given anew: while time runs freely. Wall time comes from outside."""

import math

from zensim.proto.messages.agent_messages import DriveState

BEATS = 2.0
"""So long after a state a new command is heeded, in times between two; later, time stands."""
LEAST_S, MOST_S = 0.05, 1.0
"""The same in seconds."""


class Revising:
    """Lets the answer to the newest state be revised once.

    Where time waits for agents, or is made step by step, each state has one answer: what comes
    later is for the next, so that the same requests give the same bytes.
    """

    def __init__(self) -> None:
        self._state: DriveState | None = None
        self._came_s = self._until_s = -math.inf

    def note_state(self, state: DriveState, now_s: float) -> None:
        """Take note of a state that was answered."""
        before, self._state = self._state, state
        has_run = (
            before is not None
            and (before.epoch, before.claims) == (state.epoch, state.claims)
            and before.step < state.step
        )
        gap_s, self._came_s = now_s - self._came_s, now_s
        lasts_s = min(max(LEAST_S, BEATS * gap_s), MOST_S)
        self._until_s = now_s + lasts_s if has_run and not state.is_awaited else -math.inf

    def is_open(self, now_s: float) -> bool:
        """Whether a command that comes now may change the answer."""
        return now_s < self._until_s

    def close(self) -> None:
        """Take note that the answer was revised."""
        self._until_s = -math.inf
