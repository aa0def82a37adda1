"""The runs of a recording one after the other, as positions since its start."""

from collections.abc import Iterator, Sequence
from typing import Final, TypeAlias

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.recording.recording_reader import Accepts, RecordingRun, StoredTopic, list_spans

TimedMessage: TypeAlias = tuple[int, int, StoredTopic, bytes]
"""Position [ns], number of the run, topic, payload."""
LATCHED_WITHIN_NS: Final = NANOSECONDS
"""A recorder gets the latched messages of its start within this time."""


class ReplayTimeline:
    """Positions [ns] of a recording: 0 at its first message; a reset of time is no gap."""

    def __init__(self, runs: Sequence[RecordingRun], accepts: Accepts) -> None:
        """Line up the runs.

        Args:
            runs: Of the recording.
            accepts: Chooses topics.
        """
        self._accepts = accepts
        self._runs = tuple(runs)
        self._starts: list[int] = []
        self.duration_ns = 0
        """Position of the last message."""
        for run in runs:
            self._starts.append(self.duration_ns)
            self.duration_ns += run.end_ns - run.start_ns

    def messages(self, start_ns: int, end_ns: int) -> Iterator[TimedMessage]:
        """Read the messages from one position to another, by time.

        Raises:
            OSError: A file cannot be read.
        """
        for span in list_spans(self._runs, start_ns, end_ns):
            shift_ns, number = span.shift_ns, span.number
            for topic, log_ns, _, payload in span.run.messages(
                self._accepts, start_ns=span.start_ns, end_ns=span.end_ns
            ):
                yield log_ns + shift_ns, number, topic, payload

    def find_run(self, position_ns: int) -> int:
        """Find the number of the run at a position; at a reset the new one."""
        later = [number for number, start in enumerate(self._starts) if start <= position_ns]
        return later[-1] if later else 0

    def find_log_ns(self, position_ns: int, run: int) -> int:
        """Find the log time of a position in a run."""
        bounds = self._runs[run]
        log_ns = bounds.start_ns + position_ns - self._starts[run]
        return min(max(log_ns, bounds.start_ns), bounds.end_ns)

    def find_latched_end(self, position_ns: int, run: int) -> int:
        """Find the position up to which latched messages are published first.

        It is a second after the start of a run at least: a recorder that asks for the latched
        messages of its start gets others meanwhile.
        """
        return max(position_ns, self._starts[run] + LATCHED_WITHIN_NS)

    def read_latched(self, position_ns: int, run: int) -> list[tuple[StoredTopic, bytes]]:
        """Read what latched topics have at a position.

        Raises:
            OSError: A file cannot be read.
        """
        log_ns = self._runs[run].start_ns + position_ns - self._starts[run]
        found = self._runs[run].latched_at(log_ns, self._accepts)
        return [(topic, payload) for topic, _, _, payload in found]
