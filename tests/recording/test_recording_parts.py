"""Files of a recording: new ones by size, time and reset; metadata; snapshots; lost messages."""

import struct
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from tests.recording.recordings import count_by_mcap, make_topic
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Odometry, TFMessage, TransformStamped
from zensim.recording import latched_messages, recording_parts
from zensim.recording.bag_info import read_info
from zensim.recording.latched_messages import LatchedMessages
from zensim.recording.mcap_records import AttachedFile, Metadata
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic
from zensim.recording.recording_parts import (
    DiskFull,
    PartSettings,
    RecordingParts,
    remove_recording,
)
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.snapshot_ring import SnapshotRing
from zensim.recording.write_queue import DirectWriter, WriteQueue
from zensim.recording.written_topics import OVERHEAD_BYTES

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


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_recording_that_was_cut_off_is_continued_in_the_next_file(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    for is_cut_off in (True, False):
        parts: RecordingParts[RecordedTopic] = RecordingParts(
            PartSettings(path=path, continues=True), Metadata("zensim", {"run": "1"})
        )
        parts.write(odometry_at(1.0))
        if is_cut_off:
            parts.flush_if_due(1.0)
        else:
            close(parts)

    first, second = (
        (path / "run_0.mcap", path / "run_1.mcap")
        if name == "run"
        else (path, tmp_path / "run_1.mcap")
    )
    assert [read_info(one).messages for one in (first, second)] == [1, 1]
    with Reader(first.parent) as reader:
        assert sum(1 for _ in reader.messages()) == 2


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


def test_file_that_was_moved_away_ends_no_recording_that_keeps_the_last(tmp_path: Path) -> None:
    path = tmp_path / "run"
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=path, max_duration_ns=SECOND, keep_ns=round(1.7 * SECOND))
    )
    for number in range(100):
        parts.write(odometry_at(number / 10))
        if number == 15:
            (path / "run_0.mcap").rename(tmp_path / "archived.mcap")
    close(parts)

    files = sorted(one.name for one in path.glob("*.mcap"))
    assert files == ["run_7.mcap", "run_8.mcap", "run_9.mcap"]
    assert parts.written_bytes == read_info(path).size
    assert (tmp_path / "archived.mcap").exists()


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

    with pytest.raises(DiskFull, match="`min_free`"):
        parts.flush_if_due(10.0)
    close(parts)

    assert count_by_mcap(tmp_path / "run.mcap") == {"/r1/odom": 1}


def test_queue_counts_what_has_no_room(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=tmp_path / "run.mcap"))
    queue = WriteQueue(parts, max_bytes=(OVERHEAD_BYTES + len(ODOMETRY)) * 2)

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


def test_small_messages_count_with_the_memory_that_they_take(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=tmp_path / "run.mcap"))
    queue = WriteQueue(parts, max_bytes=1000)
    ring = SnapshotRing(span_ns=0, max_bytes=1000)

    queue.put([(ODOM, 0, 0, b"\0\1\0\0")] * 10)
    for _ in range(10):
        ring.add((ODOM, 0, 0, b"\0\1\0\0"))
    queue.stop()
    close(parts)

    assert queue.lost == 10
    assert len(ring.take()) < 5


def test_file_ends_before_it_has_more_channels_than_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_parts, "MAX_CHANNELS", 2)
    path = tmp_path / "run.mcap"
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=path))
    topics = [make_topic(f"r{number}/odom", Odometry) for number in range(3)]

    for time_ns, topic in enumerate((*topics, topics[2], topics[0])):
        parts.write((topic, time_ns, 0, ODOMETRY))
    close(parts)

    assert count_by_mcap(path) == {"/r0/odom": 1, "/r1/odom": 1}
    assert count_by_mcap(tmp_path / "run_1.mcap") == {"/r0/odom": 1, "/r2/odom": 2}


def test_recording_ends_when_latched_topics_alone_are_too_many(
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
    assert count_by_mcap(tmp_path / "run_1.mcap") == {"/r1/tf_static": 1}


def test_next_file_is_whole_when_the_last_messages_of_one_could_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=path))
    parts.write(odometry_at(0.0))

    def fail(_writer: McapWriter) -> None:
        monkeypatch.undo()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "flush", fail)
    with pytest.raises(OSError, match="No space"):
        parts.start_part(SECOND, SECOND)
    close(parts)

    assert [count_by_mcap(tmp_path / name) for name in ("run.mcap", "run_1.mcap")] == [{}, {}]
    assert parts.written == 0


def test_discarded_recording_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "other.mcap").touch()
    for path in (tmp_path / "run.mcap", tmp_path / "run"):
        parts: RecordingParts[RecordedTopic] = RecordingParts(
            PartSettings(path=path, max_duration_ns=SECOND)
        )
        for number in range(3):
            parts.write(odometry_at(number))
        parts.discard()

    assert [one.name for one in tmp_path.iterdir()] == ["other.mcap"]


def test_removal_takes_the_files_of_one_recording_only(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap", "folder"):
        record_parts(tmp_path / name, 3)
    (tmp_path / "folder" / "mine.txt").touch()

    for name in ("a.mcap", "folder", "nothing.mcap"):
        remove_recording(tmp_path / name)

    left = sorted(one.name for one in tmp_path.rglob("*"))
    assert left == ["b.mcap", "b_1.mcap", "b_2.mcap", "folder", "mine.txt"]


def record_parts(path: Path, count: int, *, seed: str = "1") -> RecordingParts[RecordedTopic]:
    """Write a recording whose files have a message each."""
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=path, max_duration_ns=SECOND), Metadata("zensim", {"seed": seed})
    )
    for number in range(count):
        parts.write(odometry_at(number))
    close(parts)
    return parts


