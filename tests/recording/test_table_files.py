"""Exported tables have the values of the recording, in pandas, polars, CSV and NumPy."""

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import polars as pl
import pytest

from tests.integration.processes import run_in_process
from tests.recording.recordings import make_topic
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import (
    Header,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    String,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.recording.mcap_records import AttachedFile, Metadata
from zensim.recording.message_tables import find_table, find_unit
from zensim.recording.recording_parts import PartSettings, RecordingParts

if TYPE_CHECKING:
    from zensim.recording.recorded_topics import RecordedTopic

ROWS = 300
PERIOD_NS = 20_000_000
SEED = 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Odometry of three robots with random positions, transforms and a text."""
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=path))
    topics = [make_topic(f"r{number}/odom", Odometry) for number in (1, 2, 10)]
    for number, position in enumerate(make_positions()):
        pose = PoseWithCovariance(Pose(Point(*position.tolist())))
        stamp = Time(0, number)
        message = Odometry(Header(stamp, f"r{number % 3}/odom"), "base", pose)
        parts.write((topics[number % 3], number * PERIOD_NS, number, encode(message, Format.CDR)))
    transform = TFMessage((TransformStamped(), TransformStamped()))
    parts.write((make_topic("r1/tf", TFMessage), 0, 0, encode(transform, Format.CDR)))
    parts.write((make_topic("notes", String), 0, 0, encode(String("hello"), Format.CDR)))
    parts.close((Metadata("zensim", {}),), (AttachedFile("zensim.json", "", b"{}"),))
    return path


def make_positions() -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    return np.random.default_rng(SEED).normal(size=(ROWS, 3))


def export(recording: Path, folder: Path, *arguments: str) -> int:
    return run_in_process("bag", "export", str(recording), "-o", str(folder), *arguments).returncode


def test_pandas_and_polars_read_equal_values(recording: Path, tmp_path: Path) -> None:
    assert export(recording, tmp_path / "tables") == ExitCode.OK

    file = tmp_path / "tables" / "odom.parquet"
    frame, other = pd.read_parquet(file), pl.read_parquet(file)
    for number, axis in enumerate("xyz"):
        path = f"pose.pose.position.{axis}"
        assert np.array_equal(frame[path].to_numpy(), make_positions()[:, number])
        assert np.array_equal(other[path].to_numpy(), make_positions()[:, number])
    assert frame["t_ns"].tolist() == [number * PERIOD_NS for number in range(ROWS)]
    assert frame["robot"].tolist()[:4] == ["r1", "r2", "r10", "r1"]
    assert other["header.frame_id"].to_list()[:3] == ["r0/odom", "r1/odom", "r2/odom"]
    facts = json.loads((tmp_path / "tables" / "columns.json").read_text())
    assert facts["odom"]["columns"]["pose.pose.position.x"] == "m"
    assert {name: one["rows"] for name, one in facts.items()} == {"notes": 1, "odom": ROWS, "tf": 2}


def test_csv_and_npz_have_the_same_values(recording: Path, tmp_path: Path) -> None:
    chosen = ("*/odom", "--arrays", "--start-offset", "2", "--duration", "1")
    for name in ("csv", "npz"):
        assert export(recording, tmp_path / name, "--to", name, *chosen) == ExitCode.OK

    with (tmp_path / "csv" / "odom.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    with np.load(tmp_path / "npz" / "odom.npz") as stored:
        arrays = dict(stored)
    first = 2_000_000_000 // PERIOD_NS
    assert len(rows) == len(arrays["t_ns"]) == 51
    assert float(rows[0]["pose.pose.position.y"]) == make_positions()[first, 1]
    assert arrays["pose.pose.position.z"][1] == make_positions()[first + 1, 2]
    assert arrays["pose.covariance"].shape == (51, 36)
    assert float(rows[0]["pose.covariance[35]"]) == arrays["pose.covariance"][0, 35]


def test_export_says_what_is_wrong(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()

    assert export(recording, tmp_path, "--to", "csv") == ExitCode.FAILED
    assert export(recording, tmp_path / "none", "--to", "hdf5") == ExitCode.USAGE
    assert export(recording, tmp_path / "none", "*/scan") == ExitCode.USAGE


def test_tables_are_named_by_the_topics_of_robots() -> None:
    assert find_table("/r1/odom") == ("odom", "r1")
    assert find_table("/fleet/r1/image_raw/compressed") == ("image_raw/compressed", "fleet/r1")
    assert find_table("/tf") == ("tf", "")
    assert find_table("/notes") == ("notes", "")


def test_columns_have_units() -> None:
    assert find_unit("twist.twist.angular.z") == "rad/s"
    assert find_unit("transform.rotation.w") == "1"
    assert find_unit("header.frame_id") == ""


def test_tables_of_similar_topics_have_files_of_their_own(tmp_path: Path) -> None:
    path, folder = tmp_path / "run.mcap", tmp_path / "tables"
    parts: RecordingParts[RecordedTopic] = RecordingParts(PartSettings(path=path))
    for number, key in enumerate(("a/b", "a_b", "A_b")):
        text = encode(String(f"text {number}"), Format.CDR)
        parts.write((make_topic(key, String), number, number, text))
    parts.close()

    run_in_process("bag", "export", str(path), "--to", "csv", "-o", str(folder))

    files = json.loads((folder / "columns.json").read_text())
    assert len({one["file"].casefold() for one in files.values()}) == 3
    rows = [(folder / one["file"]).read_text().splitlines()[1] for one in files.values()]
    assert sorted(row.split(",")[-1] for row in rows) == ["text 0", "text 1", "text 2"]
    assert not list(folder.glob(".*"))
