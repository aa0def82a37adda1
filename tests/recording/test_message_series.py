"""Numbers of a recording over time, and their charts."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import msgspec
import numpy as np
import pytest
from PIL import Image

from tests.integration.processes import run_in_process
from tests.recording.recordings import make_topic
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    LaserScan,
    Odometry,
    String,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from zensim.recording.message_series import (
    MessageSeries,
    NoSuchSeries,
    parse_series_choice,
    read_series,
)
from zensim.recording.recorded_topics import RecordedTopic
from zensim.recording.recording_parts import PartSettings, RecordingParts
from zensim.recording.recording_reader import RecordingReader

ROWS = 50
PERIOD_NS = 20_000_000


def make_odometry(number: int) -> Odometry:
    twist = Twist(Vector3(x=number / 10.0), Vector3(z=-1.0))
    return Odometry(Header(), "base", twist=TwistWithCovariance(twist))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Odometry of three robots, joints, a scan, and statistics as JSON."""
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    parts = RecordingParts[RecordedTopic](PartSettings(path=path))
    odometry = [make_topic(name, Odometry) for name in ("r1/odom", "r2/odom", "team/r3/odom")]
    messages = [
        (make_topic("r1/joint_states", JointState), JointState(Header(), ("a", "b"), (1.5, 2.5))),
        (make_topic("r1/scan", LaserScan), LaserScan(Header(), ranges=(0.5,) * 90 + (3.0,))),
        (make_topic("sim/default/stats", String), String(json.dumps({"late": {"max": 0.25}}))),
    ]
    for number in range(ROWS):
        payload = encode(make_odometry(number), Format.CDR)
        for topic in odometry:
            parts.write((topic, number * PERIOD_NS, number, payload))
        for other, message in messages:
            parts.write((other, number * PERIOD_NS, number, encode(message, Format.CDR)))
    parts.close()
    return path


def read(recording: Path, text: str) -> list[MessageSeries]:
    return read_series(RecordingReader(recording), [parse_series_choice(text)])


def test_series_have_the_values_and_times_of_each_topic(recording: Path) -> None:
    first, second = read(recording, "r*/odom:twist.linear.x")

    assert [first.topic, second.topic] == ["/r1/odom", "/r2/odom"]
    assert (first.field, first.unit, first.run) == ("twist.twist.linear.x", "m/s", 0)
    assert np.array_equal(first.values, np.arange(ROWS) / 10.0)
    assert first.times_s == pytest.approx(np.arange(ROWS) * 0.02)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("/team/r3/odom:twist.twist.angular.z", -1.0),
        ("**/r3/odom:angular.z", -1.0),
        ("r1/joint_states:position[1]", 2.5),
        ("r1/scan:ranges[90]", 3.0),
        ("sim/*/stats:late.max", 0.25),
    ],
)
def test_field_is_named_by_its_path_or_the_end_of_it(
    recording: Path, text: str, value: float
) -> None:
    (found,) = read(recording, text)

    assert found.values.tolist() == [value] * ROWS


def test_part_of_the_time_is_chosen(recording: Path) -> None:
    choice = parse_series_choice("r1/odom:linear.x")

    (found,) = read_series(
        RecordingReader(recording), [choice], start_ns=10 * PERIOD_NS, end_ns=19 * PERIOD_NS
    )

    assert found.values.tolist() == [number / 10.0 for number in range(10, 20)]


def test_number_that_a_json_text_lacks_is_nan(recording: Path) -> None:
    (found,) = read(recording, "sim/default/stats:late.min")

    assert np.isnan(found.values).all()


@pytest.mark.parametrize(
    "text",
    [
        "r9/odom:linear.x",
        "r1/odom:nothing",
        "r1/odom:x",
        "r1/odom:child_frame_id",
        "r1/scan:ranges",
        "r1/odom",
        ":x",
    ],
)
def test_what_is_not_there_or_no_number_is_refused(recording: Path, text: str) -> None:
    with pytest.raises(NoSuchSeries):
        read(recording, text)


def test_run_after_a_reset_is_a_series_of_its_own(tmp_path: Path) -> None:
    parts = RecordingParts[RecordedTopic](PartSettings(path=tmp_path / "run"))
    topic = make_topic("r1/odom", Odometry)
    payload = encode(make_odometry(1), Format.CDR)
    for time_ns in (5_000_000_000, 6_000_000_000):
        parts.write((topic, time_ns, 0, payload))
    parts.start_part(0, 0)
    for time_ns in (0, 1_000_000_000):
        parts.write((topic, time_ns, 0, payload))
    parts.close()

    found = read(tmp_path / "run", "r1/odom:linear.x")

    assert [(one.run, one.times_s.tolist()) for one in found] == [(0, [5.0, 6.0]), (1, [0.0, 1.0])]


def plot(recording: Path, target: Path, *arguments: str) -> tuple[int, str]:
    done = run_in_process("bag", "plot", str(recording), *arguments, "-o", str(target))
    return done.returncode, done.stdout


def test_svg_has_axes_with_units_and_a_legend_and_is_the_same_again(
    recording: Path, tmp_path: Path
) -> None:
    words = ("r*/odom:twist.linear.x", "sim/*/stats:late.max", "--json")
    status, output = plot(recording, tmp_path / "a.svg", *words)
    plot(recording, tmp_path / "b.svg", *words)

    text = (tmp_path / "a.svg").read_text()
    shown = {"".join(one.itertext()) for one in ET.fromstring(text).iter() if "text" in one.tag}
    assert status == ExitCode.OK
    assert {
        "simulation time [s]",
        "twist.twist.linear.x [m/s]",
        "/r1/odom:twist.twist.linear.x",
        "/r2/odom:twist.twist.linear.x",
        "/sim/default/stats:late.max",
    } <= shown
    assert [one["points"] for one in msgspec.json.decode(output)["series"]] == [ROWS] * 3
    assert (tmp_path / "b.svg").read_text() == text


def test_png_is_a_picture(recording: Path, tmp_path: Path) -> None:
    status, _ = plot(recording, tmp_path / "a.png", "r1/odom:linear.x")

    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size > (800, 300)
        assert len(picture.convert("RGB").getcolors(1 << 20) or ()) > 10
    assert status == ExitCode.OK


@pytest.mark.parametrize(
    ("target", "field", "status"),
    [
        ("a.bmp", "linear.x", ExitCode.USAGE),
        ("a.png", "nothing", ExitCode.USAGE),
        ("nowhere/a.png", "linear.x", ExitCode.NOT_FOUND),
    ],
)
def test_plot_that_cannot_be_is_refused(
    recording: Path, tmp_path: Path, target: str, field: str, status: ExitCode
) -> None:
    assert plot(recording, tmp_path / target, f"r1/odom:{field}")[0] == status


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, '{"a":' + "1" * 400 + "}", "", "{"]
)
def test_text_that_has_no_number_is_nan(tmp_path: Path, text: str) -> None:
    path = tmp_path / "run.mcap"
    parts = RecordingParts[RecordedTopic](PartSettings(path=path))
    topic = make_topic("sim/default/stats", String)
    parts.write((topic, 0, 0, encode(String(text), Format.CDR)))
    parts.close()

    (found,) = read(path, "sim/default/stats:a")

    assert not np.isfinite(found.values).any()
