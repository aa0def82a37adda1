"""`@mcap/core`, with which Foxglove reads files, finds what was recorded."""

import json
from pathlib import Path

import pytest

from tests.node_peers.node_packages import FOLDER, run_script
from tests.recording.recordings import count_by_mcap, write_recording

READER = FOLDER / "read_mcap.cjs"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    write_recording(path, 1000)
    return path


@pytest.mark.parametrize("form", [(), ("stream",)], ids=["indexed", "streamed"])
def test_foxgloves_reader_decodes_every_message(recording: Path, form: tuple[str, ...]) -> None:
    found = json.loads(run_script(READER, str(recording), *form))

    counts = {name: topic["count"] for name, topic in found["topics"].items()}
    assert found["profile"] == "ros2"
    assert {name: count for name, count in counts.items() if count} == count_by_mcap(recording)
    assert found["topics"]["/r0/odom"]["schema"] == "nav_msgs/msg/Odometry"


def test_foxgloves_reader_streams_a_file_that_was_never_closed(tmp_path: Path) -> None:
    path = tmp_path / "unclosed.mcap"
    write_recording(path, 1000, is_closed=False)

    found = json.loads(run_script(READER, str(path), "stream"))

    assert found["messages"] == 1000
