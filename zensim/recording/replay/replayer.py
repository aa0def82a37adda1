"""Decides which messages of a recording are due, and publishes them."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final, Protocol

import msgspec

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.recording.recording_reader import StoredTopic
from zensim.recording.replay.replay_clock import UNLIMITED_NS, ReplayClock
from zensim.recording.replay.replay_timeline import ReplayTimeline, TimedMessage

MAX_BATCH: Final = 1000
"""Messages that are published between two polls of keys, requests and signals."""
LEAST_PASS_S: Final = 0.1
"""Least time of a loop, so that one over a single message does not use up a core."""
MAX_AHEAD: Final = 2048
MAX_AHEAD_BYTES: Final = 4 << 20
"""What is read before it is due: a chunk takes some milliseconds."""
LATE_STEPS: Final = 2000
LATE_STEP_S: Final = 0.0005


class ReplaySink(Protocol):
    """Where messages go."""

    def publish(self, topic: StoredTopic, payload: bytes) -> None:
        """Publish a message."""

    def publish_clock(self, time_ns: int, epoch: int) -> None:
        """Publish the time; one that is less than before has a higher epoch."""


class ReplaySettings(msgspec.Struct, frozen=True, kw_only=True):
    """What part of a recording is replayed, and how."""

    start_ns: int = 0
    """Position of the start, and of each loop."""
    end_ns: int = UNLIMITED_NS
    rate: float = 1.0
    is_paused: bool = False
    is_loop: bool = False
    clock_hz: float = 40.0
    """Rate of the clock in wall time; 0 = no clock."""
    delay_s: float = 0.0
    """Wall time before the first message, which latched ones do not wait for."""


class Lateness:
    """How much later than due messages were published, in steps of half a millisecond."""

    def __init__(self) -> None:
        self._counts = [0] * (LATE_STEPS + 1)

    def add(self, late_s: float) -> None:
        """Count a message."""
        self._counts[min(LATE_STEPS, max(0, int(late_s / LATE_STEP_S)))] += 1

    def quantile_s(self, part: float) -> float:
        """Find the lateness that this part of all messages does not exceed [s]."""
        left = part * sum(self._counts)
        for step, count in enumerate(self._counts):
            left -= count
            if left <= 0:
                return step * LATE_STEP_S
        return LATE_STEPS * LATE_STEP_S


def find_end(settings: ReplaySettings, duration_ns: int) -> int:
    """Find the position of the end.

    Raises:
        ValueError: The start is after it.
    """
    end_ns = min(settings.end_ns, duration_ns)
    if settings.start_ns > end_ns:
        raise ValueError(
            f"the start is at {settings.start_ns / NANOSECONDS:g} s, and the end at "
            f"{end_ns / NANOSECONDS:g} s; use an earlier `start_offset`"
        )
    return end_ns


class Replayer:
    """A replay; its positions [ns] are times since the start of the recording."""

    def __init__(
        self,
        timeline: ReplayTimeline,
        sink: ReplaySink,
        settings: ReplaySettings,
        wall: Callable[[], float] = time.monotonic,
    ) -> None:
        """Publish the latched messages and the clock of the start.

        Args:
            timeline: What is replayed.
            sink: Where messages go.
            settings: How.
            wall: Reads the wall time [s].

        Raises:
            OSError: A file cannot be read.
            ValueError: The rate is not valid, or the start is after the end.
        """
        self._timeline, self._sink, self._settings, self._wall = timeline, sink, settings, wall
        self._end_ns = find_end(settings, timeline.duration_ns)
        self._clock = ReplayClock(settings.rate, wall(), is_paused=settings.is_paused)
        self._ahead: deque[TimedMessage] = deque()
        self._ahead_bytes = 0
        self._clock_due_s = wall() if settings.clock_hz else float("inf")
        self._clock_ns = -1
        self.epoch = 0
        """Epoch of the clock: how often time went back."""
        self.published = 0
        """Messages, without those of the clock."""
        self.latched = 0
        """Messages on latched topics; `published` counts them, too."""
        self.lateness = Lateness()
        self.is_done = False
        """Whether the end was reached, and there is no loop."""
        self._started_s, self._ended_s = wall() + settings.delay_s, 0.0
        self._begin(settings.start_ns, settings.delay_s)

    @property
    def wall_s(self) -> float:
        """Wall time since the start."""
        return (self._ended_s or self._wall()) - self._started_s

    @property
    def is_paused(self) -> bool:
        """Whether it is paused."""
        return self._clock.is_paused

    @property
    def rate(self) -> float:
        """Recorded time per wall time; 0 = as fast as possible."""
        return self._clock.rate

    @property
    def duration_ns(self) -> int:
        """Duration of the whole recording."""
        return self._timeline.duration_ns

    def find_position(self) -> int:
        """Find the position; at rate 0 that of the last message."""
        position_ns = self._clock.read(self._wall())
        if position_ns == UNLIMITED_NS:
            return self._reached_ns
        return min(max(position_ns, self._reached_ns), self._end_ns)

    def find_log_ns(self) -> int:
        """Find the time that the clock has."""
        return self._timeline.find_log_ns(self.find_position(), self._run)

    def advance(self) -> float:
        """Publish what is due; return the wall time when the next message or clock is."""
        limit_ns = self._clock.read(self._wall())
        # While it is paused, only `play_next` publishes messages, which may have equal times.
        for _ in range(0 if self.is_paused else MAX_BATCH):
            if not (self._ahead or self._pull()):
                self._end_pass()
                break
            position_ns = self._ahead[0][0]
            if position_ns > limit_ns:
                break
            if self._clock.is_paced:
                self.lateness.add(self._wall() - self._clock.find_due_s(position_ns))
            self._publish_first()
        if self._wall() >= self._clock_due_s:
            self._publish_clock()
        return min(self._find_next_s(), self._clock_due_s)

    def read_ahead(self, until_s: float) -> None:
        """Read messages that are not due yet, until a wall time or until enough are read."""
        while len(self._ahead) < MAX_AHEAD and self._ahead_bytes < MAX_AHEAD_BYTES:
            if self._wall() >= until_s or not self._pull():
                return

    def pause(self) -> None:
        """Stop the time."""
        self._reached_ns = self.find_position()  # at rate 0, time goes on from here
        self._clock.pause(self._reached_ns, self._wall())

    def resume(self) -> None:
        """Continue."""
        self._clock.resume(self._wall())

    def toggle(self) -> None:
        """Pause, or resume."""
        if self.is_paused:
            self.resume()
        else:
            self.pause()

    def set_rate(self, rate: float) -> None:
        """Change the rate.

        Raises:
            ValueError: It is not valid.
        """
        position_ns = self.find_position()
        self._clock.set_rate(rate, position_ns, self._wall())
        self._reached_ns = position_ns

    def seek(self, position_ns: int) -> None:
        """Continue from a position, latched messages first.

        Raises:
            OSError: A file cannot be read.
            ValueError: The position is outside of what is replayed.
        """
        start_ns = self._settings.start_ns
        if not start_ns <= position_ns <= self._end_ns:
            raise ValueError(
                f"position {position_ns / NANOSECONDS:g} s is outside of the replay; use "
                f"{start_ns / NANOSECONDS:g} to {self._end_ns / NANOSECONDS:g}"
            )
        self._begin(position_ns)

    def play_next(self, count: int = 1) -> int:
        """Publish the next messages of a paused replay; return how many there were.

        Raises:
            ValueError: They are more than `MAX_BATCH`: other requests and signals would wait.
        """
        if count > MAX_BATCH:
            raise ValueError(f"{count} messages are too many; use at most {MAX_BATCH} a call")
        done = 0
        while self.is_paused and done < count and (self._ahead or self._pull()):
            done += self._publish_first()
            self._clock.move(self.find_position(), self._wall())
        if done:
            self._publish_clock()
        return done

    def _begin(self, position_ns: int, delay_s: float = 0.0) -> None:
        self._messages: Iterator[TimedMessage] = self._timeline.messages(position_ns, self._end_ns)
        self._ahead.clear()
        self._ahead_bytes = 0
        self._reached_ns = position_ns
        self._enter_run(self._timeline.find_run(position_ns))
        # What was read until here is no part of the time.
        self._began_s = self._wall() + delay_s
        self._clock.move(position_ns, self._began_s)

    def _enter_run(self, run: int) -> None:
        """Publish the time and the latched messages of a position, which may be in another run."""
        self._run = run
        self._tick(self._timeline.find_log_ns(self._reached_ns, run))
        self._latched_end = self._timeline.find_latched_end(self._reached_ns, run)
        for topic, payload in self._timeline.read_latched(self._latched_end, run):
            self._publish(topic, payload)

    def _publish(self, topic: StoredTopic, payload: bytes) -> None:
        self._sink.publish(topic, payload)
        self.published += 1
        self.latched += topic.is_latched

    def _end_pass(self) -> None:
        if self.is_paused:
            return
        if self._settings.is_loop:
            self._begin(
                self._settings.start_ns, max(0.0, self._began_s + LEAST_PASS_S - self._wall())
            )
        else:
            self._publish_clock()
            self.is_done, self._ended_s = True, self._wall()

    def _pull(self) -> bool:
        """Read one message; False at the end."""
        message = next(self._messages, None)
        if message is None:
            return False
        self._ahead.append(message)
        self._ahead_bytes += len(message[3])
        return True

    def _publish_first(self) -> bool:
        """Publish the first message that was read; False if it was already published."""
        position_ns, run, topic, payload = self._ahead.popleft()
        self._ahead_bytes -= len(payload)
        self._reached_ns = position_ns
        if run != self._run:
            self._enter_run(run)
        if topic.is_latched and position_ns <= self._latched_end:
            return False
        self._publish(topic, payload)
        return True

    def _find_next_s(self) -> float:
        if self.is_done or self.is_paused:
            return float("inf")
        return self._clock.find_due_s(self._ahead[0][0]) if self._ahead else self._began_s

    def _publish_clock(self) -> None:
        self._tick(self.find_log_ns())
        if self._settings.clock_hz:
            self._clock_due_s = max(self._clock_due_s + 1.0 / self._settings.clock_hz, self._wall())

    def _tick(self, time_ns: int) -> None:
        self.epoch += time_ns < self._clock_ns
        self._clock_ns = time_ns
        if self._settings.clock_hz:
            self._sink.publish_clock(time_ns, self.epoch)
