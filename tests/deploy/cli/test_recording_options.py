"""Numbers that options of recordings refuse before a file is opened."""

import json
from pathlib import Path

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from zensim.deploy.cli import bag_commands, record_commands, replay_commands
from zensim.deploy.cli.record_commands import RecordOptions, make_session_settings
from zensim.deploy.cli.recording_options import TOPIC_LISTS, find_span, repeat_options
from zensim.proto.exit_codes import ExitCode
from zensim.recording.mcap_records import Metadata
from zensim.recording.mcap_writer import PRESETS
from zensim.recording.recorded_topics import RecordedTopic
from zensim.recording.recording_parts import PartSettings, RecordingParts
from zensim.recording.recording_reader import LAST_NS, RecordingReader

ROSBAG2_OPTIONS = {
    *("--all", "-a", "--regex", "-e", "--exclude-regex", "--topics", "--exclude-topics"),
    *("--output", "-o", "--storage", "-s", "--storage-preset-profile"),
    *("--max-bag-size", "-b", "--max-bag-duration", "-d", "--max-cache-size"),
    *("--use-sim-time", "--snapshot-mode", "--topic-types", "--exclude-topic-types"),
    "--custom-data",
}


@pytest.mark.parametrize(
    ("app", "words"),
    [
        (replay_commands.app, ("none.mcap", "--start-offset", "inf")),
        (replay_commands.app, ("none.mcap", "--playback-duration", "nan")),
        (replay_commands.app, ("none.mcap", "--delay", "inf")),
        (replay_commands.app, ("none.mcap", "--start-offset", "1e300")),
        (bag_commands.app, ("convert", "none.mcap", "-o", "new.mcap", "--duration", "inf")),
        (bag_commands.app, ("convert", "none.mcap", "-o", "new.mcap", "-d", "1e300")),
        (bag_commands.app, ("export", "none.mcap", "--duration", "nan")),
        (bag_commands.app, ("plot", "none.mcap", "/a:x", "--start-offset", "inf")),
        (record_commands.app, ("--all", "-o", "new", "--max-bag-duration", "inf")),
    ],
    ids=lambda one: " ".join(one[-2:]) if isinstance(one, tuple) else "",
)
def test_number_that_is_no_time_is_refused(
    app: typer.Typer, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    done = CliRunner().invoke(app, words)

    assert done.exit_code == ExitCode.USAGE
    assert isinstance(done.exception, SystemExit)
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("-a --exclude-topics /a /b -o new", "-a --exclude-topics /a --exclude-topics /b -o new"),
        ("--topics /a /b", "--topics /a --topics /b"),
        ("/a --topics /b", "/a --topics /b"),
        ("--topics /a run.mcap", "--topics /a run.mcap"),
        ("--topics /a bag", "--topics /a bag"),
        ("--topics /a folder", "--topics /a --topics folder"),
        ("--topics -o new", "--topics -o new"),
    ],
)
def test_option_of_topics_takes_several_values_but_no_recording(
    words: str, wanted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("bag", "folder"):
        (tmp_path / folder).mkdir()
    for file in ("run.mcap", "bag/bag_0.mcap"):
        (tmp_path / file).touch()

    assert " ".join(repeat_options(words.split(), TOPIC_LISTS)) == wanted


def test_storage_profile_that_is_unknown_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    done = CliRunner().invoke(
        record_commands.app, ("-a", "-o", "new", "--storage-preset-profile", "lz4")
    )

    assert done.exit_code == ExitCode.USAGE
    assert [*tmp_path.iterdir()] == []


def test_storage_profile_sets_the_compression() -> None:
    settings = [
        make_session_settings(RecordOptions(all_topics=True, storage_preset_profile=one)).parts
        for one in PRESETS
    ]

    assert [one.chunks for one in settings] == list(PRESETS.values())


def test_info_names_the_further_files_of_a_recording(tmp_path: Path) -> None:
    for name, count in (("run.mcap", 2), ("run_5.mcap", 1), ("folder", 2)):
        settings = PartSettings(path=tmp_path / name)
        parts = RecordingParts[RecordedTopic](settings, Metadata("zensim", {}))
        for _ in range(count):
            parts.start_part(1, 1)
        parts.close()

    notes = [
        CliRunner().invoke(bag_commands.app, ("info", str(tmp_path / name))).stderr
        for name in ("run.mcap", "run_5.mcap", "folder")
    ]

    assert "run_1.mcap to run_2.mcap" in notes[0]
    assert "run_5_1.mcap;" in notes[1]
    assert notes[2] == ""


def test_info_names_the_files_that_a_folder_lacks(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    parts = RecordingParts[RecordedTopic](PartSettings(path=folder), Metadata("zensim", {}))
    parts.start_part(1, 1)
    parts.close()
    (folder / "run_0.mcap").unlink()

    done = CliRunner().invoke(bag_commands.app, ("info", str(folder)))

    assert done.exit_code == ExitCode.OK
    assert "run_0.mcap" in done.stderr
    assert "run_1.mcap" not in done.stderr


def test_options_have_the_names_of_rosbag2() -> None:
    """Those of `ros2 bag record` whose meaning is the same; their short forms are the same, too."""
    declared = {name for one in get_command(record_commands.app).params for name in one.opts}

    assert declared >= ROSBAG2_OPTIONS


@pytest.mark.parametrize("storage", ["sqlite3", "rosbag_v2", ""])
def test_unknown_storage_is_refused_with_those_that_are_known(storage: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        record_commands.app, ("-a", "-s", storage, "-o", str(tmp_path / "new"))
    )

    assert done.exit_code == ExitCode.USAGE
    assert all(one in done.stderr for one in record_commands.STORAGES)


def test_custom_data_is_in_each_file_and_beside_them(tmp_path: Path) -> None:
    given = RecordOptions(
        all_topics=True, output=tmp_path / "run", custom_data=["who=ann", "note=a=b"]
    )
    parts = RecordingParts[RecordedTopic](make_session_settings(given).parts)
    parts.start_part(1, 1)
    parts.close()

    expected = {"who": "ann", "note": "a=b"}
    written = json.loads((tmp_path / "run" / "metadata.yaml").read_text())
    files = sorted((tmp_path / "run").glob("*.mcap"))
    found = [RecordingReader(file).metadata["custom_data"] for file in files]
    assert written["rosbag2_bagfile_information"]["custom_data"] == expected
    assert found == [expected] * 2


@pytest.mark.parametrize("pair", ["ann", "=ann", ""])
def test_custom_data_without_a_name_is_refused(pair: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        record_commands.app, ("-a", "-o", str(tmp_path / "new"), "--custom-data", pair)
    )

    assert done.exit_code == ExitCode.USAGE


@pytest.mark.parametrize(("start_s", "span_s"), [(0.0, None), (2.0, None), (0.5, 0.25)])
def test_part_of_a_recording_ends_after_its_length_or_with_the_recording(
    start_s: float, span_s: float | None
) -> None:
    start_ns, end_ns = find_span("--duration", start_s, span_s)

    assert start_ns == start_s * 1e9
    assert end_ns == (LAST_NS if span_s is None else start_ns + span_s * 1e9)


@pytest.mark.parametrize("span_s", [0.0, -1.0, float("nan")])
def test_part_without_a_length_is_refused(span_s: float) -> None:
    with pytest.raises(ValueError, match="--duration"):
        find_span("--duration", 0.0, span_s)
