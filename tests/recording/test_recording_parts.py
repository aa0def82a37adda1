"""Files of a recording: new ones by size, time and reset; metadata; snapshots; lost messages."""

import struct
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from tests.recording.recordings import count_by_mcap, make_topic
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Odometry, TFMessage
from zensim.recording import recording_parts
from zensim.recording.bag_info import read_info
from zensim.recording.mcap_records import AttachedFile, Metadata
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic
from zensim.recording.recording_parts import DiskFull, PartSettings, RecordingParts
from zensim.recording.snapshot_ring import SnapshotRing
from zensim.recording.write_queue import WriteQueue

SECOND = 1_000_000_000
ODOMETRY = encode(Odometry(), Format.CDR)
FACTS = AttachedFile("zensim.json", "application/json", b"{}")
ODOM = make_topic("r1/odom", Odometry)
TF_STATIC = make_topic("r1/tf_static", TFMessage)
STATIC = encode(TFMessage(), Format.CDR)


def odometry_at(time_s: float) -> RecordedMessage:
    return ODOM, round(time_s * SECOND), 0, ODOMETRY


def close(parts: RecordingParts[RecordedTopic]) -> None:
    parts.close([Metadata("zensim", {})], [FACTS])


def test_folder_is_a_bag_of_rosbag2(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run", max_duration_ns=SECOND)
    )
    parts.write((TF_STATIC, 0, 0, STATIC))
    for number in range(25):
        parts.write(odometry_at(number / 10))
    close(parts)

    with Reader(tmp_path / "run") as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
        read = sum(1 for _ in reader.messages())

    files = sorted(path.name for path in (tmp_path / "run").glob("*.mcap"))
    assert files == ["run_0.mcap", "run_1.mcap", "run_2.mcap"]
    assert counts == {"/r1/odom": 25, "/r1/tf_static": 3}
    assert read == 28 == parts.written


def test_each_file_begins_with_the_latched_messages(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=tmp_path / "run.mcap"))
    parts.write((TF_STATIC, 0, 0, STATIC))
    parts.write((TF_STATIC, 5, 0, STATIC))
    parts.start_part(7, 8)
    parts.write(odometry_at(1.0))
    close(parts)

    assert count_by_mcap(tmp_path / "run.mcap") == {"/r1/tf_static": 1}
    assert count_by_mcap(tmp_path / "run_1.mcap") == {"/r1/tf_static": 1, "/r1/odom": 1}


def test_file_ends_at_its_size(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run.mcap", max_bytes=4000)
    )
    for number in range(40):
        parts.write(odometry_at(number))
        parts.flush_if_due(number)
    close(parts)

    sizes = [path.stat().st_size for path in tmp_path.glob("*.mcap")]
    assert len(sizes) > 1
    assert parts.written == 40


def test_file_has_metadata_of_rosbag2_beside_it(tmp_path: Path) -> None:
    for name in ("first", "second"):
        parts: RecordingParts[RecordedTopic] = RecordingParts(
            PartSettings(path=tmp_path / f"{name}.mcap")
        )
        parts.write(odometry_at(1.0))
        close(parts)

    with Reader(tmp_path) as reader:
        counts = [one.msgcount for one in reader.connections]

    # That of the first recording stays.
    assert counts == [1]
    assert "first.mcap" in (tmp_path / "metadata.yaml").read_text()


def test_only_the_last_files_are_kept_with_what_the_first_had(tmp_path: Path) -> None:
    settings = PartSettings(
        path=tmp_path / "run", max_duration_ns=SECOND, keep_ns=round(1.7 * SECOND)
    )
    parts: RecordingParts[RecordedTopic] = RecordingParts(settings)
    parts.attach(AttachedFile("world.sdf", "text/xml", b"<sdf/>"))
    parts.write((TF_STATIC, 0, 0, STATIC))
    for number in range(100):
        parts.write(odometry_at(number / 10))
    close(parts)

    files = sorted(path.name for path in (tmp_path / "run").glob("*.mcap"))
    assert files == ["run_7.mcap", "run_8.mcap", "run_9.mcap"]
    with Reader(tmp_path / "run") as reader:
        assert sum(1 for _ in reader.messages()) == parts.written - parts.deleted == 33
    assert "world.sdf" in read_info(tmp_path / "run" / "run_7.mcap").attachments
    assert parts.written_bytes == read_info(tmp_path / "run").size


