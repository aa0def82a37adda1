"""`zensim.Recording`: topics, messages, tables and attachments of a recording."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import zensim
from tests.recording.recordings import write_recording
from zensim.api.recording_file import StoredValue
from zensim.deploy.cli import bag_commands
from zensim.recording.file_index import read_index
from zensim.recording.mcap_records import Metadata

MESSAGES = 300
PERIOD_S = 0.02


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> zensim.Recording:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    write_recording(path, MESSAGES)
    return zensim.Recording(path)


def test_contents(recording: zensim.Recording) -> None:
    assert recording.topics["/r0/odom"] == "nav_msgs/msg/Odometry"
    assert recording.counts["/r0/odom"] == MESSAGES / 3
    assert (recording.start, recording.end) == (0.0, (MESSAGES - 1) * PERIOD_S)
    assert recording.is_closed
    assert recording.attachment("world.sdf") == b"<sdf/>"


def test_messages_of_some_topics_within_a_time(recording: zensim.Recording) -> None:
    found = list(recording.messages("r0/odom", start=1.0, end=2.0))

    assert [one.topic for one in found] == ["/r0/odom"] * len(found)
    assert found[0].time >= 1.0
    assert found[-1].time <= 2.0
    assert found[0].data.header.stamp.sec == 1  # type: ignore[attr-defined]


def test_table_has_a_row_for_each_message(recording: zensim.Recording) -> None:
    table = recording.table("*/odom", end=1.0)

    assert np.array_equal(table["t_ns"], np.arange(51) * 20_000_000)
    assert table["robot"][:3].tolist() == ["r0", "r1", "r2"]


def test_unclosed_recording_is_read(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES, is_closed=False)

    recording = zensim.Recording(path)

    assert not recording.is_closed
    assert len(list(recording.messages())) == MESSAGES


def test_errors_say_what_is_missing(recording: zensim.Recording, tmp_path: Path) -> None:
    with pytest.raises(zensim.NotFound):
        zensim.Recording(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("no recording")
    with pytest.raises(zensim.Invalid):
        zensim.Recording(tmp_path / "text.mcap")
    with pytest.raises(zensim.NotFound):
        recording.attachment("mesh")
    with pytest.raises(zensim.NotFound):
        recording.table("*/scan")


@pytest.mark.parametrize("span", [{"start": float("nan")}, {"end": float("inf")}, {"end": "1"}])
def test_times_that_are_none_are_invalid(recording: zensim.Recording, span: dict[str, Any]) -> None:
    with pytest.raises(zensim.Invalid):
        recording.messages(**span)
    with pytest.raises(zensim.Invalid):
        recording.table("*/odom", **span)


def test_topic_that_is_no_text_is_invalid(recording: zensim.Recording) -> None:
    with pytest.raises(zensim.Invalid):
        recording.messages(7)  # type: ignore[arg-type]


def test_damage_and_further_files_are_known(tmp_path: Path) -> None:
    for name in ("run.mcap", "run_1.mcap"):
        facts = {} if name == "run.mcap" else {"part": "1"}
        write_recording(tmp_path / name, MESSAGES, metadata=[Metadata("zensim", facts)])
    content = bytearray((tmp_path / "run.mcap").read_bytes())
    place = read_index(tmp_path / "run.mcap").chunks[1]
    content[place.at + 80 : place.at + 88] = bytes(8)
    (tmp_path / "run.mcap").write_bytes(content)

    recording = zensim.Recording(tmp_path / "run.mcap")

    for _ in range(2):  # each place counts once
        assert len(list(recording.messages())) == MESSAGES - 100
    assert recording.damaged == 1
    assert recording.further_files == (tmp_path / "run_1.mcap",)
    export = ("export", str(recording.path), "*/odom", "--to", "csv", "-o", str(tmp_path / "out"))
    notes = CliRunner().invoke(bag_commands.app, export).stderr.splitlines()
    assert [text for text in ("run_1.mcap", "1 damaged") if not any(text in n for n in notes)] == []


def test_damaged_attachment_is_invalid(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    path.write_bytes(path.read_bytes().replace(b"<sdf/>", b"<sdg/>"))

    with pytest.raises(zensim.Invalid):
        zensim.Recording(path).attachment("world.sdf")


def test_file_that_is_gone_is_named(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    recording = zensim.Recording(path)
    path.unlink()

    with pytest.raises(zensim.NotFound):
        next(recording.messages())
    with pytest.raises(zensim.NotFound):
        recording.table("*/odom")


def test_folder_in_place_of_a_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").mkdir()
    (tmp_path / "run.mcap" / "run.mcap").mkdir()

    with pytest.raises(zensim.Error):
        zensim.Recording(tmp_path / "run.mcap")


def test_message_that_is_not_of_its_type_is_invalid() -> None:
    value = StoredValue("/r1/odom", "nav_msgs/msg/Odometry", 0.0, 0.0, b"\0\1\0\0\1")

    with pytest.raises(zensim.Invalid):
        _ = value.data
