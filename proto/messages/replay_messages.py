"""Requests to a replay of a recording, and its state."""

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt32, UInt64


class ReplayRequest(msgspec.Struct, frozen=True):
    """Pause, resume or toggle a replay, or ask for its state."""


class ReplaySeekRequest(msgspec.Struct, frozen=True):
    """Continue a replay from a position, latched messages first."""

    position_s: float
    """Time since the start of the recording [s]."""


class ReplaySetRateRequest(msgspec.Struct, frozen=True):
    """Change the rate of a replay."""

    rate: float
    """Recorded time per wall time; 0 = as fast as possible."""


class ReplayPlayNextRequest(msgspec.Struct, frozen=True):
    """Publish the next messages of a paused replay."""

    count: UInt32 = 1


class ReplayReport(msgspec.Struct, frozen=True):
    """State of a replay after a request."""

    result: Result = Result()
    is_paused: bool = False
    rate: float = 1.0
    position_s: float = 0.0
    """Time since the start of the recording [s]."""
    duration_s: float = 0.0
    """Duration of the recording [s]."""
    time_ns: UInt64 = 0
    """Log time, as the clock has it."""
    epoch: UInt32 = 0
    """How often time went back, by a loop, a seek or a reset in the recording."""
    published: UInt64 = 0
    """Messages so far."""
