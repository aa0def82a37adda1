"""`zensim.Recording`: topics, messages, tables and attachments of a recording."""

from pathlib import Path

import numpy as np
import pytest

import zensim
from tests.recording.recordings import write_recording

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