def test_removal_leaves_recordings_whose_names_look_like_parts(tmp_path: Path) -> None:
    for seed in (1, 2):
        record_parts(tmp_path / f"short_{seed}.mcap", 2)
    record_parts(tmp_path / "short.mcap", 3)
    (tmp_path / "short_7.mcap").write_bytes(b"no MCAP file")
    both = sorted(one.name for one in tmp_path.glob("*.mcap"))

    remove_recording(tmp_path / "short.mcap")

    left = sorted(one.name for one in tmp_path.glob("*.mcap"))
    kept = ["short_1.mcap", "short_1_1.mcap", "short_2.mcap", "short_2_1.mcap", "short_7.mcap"]
    assert left == kept
    assert both == sorted([*kept, "short.mcap", "short_3.mcap", "short_4.mcap"])


def test_removal_takes_what_is_left_of_a_recording_whose_first_files_are_deleted(
    tmp_path: Path,
) -> None:
    for name in ("run.mcap", "run"):
        record_parts(tmp_path / name, 4)
    for file in ("run.mcap", "run_1.mcap", "run/run_0.mcap"):
        (tmp_path / file).unlink()

    for name in ("run.mcap", "run"):
        remove_recording(tmp_path / name)

    assert [one.name for one in tmp_path.iterdir()] == []


def test_every_file_says_of_which_recording_it_is_also_before_its_end(tmp_path: Path) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run.mcap"), Metadata("zensim", {"seed": "3"})
    )
    parts.write(odometry_at(0.0))
    parts.start_part(1, 1)

    found = [RecordingReader(tmp_path / name).metadata for name in ("run.mcap", "run_1.mcap")]
    parts.discard()

    assert found == [{"zensim": {"seed": "3", "part": part}} for part in ("0", "1")]


def test_number_of_messages_does_not_fall_while_a_file_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run", max_duration_ns=SECOND, keep_ns=SECOND)
    )
    end, seen = McapWriter.close, list[int]()

    def close_slowly(writer: McapWriter) -> None:
        seen.append(parts.written)
        end(writer)

    monkeypatch.setattr(McapWriter, "close", close_slowly)
    for number in range(4):
        parts.write(odometry_at(number))
    close(parts)

    assert seen == [1, 2, 3, 4]


@pytest.mark.parametrize("is_direct", [True, False])
def test_message_for_which_no_file_can_be_created_counts_as_lost(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    is_direct: bool,  # noqa: FBT001
) -> None:
    parts: RecordingParts[RecordedTopic] = RecordingParts(
        PartSettings(path=tmp_path / "run.mcap", max_duration_ns=SECOND)
    )
    writer = DirectWriter(parts) if is_direct else WriteQueue(parts, max_bytes=1 << 20)

    def fail() -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(parts, "_open", fail)
    writer.put([odometry_at(number) for number in range(3)])
    writer.stop()
    close(parts)

    assert isinstance(writer.failure, OSError)
    assert (parts.written, writer.lost + parts.offered - parts.written) == (1, 2)


def test_metadata_of_a_recording_that_is_gone_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for count in (1, 2):
        path.unlink(missing_ok=True)
        parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=path))
        for number in range(count):
            parts.write(odometry_at(number))
        close(parts)

    with Reader(tmp_path) as reader:
        assert [one.msgcount for one in reader.connections] == [2]


def test_transforms_of_all_agents_are_latched_once_for_each_frame() -> None:
    latched: LatchedMessages[RecordedTopic] = LatchedMessages()
    topic = make_topic("tf_static", TFMessage)
    first, second = write_transforms("r1/base"), write_transforms("r2/base")
    moved = write_transforms("r1/base", "r1/lidar")

    added = [latched.add(topic, one) for one in (first, second, first, moved)]

    assert added == [True, True, False, True]
    assert [one[3] for one in latched.list_at(0, 0)] == [second, moved]


def test_latched_transforms_have_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    latched: LatchedMessages[RecordedTopic] = LatchedMessages()
    topic = make_topic("tf_static", TFMessage)
    messages = [write_transforms(f"r{number:02}/base") for number in range(20)]
    monkeypatch.setattr(latched_messages, "MAX_SHARED_BYTES", 5 * len(messages[0]))

    for one in messages:
        latched.add(topic, one)

    assert [one[3] for one in latched.list_at(0, 0)] == messages[-5:]


def write_transforms(*frames: str) -> bytes:
    transforms = tuple(TransformStamped(child_frame_id=frame) for frame in frames)
    return encode(TFMessage(transforms), Format.CDR)


def test_ring_keeps_the_last_seconds_and_latched_messages() -> None:
    ring = SnapshotRing(span_ns=2 * SECOND, max_bytes=1 << 20)
    ring.add((TF_STATIC, 0, 0, STATIC))
    for number in range(10):
        ring.add(odometry_at(number))

    held = len(ring)
    messages = ring.take()

    assert (held, len(ring)) == (3, 0)
    assert [(one[0], one[1] // SECOND) for one in messages] == [
        (TF_STATIC, 7),
        (ODOM, 7),
        (ODOM, 8),
        (ODOM, 9),
    ]
    assert ring.take() == []


def test_ring_keeps_no_more_bytes_than_it_may() -> None:
    ring = SnapshotRing(span_ns=0, max_bytes=3 * (OVERHEAD_BYTES + len(ODOMETRY)))
    for number in range(10):
        ring.add(odometry_at(number))

    assert len(ring.take()) == 3
