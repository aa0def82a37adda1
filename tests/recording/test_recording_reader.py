"""A reader gives the messages of a recording by time and topic, whatever files it has."""

import random
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from tests.recording.recordings import define_topics, write_recording
from zensim.proto.ros2.qos_profiles import LATCHED, RELIABLE_10
from zensim.recording import recording_reader
from zensim.recording.file_index import ChunkPlace
from zensim.recording.mcap_records import AttachedFile, Channel, MalformedRecord, Metadata, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile
from zensim.recording.recorded_topics import QOS_METADATA, read_qos_profile, write_qos_profiles
from zensim.recording.recording_reader import (
    Ordered,
    RecordedFile,
    RecordingReader,
    StoredMessage,
    StoredTopic,
)

MESSAGES = 1000
IN_A_CHUNK = 100
PERIOD_NS = 20_000_000


def write_times(path: Path, chunks: list[list[int]], topic: str = "/r1/odom") -> None:
    """Write messages with these log times [ns], whose payloads are their positions."""
    output = OutputFile(path)
    writer = McapWriter(output)
    (channel,) = define_topics(writer)
    writer.define(Schema(7, "std_msgs/msg/String", "ros2msg", b"string data\n"))
    qos = {QOS_METADATA: write_qos_profiles(LATCHED)}
    writer.define(Channel(70, 7, "/r1/robot_description", "cdr", qos))
    number = 0
    for times in chunks:
        for time_ns in times:
            used = channel if topic == "/r1/odom" else 70
            writer.write_message(used, time_ns, 0, str(number).encode())
            number += 1
        writer.flush()
    writer.close()
    output.close()


def is_first_robot(topic: StoredTopic) -> bool:
    return topic.name == "/r0/odom"


@pytest.mark.parametrize("is_closed", [True, False])
def test_reader_gives_the_messages_that_another_reader_gives(
    tmp_path: Path, *, is_closed: bool
) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    with path.open("rb") as stream:
        wanted = [
            (channel.topic, one.log_time, one.publish_time, one.data)
            for _, channel, one in make_reader(stream).iter_messages()
        ]
    if not is_closed:
        path.unlink()
        write_recording(path, MESSAGES, is_closed=False)

    reader = RecordingReader(path)

    found = [(topic.name, *rest) for topic, *rest in reader.messages()]
    assert found == wanted
    assert bool(reader.unclosed) is not is_closed
    assert {topic.name: count for topic, count in reader.counts.items()} == {
        "/r0/odom": 334,
        "/r1/odom": 333,
        "/r2/odom": 333,
        "/events": 0,
    }
    assert reader.end_ns == (MESSAGES - 1) * PERIOD_NS