def test_equal_messages_give_equal_files(tmp_path: Path) -> None:
    for name, pause_s in (("one", 0.01), ("two", 0.4)):
        path = tmp_path / f"{name}.mcap"
        parts: RecordingParts[RecordedTopic] = RecordingParts(
            PartSettings(path=path, is_reproducible=True)
        )
        for number in range(100):
            parts.write(odometry_at(number / 10))
            parts.flush_if_due(number * pause_s)
        close(parts)

    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()


def test_recording_refuses_to_write_over_another(tmp_path: Path) -> None:
    for name in ("run.mcap", "folder"):
        close(RecordingParts(PartSettings(path=tmp_path / name)))
        with pytest.raises(FileExistsError):
            RecordingParts(PartSettings(path=tmp_path / name))


def test_recording_ends_before_the_disk_is_full(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run.mcap", min_free_bytes=1 << 62)
    )
    parts.write(odometry_at(0.0))

    with pytest.raises(DiskFull, match="--min-free"):
        parts.flush_if_due(10.0)
    close(parts)

    assert count_by_mcap(tmp_path / "run.mcap") == {"/r1/odom": 1}


def test_queue_counts_what_has_no_room(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=tmp_path / "run.mcap"))
    queue = WriteQueue(parts, max_bytes=len(ODOMETRY) * 2)

    queue.put([odometry_at(number) for number in range(2)])
    queue.put([odometry_at(number) for number in range(3)])
    queue.stop()
    close(parts)

    assert (parts.written, queue.lost) == (2, 3)


def test_queue_counts_what_comes_after_a_failure(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run.mcap", min_free_bytes=1 << 62)
    )
    queue = WriteQueue(parts, max_bytes=1 << 20)

    queue.put([odometry_at(number) for number in range(2)])
    queue.stop()
    close(parts)

    assert isinstance(queue.failure, DiskFull)
    assert parts.written + queue.lost + parts.offered - parts.written == 2


def test_queue_ends_with_any_failure_of_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=tmp_path / "run.mcap"))
    monkeypatch.setattr(parts, "write", lambda _: struct.pack("<H", 1 << 16))
    queue = WriteQueue(parts, max_bytes=1 << 20)

    queue.put([odometry_at(number) for number in range(3)])
    queue.stop()
    close(parts)

    assert isinstance(queue.failure, OSError)
    assert isinstance(queue.failure.__cause__, struct.error)
    assert queue.lost == 2  # besides the one that failed


def test_recording_ends_before_a_file_has_more_channels_than_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_parts, "MAX_CHANNELS", 1)
    path = tmp_path / "run.mcap"
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=path))
    queue = WriteQueue(parts, max_bytes=1 << 20)

    queue.put([odometry_at(0.0), (TF_STATIC, 0, 0, STATIC), odometry_at(1.0)])
    queue.stop()
    close(parts)

    assert isinstance(queue.failure, OSError)
    assert count_by_mcap(path) == {"/r1/odom": 1}


def test_ring_keeps_the_last_seconds_and_latched_messages() -> None:
    ring = SnapshotRing(span_ns=2 * SECOND, max_bytes=1 << 20)
    ring.add((TF_STATIC, 0, 0, STATIC))
    for number in range(10):
        ring.add(odometry_at(number))

    messages = ring.take()

    assert [(one[0], one[1] // SECOND) for one in messages] == [
        (TF_STATIC, 7),
        (ODOM, 7),
        (ODOM, 8),
        (ODOM, 9),
    ]
    assert ring.take() == []


def test_ring_keeps_no_more_bytes_than_it_may() -> None:
    ring = SnapshotRing(span_ns=0, max_bytes=3 * len(ODOMETRY))
    for number in range(10):
        ring.add(odometry_at(number))

    assert len(ring.take()) == 3
