"""Simulation time of a message, from its bytes."""

import struct
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import Final, TypeAlias

import msgspec

from zensim.proto.messages.standard_messages import NANOSECONDS, Clock, Header, TFMessage

StampReader: TypeAlias = Callable[[bytes], int | None]
"""Reads the stamp [ns] of a CDR message; None if it has none."""
STAMP_AT: Final = 4
"""Offset of the stamp of a header at the start of a message; the CDR header has four bytes."""
TRANSFORM_STAMP_AT: Final = 8
"""The same in the first transform, which the number of transforms precedes."""
TEXT_AT: Final = 8
"""Offset of a text that is the only field; a zero follows it."""
LITTLE: Final = struct.Struct("<iI")
BIG: Final = struct.Struct(">iI")
MOST_AHEAD_NS: Final = NANOSECONDS
MOST_BEHIND_NS: Final = 10 * NANOSECONDS


@cache
def make_stamp_reader(message_type: type[msgspec.Struct]) -> StampReader:
    """Make the reader of a type; messages without a stamp have None."""
    if issubclass(message_type, TFMessage):
        return _read_first_transform
    fields = msgspec.structs.fields(message_type)
    is_stamped = bool(fields) and fields[0].type is Header
    return _read_header if is_stamped or issubclass(message_type, Clock) else _read_nothing


class _SteppedRecord(msgspec.Struct, frozen=True):
    step: int = 0


def make_step_reader(step_ns: int) -> StampReader:
    """Make the reader of texts with JSON that names the step of a record.

    Args:
        step_ns: Physics step; 0 = unknown, and no text has a stamp.
    """
    decode = msgspec.json.Decoder(_SteppedRecord).decode

    def read_step(payload: bytes) -> int | None:
        return decode(payload[TEXT_AT:-1]).step * step_ns

    return read_step if step_ns else _read_nothing


def choose_time(stamp_ns: int | None, clock_ns: int) -> int:
    """Choose the time of a message: its stamp, unless that is of another clock.

    A ROS 2 node without `use_sim_time` stamps its commands with the time of day.
    """
    if stamp_ns is None or not (
        clock_ns - MOST_BEHIND_NS <= stamp_ns <= clock_ns + MOST_AHEAD_NS and stamp_ns >= 0
    ):
        return max(0, clock_ns)
    return stamp_ns


def _read_header(payload: bytes) -> int | None:
    return _read_stamp(payload, STAMP_AT)


def _read_first_transform(payload: bytes) -> int | None:
    has_transforms = any(payload[STAMP_AT:TRANSFORM_STAMP_AT])
    return _read_stamp(payload, TRANSFORM_STAMP_AT) if has_transforms else None


def _read_nothing(_: bytes) -> int | None:
    return None


def _read_stamp(payload: bytes, at: int) -> int | None:
    try:
        seconds, nanoseconds = (LITTLE if payload[1] else BIG).unpack_from(payload, at)
    except (IndexError, struct.error):
        return None
    return int(seconds * NANOSECONDS + nanoseconds)


def count_missing(before_ns: int | None, times_ns: Sequence[int]) -> int:
    """Estimate how many messages of a topic are missing before these, by their usual period.

    Args:
        before_ns: Time of the message before; None = there was none.
        times_ns: In the order of arrival.
    """
    gaps = sorted(later - earlier for earlier, later in pairwise(times_ns) if later > earlier)
    if before_ns is None or not gaps:
        return 0
    period_ns = gaps[len(gaps) // 2]
    return max(0, round((times_ns[0] - before_ns) / period_ns) - 1)
