"""A recording in place of a world: what the page gets, and how it is played."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.deploy.recorded_worlds import MESH, MESH_NAME, write_world
from tests.fakes import ManualClock
from zensim.deploy.recorded_network import (
    LOOK_BACK_NS,
    NotForThePage,
    RecordedNetwork,
    RecordedPlayback,
)
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.replay_messages import (
    ReplayReport,
    ReplayRequest,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import ResetSimulationRequest
from zensim.proto.messages.spawn_messages import DeleteEntityRequest
from zensim.proto.messages.standard_messages import NANOSECONDS, Odometry, String
from zensim.proto.messages.telemetry_messages import GetModelsRequest, Snapshot
from zensim.proto.replay_catalog import PAUSE, RESUME, SEEK, SET_RATE
from zensim.proto.service_catalog import DELETE_ENTITY, GET_ASSET, GET_MODELS, RESET_SIMULATION
from zensim.recording.recording_reader import RecordingReader


@dataclass
class Replay:
    """A network, its clock, and the subscription to snapshots."""

    network: RecordedNetwork
    clock: ManualClock

    def __post_init__(self) -> None:
        self.snapshots = self.network.subscribe("sim/default/snapshot")

    def show(self) -> Snapshot | None:
        """Return the newest snapshot, if there is one."""
        sample = self.snapshots.newest()
        return decode(Snapshot, sample.payload, sample.encoding) if sample else None

    def find_x(self) -> float | None:
        """Return the x [m] of the first entity of a new snapshot; it equals its time [s]."""
        snapshot = self.show()
        return float(np.frombuffer(snapshot.base)[0]) if snapshot else None

    def call(self, service: object, request: msgspec.Struct) -> msgspec.Struct:
        """Call a service."""
        return self.network.call(service, request, world="default")  # type: ignore[arg-type]


@pytest.fixture
def replay(tmp_path: Path) -> Replay:
    clock = ManualClock()
    return Replay(RecordedNetwork(RecordingReader(write_world(tmp_path / "a.mcap")), clock), clock)


def test_snapshots_appear_when_their_time_has_come(replay: Replay) -> None:
    first = replay.find_x()
    replay.clock.sleep(2.34)

    assert first == 0.0
    assert replay.find_x() == pytest.approx(2.3)
    assert replay.network.world == "default"


def test_topics_of_robots_are_played_too(replay: Replay) -> None:
    odometry = replay.network.subscribe("r0/odom", depth=10)
    replay.clock.sleep(1.05)

    taken = [decode(Odometry, one.payload, one.encoding).child_frame_id for one in odometry.take()]
    replay.clock.sleep(0.2)

    assert taken == ["10"]
    assert [one.key for one in odometry.take()] == ["r0/odom"] * 2


def test_models_are_those_of_the_entities_of_the_snapshot(replay: Replay) -> None:
    first = replay.show()
    early = replay.call(GET_MODELS, GetModelsRequest())
    replay.clock.sleep(6.0)
    second = replay.show()
    late = replay.call(GET_MODELS, GetModelsRequest())

    assert first is not None
    assert second is not None
    assert [one.entity for one in early.entities] == ["r1"]  # type: ignore[attr-defined]
    assert [one.entity for one in late.entities] == ["r1", "r2"]  # type: ignore[attr-defined]
    assert (early.roster, late.roster) == (first.roster, second.roster)  # type: ignore[attr-defined]
    assert first.roster != second.roster


def test_meshes_come_in_parts(replay: Replay) -> None:
    content, total = b"", 1
    while len(content) < total:
        part = replay.network.call(
            GET_ASSET, GetAssetRequest(MESH_NAME, len(content)), world="default"
        )
        content, total = content + part.data, part.total

    assert content == MESH


def test_what_changes_the_world_is_refused(replay: Replay) -> None:
    with pytest.raises(ServiceError):
        replay.call(DELETE_ENTITY, DeleteEntityRequest(entity="r1"))
    with pytest.raises(ServiceError):
        replay.call(RESET_SIMULATION, ResetSimulationRequest())
    with pytest.raises(ServiceError):
        replay.call(GET_ASSET, GetAssetRequest("0" * 64))


def test_a_pause_stops_it_and_repeats_the_snapshot(replay: Replay) -> None:
    replay.clock.sleep(3.0)
    replay.find_x()

    replay.call(PAUSE, ReplayRequest())
    replay.clock.sleep(4.0)
    paused = replay.show()
    replay.call(RESUME, ReplayRequest())
    replay.clock.sleep(1.0)

    assert paused is not None
    assert (paused.state, paused.real_time_factor) == ("paused", 0.0)
    assert np.frombuffer(paused.base)[0] == pytest.approx(3.0)
    assert replay.find_x() == pytest.approx(4.0)


def test_a_rate_and_a_jump_move_it(replay: Replay) -> None:
    replay.call(SEEK, ReplaySeekRequest(1.0))
    jumped = replay.find_x()
    replay.call(SET_RATE, ReplaySetRateRequest(4.0))
    replay.clock.sleep(2.0)

    assert jumped == 1.0
    assert replay.find_x() == pytest.approx(9.0)


@pytest.mark.parametrize("loops", [True, False])
def test_at_its_end_it_pauses_or_begins_again(replay: Replay, *, loops: bool) -> None:
    replay.network.playback.loops = loops
    replay.clock.sleep(12.0)

    assert replay.find_x() == pytest.approx(2.0 if loops else 10.0)
    assert replay.network.playback.is_paused is not loops
    replay.network.playback.play()
    replay.clock.sleep(1.0)
    assert replay.find_x() == pytest.approx(3.0 if loops else 1.0)


@pytest.mark.parametrize("target_s", [0.0, 0.5, 4.95, 9.0, 99.0])
def test_a_jump_shows_what_was_there(replay: Replay, target_s: float) -> None:
    replay.clock.sleep(5.0)
    replay.find_x()

    replay.network.playback.seek(round(target_s * NANOSECONDS))

    assert replay.find_x() == pytest.approx(min(target_s, 10.0), abs=0.1)


@pytest.mark.parametrize(
    ("position_s", "wanted"),
    [(1e300, 10.0), (float("inf"), 10.0), (-1e300, 0.0), (float("nan"), 0.0)],
)
def test_a_jump_by_request_stays_within(replay: Replay, position_s: float, wanted: float) -> None:
    report = replay.call(SEEK, ReplaySeekRequest(position_s))

    assert isinstance(report, ReplayReport)
    assert report.position_s == wanted
    assert replay.find_x() == pytest.approx(wanted)


def test_runs_follow_each_other(tmp_path: Path) -> None:
    write_world(tmp_path / "a_0.mcap")
    write_world(tmp_path / "a_1.mcap", begin_s=0.0)
    clock = ManualClock()
    replay = Replay(RecordedNetwork(RecordingReader(tmp_path), clock), clock)

    clock.sleep(13.0)

    assert replay.find_x() == pytest.approx(3.0)
    assert replay.network.playback.duration_ns == 20 * NANOSECONDS


def test_a_recording_without_models_is_refused(tmp_path: Path) -> None:
    path = write_world(tmp_path / "a.mcap", has_models=False)

    with pytest.raises(NotForThePage):
        RecordedNetwork(RecordingReader(path))


@pytest.mark.parametrize(
    "payload",
    [
        b"\x00\x01\x00\x00",
        encode(String("{"), Format.CDR),
        encode(String('{"more":' + "[" * 100_000), Format.CDR),
    ],
    ids=["cut", "malformed", "deep"],
)
def test_the_last_snapshot_stays_where_later_ones_are_malformed(
    tmp_path: Path, payload: bytes
) -> None:
    path, clock = write_world(tmp_path / "a.mcap", malformed=payload), ManualClock()
    replay = Replay(RecordedNetwork(RecordingReader(path), clock), clock)
    clock.sleep(8.0)
    before = replay.find_x()

    clock.sleep(1.0)

    assert replay.find_x() == before == pytest.approx(8.0)


def test_malformed_models_are_skipped(tmp_path: Path) -> None:
    models = {"1": b"{", "2": b'{"entities": 3}', "x": b"{}", "3": b"\xff", "9" * 5000: b""}
    path = write_world(tmp_path / "a.mcap", models=models)

    replay = Replay(RecordedNetwork(RecordingReader(path)), ManualClock())
    found = replay.call(GET_MODELS, GetModelsRequest())

    assert [one.entity for one in found.entities] == ["r1"]  # type: ignore[attr-defined]


def test_models_that_are_all_malformed_are_refused(tmp_path: Path) -> None:
    path = write_world(tmp_path / "a.mcap", has_models=False, models={"1": b"{"})
    replay = Replay(RecordedNetwork(RecordingReader(path)), ManualClock())

    with pytest.raises(ServiceError):
        replay.call(GET_MODELS, GetModelsRequest())


@pytest.mark.parametrize(("rate", "kept"), [(1e9, 100.0), (0.0, 100.0), (1e-9, 0.01), (2.0, 2.0)])
def test_rates_are_limited(rate: float, kept: float) -> None:
    playback = RecordedPlayback(NANOSECONDS)

    playback.set_rate(rate)

    assert playback.rate == kept


@pytest.mark.parametrize("rate", [float("nan"), -1.0])
def test_a_rate_that_is_none_is_refused(replay: Replay, rate: float) -> None:
    with pytest.raises(ServiceError):
        replay.call(SET_RATE, ReplaySetRateRequest(rate))

    assert replay.network.playback.rate == 1.0


def test_a_report_has_the_time_of_the_recording(replay: Replay) -> None:
    report = replay.call(SEEK, ReplaySeekRequest(2.5))

    assert isinstance(report, ReplayReport)
    assert report.time_ns == round(102.5 * NANOSECONDS)


def test_messages_that_nobody_took_for_long_are_not_read(replay: Replay) -> None:
    odometry = replay.network.subscribe("r0/odom", depth=1000)
    odometry.take()
    replay.clock.sleep(9.0)

    taken = [decode(Odometry, one.payload, one.encoding).child_frame_id for one in odometry.take()]

    first_s = 9.0 - LOOK_BACK_NS / NANOSECONDS
    assert taken == [str(number) for number in range(round(10.0 * first_s), 91)]


def test_no_more_messages_wait_than_the_depth(replay: Replay) -> None:
    odometry = replay.network.subscribe("r0/odom", depth=3)
    odometry.take()
    replay.clock.sleep(1.0)

    taken = [decode(Odometry, one.payload, one.encoding).child_frame_id for one in odometry.take()]

    assert taken == ["8", "9", "10"]


def test_a_file_that_is_gone_ends_what_is_shown_and_nothing_else(
    replay: Replay, tmp_path: Path
) -> None:
    replay.clock.sleep(1.0)
    before = replay.find_x()
    (tmp_path / "a.mcap").unlink()

    replay.call(SEEK, ReplaySeekRequest(5.0))
    replay.clock.sleep(1.0)

    assert replay.find_x() == before
