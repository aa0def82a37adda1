"""A message as CDR bytes, of which only numbers and stamps change from one time to the next."""

import struct
from collections.abc import Sequence
from itertools import pairwise

import msgspec

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_layout import find_offsets
from zensim.proto.messages.standard_messages import NANOSECONDS

FLOAT_BYTES = 8
STAMP = struct.Struct("<iI")


class Image:
    """One message, each byte as `zensim.proto.codec.cdr.encode` writes it; made at a tenth of the cost."""

    def __init__(
        self, template: msgspec.Struct, *, numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        """Write the message.

        Args:
            template: As it is but for what changes.
            numbers: Paths of its float64 numbers that change; see `zensim.proto.codec.cdr_layout`.
            stamps: Paths of its `Time`s.
        """
        self._buffer = bytearray(cdr.encode(template))
        places = find_offsets(template)
        self._runs = _runs([places[path] for path in numbers])
        self._stamps = tuple(places[f"{path}.sec"] for path in stamps)

    def payload(self, time_ns: int, numbers: Sequence[float]) -> bytes:
        """Fill in a moment of simulation time and the numbers; return the whole message."""
        moment = divmod(time_ns, NANOSECONDS)
        for place in self._stamps:
            STAMP.pack_into(self._buffer, place, *moment)
        for run, place, where in self._runs:
            run.pack_into(self._buffer, place, *numbers[where])
        return bytes(self._buffer)


def _runs(places: Sequence[int]) -> tuple[tuple[struct.Struct, int, slice], ...]:
    """Find the numbers that follow one another, so that each run is written in one go."""
    gaps = [at for at, (one, next_) in enumerate(pairwise(places), 1) if next_ != one + FLOAT_BYTES]
    bounds = [0, *gaps, len(places)]
    return tuple(
        (struct.Struct(f"<{end - start}d"), places[start], slice(start, end))
        for start, end in pairwise(bounds)
        if end > start
    )