def test_reader_gives_what_lies_within_times_of_chosen_topics(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)

    found = list(
        RecordingReader(path).messages(
            is_first_robot, start_ns=300 * PERIOD_NS, end_ns=600 * PERIOD_NS
        )
    )

    assert {topic.name for topic, *_ in found} == {"/r0/odom"}
    assert [time_ns // PERIOD_NS for _, time_ns, *_ in found] == list(range(300, 601, 3))


def test_reader_opens_no_chunk_without_chosen_topics(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)

    reader = RecordingReader(path)

    assert list(reader.chunks(lambda topic: topic.name == "/events")) == []
    assert len(list(reader.chunks(is_first_robot))) == MESSAGES // IN_A_CHUNK


def test_reader_sorts_messages_across_chunks_and_keeps_the_order_of_equal_times(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.mcap"
    generator = random.Random(1)
    chunks = [
        [max(0, number * 50 + generator.randrange(-60, 60)) for number in range(at, at + 20)]
        for at in range(0, 200, 20)
    ]
    write_times(path, chunks)

    found = list(RecordingReader(path).messages())

    written = [time_ns for times in chunks for time_ns in times]
    order = sorted(range(len(written)), key=lambda place: (written[place], place))
    assert [int(payload) for *_, payload in found] == order


def test_chunks_keep_the_order_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_times(path, [[5, 3], [4, 1]])

    found = list(RecordingReader(path).chunks())

    assert [[time_ns for _, time_ns, *_ in chunk] for chunk in found] == [[5, 3], [4, 1]]


def test_files_of_a_folder_are_one_run_until_time_goes_back(tmp_path: Path) -> None:
    second = 1_000_000_000
    write_times(tmp_path / "run_0.mcap", [[4 * second, 5 * second]])
    write_times(tmp_path / "run_1.mcap", [[5 * second - 9, 8 * second]])
    write_times(tmp_path / "run_2.mcap", [[second, 9 * second]])

    reader = RecordingReader(tmp_path)

    spans = [(run.start_ns // second, run.end_ns // second) for run in reader.runs]
    assert spans == [(4, 8), (1, 9)]
    times = [time_ns for _, time_ns, *_ in reader.messages()]
    assert times == [4 * second, 5 * second - 9, 5 * second, 8 * second, second, 9 * second]
    assert len(reader.topics) == len({topic.name for topic in reader.topics})


def test_reader_finds_the_last_latched_message_before_a_time(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_times(path, [[0, 10], [20, 30]], "/r1/robot_description")
    (run,) = RecordingReader(path).runs

    found = run.latched_at(25)

    assert [(topic.name, payload) for topic, _, _, payload in found] == [
        ("/r1/robot_description", b"2")
    ]
    assert found[0][0].qos.durability == "transient_local"


def test_damaged_chunk_is_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    content = bytearray(path.read_bytes())
    content[content.index(b"\x04\x00\x00\x00zstd") + 200] ^= 1
    path.write_bytes(content)
    reader = RecordingReader(path)

    found = list(reader.messages())

    assert len(found) == MESSAGES - IN_A_CHUNK
    assert reader.damaged == 1


@pytest.mark.parametrize("is_closed", [True, False])
def test_reader_gives_attached_files_and_metadata(tmp_path: Path, *, is_closed: bool) -> None:
    path = tmp_path / "run.mcap"
    output = OutputFile(path)
    writer = McapWriter(output)
    writer.attach(AttachedFile("world.sdf", "application/xml", b"<sdf/>"))
    writer.add_metadata(Metadata("zensim", {"world": "main"}))
    if is_closed:
        writer.close()
    output.close()

    reader = RecordingReader(path)

    assert [(one.name, one.size) for one in reader.attachments] == [("world.sdf", 6)]
    assert reader.read_attachment("world.sdf") == b"<sdf/>"
    assert reader.metadata == {"zensim": {"world": "main"}}
    with pytest.raises(KeyError):
        reader.read_attachment("other")


@pytest.mark.parametrize("use_chunking", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_reader_reads_files_of_another_writer(
    tmp_path: Path, compression: CompressionType, *, use_chunking: bool
) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, use_chunking=use_chunking, chunk_size=200)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/words", "cdr", schema)
        for number in range(100):
            writer.add_message(channel, number, b"%d" % number, number)
        writer.finish()  # type: ignore[no-untyped-call]

    reader = RecordingReader(path)

    assert [payload for *_, payload in reader.messages()] == [b"%d" % one for one in range(100)]
    assert reader.unclosed == ()


def test_qos_profile_is_read_in_numbers_and_words() -> None:
    text = (
        "- history: keep_last\n  depth: 1\n  reliability: reliable\n  durability: transient_local"
    )

    assert read_qos_profile(write_qos_profiles(LATCHED)) == LATCHED
    assert read_qos_profile(text) == LATCHED
    assert read_qos_profile("") == RELIABLE_10


@pytest.mark.parametrize("seed", range(40))
def test_reader_of_a_damaged_file_fails_nowhere(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    content, generator = bytearray(path.read_bytes()), random.Random(seed)
    # Half of them in the summary.
    least = 8 if seed % 2 else len(content) - 2000
    content[generator.randrange(least, len(content))] ^= 1 << generator.randrange(8)
    path.write_bytes(content)

    reader = RecordingReader(path)
    found = list(reader.messages())

    assert len(found) <= MESSAGES
    assert len(found) >= MESSAGES - IN_A_CHUNK or reader.damaged or not reader.unclosed


def test_seeks_read_latched_messages_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    write_times(
        path, [[number, number + 5] for number in range(0, 100, 10)], "/r1/robot_description"
    )
    (run,) = RecordingReader(path).runs
    read: list[ChunkPlace] = []
    load = RecordedFile.read_messages

    def count(
        file: RecordedFile,
        place: ChunkPlace,
        wanted: Mapping[int, StoredTopic],
        span: range,
        first: int = 0,
    ) -> list[Ordered]:
        read.append(place)
        return load(file, place, wanted, span, first)

    monkeypatch.setattr(RecordedFile, "read_messages", count)
    found = [run.latched_at(at)[0][3] for at in (50, 99, 12, 50, 3)]

    assert found == [b"10", b"19", b"2", b"10", b"0"]
    assert len(read) <= 11


def test_latched_messages_are_counted_once_after_an_error_between_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    write_times(path, [[0, 5], [10, 15], [20, 25]], "/r1/robot_description")
    monkeypatch.setattr(recording_reader, "MAX_LATCHED_BYTES", 6)
    (run,) = RecordingReader(path).runs
    list_messages, ends, begun = run.messages, [MalformedRecord("damaged")], [0]

    def fail_once(*arguments: Any, **options: Any) -> Iterator[StoredMessage]:  # noqa: ANN401
        begun[0] += 1
        yield from list(list_messages(*arguments, **options))[:3]
        if ends:
            raise ends.pop()
        yield from list(list_messages(*arguments, **options))[3:]

    monkeypatch.setattr(run, "messages", fail_once)
    with pytest.raises(MalformedRecord):
        run.latched_at(25)
    found = [run.latched_at(at)[0][3] for at in (25, 3, 12, 25)]

    assert found == [b"5", b"0", b"2", b"5"]
    assert begun == [2]


def test_latched_messages_beyond_the_limit_are_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    write_times(path, [[0, 5], [10, 15], [20, 25]], "/r1/robot_description")
    monkeypatch.setattr(recording_reader, "MAX_LATCHED_BYTES", 2)
    (run,) = RecordingReader(path).runs

    found = [run.latched_at(at)[0][3] for at in (25, 3, 12, 99)]

    assert found == [b"5", b"0", b"2", b"5"]
