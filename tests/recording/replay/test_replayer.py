"""A replay publishes what is due, in order, with a clock that falls only with a higher epoch."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.fakes import ManualClock
from tests.recording.replays import (
    START_NS,
    KeptMessages,
    is_replayed,
    make_odometry,
    make_text,
    make_transforms,
    write_run,
)
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.replay.replay_clock import MAX_RATE
from zensim.recording.replay.replay_keyboard import ReplayKeyboard
from zensim.recording.replay.replay_timeline import ReplayTimeline
from zensim.recording.replay.replayer import Replayer, ReplaySettings

SECOND = 1_000_000_000
LATCHED_TOPICS = ("/tf_static", "/r1/robot_description")


class Trial:
    """A replay with a clock that is moved by hand."""

    def __init__(self, folder: Path, **settings: object) -> None:
        self.wall, self.sink = ManualClock(100.0), KeptMessages()
        timeline = ReplayTimeline(RecordingReader(folder).runs, is_replayed)
        chosen = ReplaySettings(**settings)  # type: ignore[arg-type]
        self.replayer = Replayer(timeline, self.sink, chosen, self.wall)

    def run(self, seconds: float) -> None:
        """Replay for a wall time."""
        end_s = self.wall.now_s + seconds
        while self.wall.now_s < end_s - 1e-9 and not self.replayer.is_done:
            self.replayer.advance()
            self.wall.sleep(0.01)
        self.replayer.advance()

    @property
    def is_clock_in_order(self) -> bool:
        """Whether the epoch rises wherever time falls, and only there."""
        pairs = zip(self.sink.clock, self.sink.clock[1:], strict=False)
        return all((a[1] < b[1]) == (b[0] < a[0]) for a, b in pairs)


@pytest.fixture
def make_trial(tmp_path: Path) -> Callable[..., Trial]:
    def make(**settings: object) -> Trial:
        path = tmp_path / "run_0.mcap"
        if not path.exists():
            write_run(path)
        return Trial(tmp_path, **settings)

    return make


MakeTrial = Callable[..., Trial]


@pytest.mark.parametrize(("rate", "wall_s"), [(1.0, 3.0), (2.0, 1.5), (0.5, 6.0)])
def test_messages_are_published_at_the_rate(
    make_trial: MakeTrial, rate: float, wall_s: float
) -> None:
    trial = make_trial(rate=rate)

    trial.run(wall_s)

    assert trial.sink.odometry == [make_odometry(number) for number in range(31)]
    assert trial.sink.clock[-1][0] == pytest.approx(START_NS + 3 * SECOND, abs=0.04 * SECOND)


def test_rate_0_publishes_everything_without_waiting(make_trial: MakeTrial) -> None:
    trial = make_trial(rate=0.0)

    while not trial.replayer.is_done:
        trial.replayer.advance()

    assert len(trial.sink.odometry) == 101
    assert trial.sink.clock[-1][0] == START_NS + 10 * SECOND


@pytest.mark.parametrize("start_s", [0.0, 0.05, 1.0, 3.0, 7.0])
def test_latched_topics_come_first_at_every_start(make_trial: MakeTrial, start_s: float) -> None:
    trial = make_trial(start_ns=round(start_s * SECOND))

    trial.run(0.5)

    description = make_text("<robot2/>" if start_s >= 4 else "<robot/>")
    assert trial.sink.messages[:3] == [
        ("/tf_static", make_transforms("r1/a")),
        ("/tf_static", make_transforms("r2/a")),
        ("/r1/robot_description", description),
    ]
    others = [name for name, _ in trial.sink.messages[3:]]
    assert others
    assert not set(others) & set(LATCHED_TOPICS)
    assert trial.sink.odometry[0] == make_odometry(-(-round(start_s * 100) // 10))


def test_latched_message_that_changes_is_published_at_its_time(make_trial: MakeTrial) -> None:
    trial = make_trial(start_ns=3 * SECOND)

    trial.run(2.0)

    assert ("/r1/robot_description", make_text("<robot2/>")) in trial.sink.messages[4:]


def test_loop_starts_again_with_a_higher_epoch(make_trial: MakeTrial) -> None:
    trial = make_trial(start_ns=8 * SECOND, end_ns=9 * SECOND, is_loop=True)

    trial.run(3.5)

    once = [make_odometry(number) for number in range(80, 91)]
    assert trial.sink.odometry[:33] == once * 3
    assert trial.sink.clock[-1][1] == 3
    assert trial.is_clock_in_order


def test_duration_ends_the_replay(make_trial: MakeTrial) -> None:
    trial = make_trial(start_ns=2 * SECOND, end_ns=3 * SECOND)

    trial.run(60.0)

    assert trial.replayer.is_done
    assert trial.sink.odometry == [make_odometry(number) for number in range(20, 31)]


def test_start_after_the_end_is_refused(make_trial: MakeTrial) -> None:
    with pytest.raises(ValueError, match="`start_offset`"):
        make_trial(start_ns=20 * SECOND)


def test_paused_replay_publishes_nothing_but_the_same_time(make_trial: MakeTrial) -> None:
    trial = make_trial()
    trial.run(1.0)
    before = len(trial.sink.messages)

    trial.replayer.pause()
    trial.run(5.0)
    times = {time_ns for time_ns, _ in trial.sink.clock[-20:]}
    trial.replayer.toggle()
    trial.run(0.5)

    assert len(times) == 1
    assert len(trial.sink.messages) == before + 5


def test_play_next_publishes_one_message_of_a_paused_replay(make_trial: MakeTrial) -> None:
    trial = make_trial(is_paused=True)
    assert trial.replayer.play_next(3) == 3

    trial.run(1.0)

    assert trial.sink.odometry == [make_odometry(number) for number in range(3)]
    assert trial.sink.clock[-1][0] == START_NS + 200_000_000
    trial.replayer.resume()
    assert trial.replayer.play_next() == 0


def test_messages_that_are_due_wait_while_it_is_paused(make_trial: MakeTrial) -> None:
    trial = make_trial()
    trial.run(1.0)
    trial.wall.sleep(0.5)
    trial.replayer.pause()
    before = trial.replayer.published

    trial.run(1.0)
    assert trial.replayer.published == before
    trial.replayer.play_next(2)
    trial.run(1.0)

    assert trial.replayer.published == before + 2
    assert trial.is_clock_in_order
    assert trial.replayer.find_position() == 1.5 * SECOND


def test_time_goes_on_from_a_pause_at_rate_0(make_trial: MakeTrial) -> None:
    trial = make_trial()
    trial.run(1.0)
    trial.wall.sleep(0.05)
    trial.replayer.pause()
    trial.replayer.set_rate(0.0)
    position_ns = trial.replayer.find_position()

    trial.replayer.resume()

    assert trial.replayer.find_position() >= position_ns


def test_rate_changes_from_where_it_is(make_trial: MakeTrial) -> None:
    trial = make_trial()
    trial.run(1.0)

    trial.replayer.set_rate(4.0)
    trial.run(0.5)

    assert len(trial.sink.odometry) == 31
    assert trial.is_clock_in_order
    with pytest.raises(ValueError, match="rate"):
        trial.replayer.set_rate(-1.0)


def test_seek_back_raises_the_epoch_and_seek_ahead_does_not(make_trial: MakeTrial) -> None:
    trial = make_trial()
    trial.run(1.0)

    trial.replayer.seek(8 * SECOND)
    trial.run(0.2)
    after_ahead = trial.replayer.epoch
    trial.replayer.seek(1 * SECOND)
    trial.run(0.2)

    assert (after_ahead, trial.replayer.epoch) == (0, 1)
    assert trial.is_clock_in_order
    assert trial.sink.messages[-6:-3] == [
        ("/tf_static", make_transforms("r1/a")),
        ("/tf_static", make_transforms("r2/a")),
        ("/r1/robot_description", make_text("<robot/>")),
    ]
    with pytest.raises(ValueError, match="outside"):
        trial.replayer.seek(11 * SECOND)


def test_reset_in_a_recording_raises_the_epoch(tmp_path: Path) -> None:
    write_run(tmp_path / "run_0.mcap", 2.0)
    write_run(tmp_path / "run_1.mcap", 2.0, start_ns=0)
    trial = Trial(tmp_path)

    trial.run(60.0)

    assert len(trial.sink.odometry) == 42
    assert trial.sink.clock[-1] == (2 * SECOND, 1)
    assert trial.is_clock_in_order


def test_replay_reads_ahead_no_more_than_it_may(make_trial: MakeTrial) -> None:
    trial = make_trial()
    trial.replayer.read_ahead(trial.wall.now_s + 1.0)

    trial.run(60.0)

    assert trial.sink.odometry == [make_odometry(number) for number in range(101)]
    assert trial.replayer.lateness.quantile_s(1.0) <= 0.011


@pytest.mark.parametrize("rate", [1.0, 0.0])
def test_delay_is_before_the_first_message_but_not_before_latched_ones(
    make_trial: MakeTrial, rate: float
) -> None:
    trial = make_trial(delay_s=5.0, rate=rate)

    trial.run(4.9)
    waiting = [name for name, _ in trial.sink.messages]
    trial.run(0.2)

    assert set(waiting) == set(LATCHED_TOPICS)
    assert trial.sink.odometry[:1] == [make_odometry(0)]
    assert trial.is_clock_in_order


@pytest.mark.parametrize(
    ("key", "start", "least", "most"),
    [("up", 1e5, 1e6, MAX_RATE), ("down", 1.0, 1e-3, 0.1), ("down", 1e-9, 1e-9, 1e-9)],
)
def test_keys_keep_the_rate_within_bounds(
    make_trial: MakeTrial, key: str, start: float, least: float, most: float
) -> None:
    trial = make_trial(rate=start)
    keyboard = ReplayKeyboard(trial.replayer, 0)

    for _ in range(100):
        keyboard.take({"up": b"\x1b[A", "down": b"\x1b[B"}[key])

    assert least <= trial.replayer.rate <= most


def test_keys_leave_a_replay_without_a_pace_as_it_is(make_trial: MakeTrial) -> None:
    trial = make_trial(rate=0.0)
    keyboard = ReplayKeyboard(trial.replayer, 0)

    keyboard.take(b"\x1b[A\x1b[B")

    assert trial.replayer.rate == 0.0
