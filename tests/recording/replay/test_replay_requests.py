"""A replay is paused, moved and stepped by requests and by keys."""

from pathlib import Path

import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.recording.replays import KeptMessages, is_replayed, make_odometry, write_run
from zensim.proto import replay_catalog as catalog
from zensim.proto.messages.replay_messages import (
    ReplayPlayNextRequest,
    ReplayReport,
    ReplayRequest,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.messages.result_messages import ServiceError
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.replay.replay_keyboard import ReplayKeyboard
from zensim.recording.replay.replay_requests import ReplayRequests
from zensim.recording.replay.replay_timeline import ReplayTimeline
from zensim.recording.replay.replayer import MAX_BATCH, Replayer, ReplaySettings

SECOND = 1_000_000_000


class RequestsTrial:
    """A replay with requests and keys."""

    def __init__(self, folder: Path) -> None:
        path = folder / "run.mcap"
        write_run(path)
        self.bus, self.wall, self.sink = MemoryBus(), ManualClock(), KeptMessages()
        timeline = ReplayTimeline(RecordingReader(path).runs, is_replayed)
        self.replayer = Replayer(timeline, self.sink, ReplaySettings(), self.wall)
        self.requests = ReplayRequests(self.bus, "w", self.replayer)
        self.keyboard = ReplayKeyboard(self.replayer, 0)
        self.bus.pumps = [self.requests.serve]

    def ask(self, service: str) -> ReplayReport:
        """Call a service without arguments."""
        found = {"pause": catalog.PAUSE, "resume": catalog.RESUME, "toggle": catalog.TOGGLE}
        return self.bus.call(found.get(service, catalog.GET_STATE), ReplayRequest(), world="w")


@pytest.fixture
def trial(tmp_path: Path) -> RequestsTrial:
    return RequestsTrial(tmp_path)


def test_requests_pause_and_resume(trial: RequestsTrial) -> None:
    assert [trial.ask(name).is_paused for name in ("pause", "resume", "toggle", "toggle")] == [
        True,
        False,
        True,
        False,
    ]


def test_seek_moves_and_the_report_says_where(trial: RequestsTrial) -> None:
    report = trial.bus.call(catalog.SEEK, ReplaySeekRequest(6.0), world="w")

    assert (report.position_s, report.time_ns, report.duration_s) == (6.0, 11 * SECOND, 10.0)
    assert trial.ask("get_state").epoch == 0
    assert trial.bus.call(catalog.SEEK, ReplaySeekRequest(1.0), world="w").epoch == 1


def test_rate_and_next_message_are_requested(trial: RequestsTrial) -> None:
    assert trial.bus.call(catalog.SET_RATE, ReplaySetRateRequest(2.5), world="w").rate == 2.5
    trial.ask("pause")

    trial.bus.call(catalog.PLAY_NEXT, ReplayPlayNextRequest(2), world="w")

    assert trial.sink.odometry == [make_odometry(0), make_odometry(1)]


@pytest.mark.parametrize("position_s", [-1.0, 11.0, 1e300, -1e300, float("inf"), float("nan")])
def test_seek_outside_of_the_recording_is_refused(trial: RequestsTrial, position_s: float) -> None:
    with pytest.raises(ServiceError):
        trial.bus.call(catalog.SEEK, ReplaySeekRequest(position_s), world="w")


def test_next_message_of_a_replay_that_plays_is_refused(trial: RequestsTrial) -> None:
    with pytest.raises(ServiceError, match="paused"):
        trial.bus.call(catalog.PLAY_NEXT, ReplayPlayNextRequest(), world="w")


def test_more_next_messages_than_a_batch_are_refused(trial: RequestsTrial) -> None:
    trial.ask("pause")

    with pytest.raises(ServiceError, match=str(MAX_BATCH)):
        trial.bus.call(catalog.PLAY_NEXT, ReplayPlayNextRequest(MAX_BATCH + 1), world="w")

    assert trial.sink.odometry == []
    trial.bus.call(catalog.PLAY_NEXT, ReplayPlayNextRequest(MAX_BATCH), world="w")
    assert len(trial.sink.odometry) == 101


def test_request_may_be_json_and_garbage_is_refused(trial: RequestsTrial) -> None:
    (sample,) = trial.bus.get("sim/w/replay/seek", payload=b'{"position_s": 3}')
    (refused,) = trial.bus.get("sim/w/replay/seek", payload=b"\xff\xff")
    other = trial.bus.get("sim/w/replay/other")

    assert (sample.encoding, sample.payload[:1]) == ("application/json", b"{")
    assert refused.payload
    assert other == []


def test_keys_do_what_those_of_rosbag2_do(trial: RequestsTrial) -> None:
    trial.keyboard.take(b" ")
    paused = trial.replayer.is_paused
    trial.keyboard.take(b"\x1b[C\x1b[")
    trial.keyboard.take(b"C")
    trial.keyboard.take(b"\x1b[A\x1b[A\x1b[Bx")

    assert paused
    assert trial.sink.odometry == [make_odometry(0), make_odometry(1)]
    assert trial.replayer.rate == pytest.approx(1.1)
    assert "paused" in trial.keyboard.describe()


def test_left_key_goes_back_but_not_before_the_start(trial: RequestsTrial) -> None:
    trial.replayer.seek(8 * SECOND)

    trial.keyboard.take(b"\x1b[D")
    once = trial.replayer.find_position()
    trial.keyboard.take(b"\x1b[D")

    assert (once, trial.replayer.find_position()) == (3 * SECOND, 0)
