"""Recordings are split, merged, filtered and compressed otherwise, without a lost message."""

from pathlib import Path
from typing import Any

import pytest

from tests.recording.recordings import count_by_mcap, count_by_rosbags, write_recording
from tests.recording.replays import SECOND, START_NS, make_text, write_run
from zensim.recording.bag_info import read_info
from zensim.recording.conversion import ConversionResult, ConversionSettings, convert_recordings
from zensim.recording.mcap_writer import PRESETS
from zensim.recording.recording_parts import PartSettings, RecordingParts
from zensim.recording.recording_reader import RecordingReader, StoredMessage, StoredTopic
from zensim.recording.topic_selection import TopicFilter, TopicSelection

EVERYTHING = TopicSelection(wants_all=True)
MESSAGES = 1000


def convert(
    *sources: Path,
    output: Path,
    selection: TopicSelection = EVERYTHING,
    parts: dict[str, Any] | None = None,
    **span: int,
) -> ConversionResult:
    """Convert recordings."""
    settings = ConversionSettings(
        chosen=TopicFilter(selection), parts=PartSettings(path=output, **(parts or {})), **span
    )
    return convert_recordings([RecordingReader(one) for one in sources], settings)


def list_messages(path: Path) -> list[tuple[str, int, int, bytes]]:
    messages = RecordingReader(path).messages()
    return [(topic.name, log_ns, at_ns, payload) for topic, log_ns, at_ns, payload in messages]


@pytest.mark.parametrize("preset", PRESETS)
def test_copy_has_all_messages_in_other_compression(tmp_path: Path, preset: str) -> None:
    source, output = tmp_path / "run.mcap", tmp_path / "copy.mcap"
    write_recording(source, MESSAGES)

    result = convert(source, output=output, parts={"chunks": PRESETS[preset]})

    assert list_messages(output) == list_messages(source)
    assert result.messages == MESSAGES
    assert count_by_mcap(output) == count_by_rosbags(output) == count_by_mcap(source)
    assert read_info(output).compressions == ("" if preset == "none" else "zstd",)
    assert RecordingReader(output).read_attachment("world.sdf") == b"<sdf/>"


def test_file_that_was_never_closed_is_converted(tmp_path: Path) -> None:
    source, output = tmp_path / "run.mcap", tmp_path / "copy.mcap"
    write_recording(source, MESSAGES, is_closed=False)

    convert(source, output=output)

    assert sum(count_by_rosbags(output).values()) == MESSAGES


def test_split_parts_are_whole_and_give_the_same_messages(tmp_path: Path) -> None:
    source, output = tmp_path / "run.mcap", tmp_path / "split"
    write_run(source)

    convert(source, output=output, parts={"max_duration_ns": 3 * SECOND})

    files = sorted(output.glob("*.mcap"))
    assert len(files) == 4
    for file in files:
        latched = [name for name, *_ in list_messages(file) if name == "/tf_static"]
        assert len(latched) == 2
    odometry = [one for one in list_messages(output) if one[0] == "/r1/odom"]
    assert odometry == [one for one in list_messages(source) if one[0] == "/r1/odom"]
    assert (output / "metadata.yaml").exists()


def test_merged_parts_are_the_recording_again(tmp_path: Path) -> None:
    source, split, output = tmp_path / "run.mcap", tmp_path / "split", tmp_path / "merged.mcap"
    write_run(source)
    convert(source, output=split, parts={"max_duration_ns": 3 * SECOND})

    convert(split, output=output)

    assert list_messages(output) == list_messages(source)


def test_recordings_are_merged_by_time(tmp_path: Path) -> None:
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_run(first)
    write_recording(second, MESSAGES)

    convert(first, second, output=tmp_path / "both.mcap")

    merged = list_messages(tmp_path / "both.mcap")
    times = [time_ns for _, time_ns, *_ in merged]
    assert times == sorted(times)
    assert len(merged) == len(list_messages(first)) + MESSAGES


def test_topics_and_times_are_chosen_with_what_was_latched_before(tmp_path: Path) -> None:
    source, output = tmp_path / "run.mcap", tmp_path / "short.mcap"
    write_run(source)
    chosen = TopicSelection(topics=("/r1/*",), exclude_topics=("/r1/custom",))

    convert(source, output=output, selection=chosen, start_ns=6 * SECOND, end_ns=7 * SECOND)

    found = list_messages(output)
    first = START_NS + 6 * SECOND
    assert found[0] == ("/r1/robot_description", first, first, make_text("<robot2/>"))
    assert [name for name, *_ in found[1:]] == ["/r1/odom"] * 11
    assert (found[1][1], found[-1][1]) == (first, first + SECOND)


def test_reset_begins_a_file_of_the_copy(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    write_run(folder / "run_0.mcap", 2.0)
    write_run(folder / "run_1.mcap", 2.0, start_ns=0)

    convert(folder, output=tmp_path / "copy")

    assert len(RecordingReader(tmp_path / "copy").runs) == 2
    copied = [one for one in list_messages(tmp_path / "copy") if one[0] == "/r1/odom"]
    assert copied == [one for one in list_messages(folder) if one[0] == "/r1/odom"]


def test_what_cannot_be_converted_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    source, folder = tmp_path / "run.mcap", tmp_path / "run"
    folder.mkdir()
    write_run(source, 1.0)
    write_run(folder / "run_0.mcap", 1.0)
    write_run(folder / "run_1.mcap", 1.0, start_ns=0)
    output = tmp_path / "out.mcap"

    with pytest.raises(ValueError, match="reset"):
        convert(source, folder, output=output)
    with pytest.raises(ValueError, match="chosen"):
        convert(source, output=output, selection=TopicSelection(topics=("/none",)))
    with pytest.raises(ValueError, match="start"):
        convert(source, output=output, start_ns=2_000_000_000)
    assert not output.exists()
    with pytest.raises(FileExistsError):
        convert(source, output=source)


@pytest.mark.parametrize("name", ["copy.mcap", "folder"])
def test_conversion_that_fails_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    source, output = tmp_path / "run.mcap", tmp_path / name
    write_recording(source, MESSAGES)
    before = sorted(tmp_path.iterdir())
    written: list[object] = []
    write = RecordingParts.write

    def fail_late(parts: RecordingParts[StoredTopic], message: StoredMessage) -> None:
        written.append(message)
        if len(written) == MESSAGES // 2:
            raise OSError(28, "No space left on device")
        write(parts, message)

    monkeypatch.setattr(RecordingParts, "write", fail_late)
    with pytest.raises(OSError, match="No space"):
        convert(source, output=output)

    assert len(written) == MESSAGES // 2
    assert sorted(tmp_path.iterdir()) == before


def test_split_files_take_no_name_of_another_recording(tmp_path: Path) -> None:
    source, other = tmp_path / "run.mcap", tmp_path / "copy_1.mcap"
    write_run(source)
    other.write_text("mine")

    with pytest.raises(FileExistsError):
        convert(source, output=tmp_path / "copy.mcap", parts={"max_duration_ns": 3 * SECOND})

    assert other.read_text() == "mine"
    assert sorted(one.name for one in tmp_path.glob("copy*")) == ["copy_1.mcap"]
