"""`zensim resim`: recordings of both kinds of result, and what it refuses."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from tests.sim_server.input_log.logged_worlds import STEPS_PER_S, LoggedWorld
from zensim.deploy.cli.resim_commands import MAX_ROWS, app, format_distances
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.standard_messages import NANOSECONDS, Header, Odometry, UInt8MultiArray
from zensim.proto.network_protocols import Sample
from zensim.proto.ros2.message_definitions import write_definition
from zensim.proto.topic_catalog import INPUTS
from zensim.recording.mcap_records import Channel, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile
from zensim.recording.recorded_topics import TopicTable
from zensim.sim_server.input_log.input_records import read_records, write_records
from zensim.sim_server.input_log.state_comparison import Distance
from zensim.sim_server.physics.engine_calls import Command

SECONDS = 2


def write_log(
    path: Path,
    messages: Sequence[Inputs],
    other_world: str = "",
    *,
    is_closed: bool = True,
    until_s: float = 0.0,
) -> None:
    """Write a recording as the recorder does, with another topic beside the log, or after it."""
    output = OutputFile(path)
    writer = McapWriter(output)
    table = TopicTable("default", lambda *_: True)
    for number, kind in enumerate((UInt8MultiArray, Odometry), 1):
        text = write_definition(kind).encode()
        writer.define(Schema(number, str(vars(kind)["ros_type"]), "ros2msg", text))
    writer.define(Channel(1, 1, "/sim/default/inputs", "cdr", {}))
    writer.define(Channel(2, 2, "/inputs", "cdr", {}))
    if other_world:
        writer.define(Channel(3, 1, f"/sim/{other_world}/inputs", "cdr", {}))
    for message in messages:
        sample = Sample(INPUTS.key("default"), encode(message, Format.MSGPACK), INPUTS.encoding)
        topic = table.find(sample)
        assert topic is not None
        writer.write_message(1, message.step, message.step, topic.to_cdr(sample))
        if other_world:
            writer.write_message(3, message.step, message.step, topic.to_cdr(sample))
        writer.write_message(2, message.step, message.step, encode(Odometry(Header()), Format.CDR))
    late_ns = messages[-1].step + round(until_s * NANOSECONDS)
    writer.write_message(2, late_ns, late_ns, encode(Odometry(Header()), Format.CDR))
    writer.flush()
    if is_closed:
        writer.close()
    output.close()


@pytest.fixture(scope="module")
def messages() -> list[Inputs]:
    logged = LoggedWorld("mujoco")
    logged.spawn_robots(2)
    for number in range(4):
        logged.drive(3.0 + number, 4.0)
        logged.step(SECONDS * STEPS_PER_S // 4)
    logged.log.close()
    return logged.messages


def resim(path: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    done = CliRunner().invoke(app, [str(path), "--json", *arguments])
    return done.exit_code, json.loads(done.stdout)


def turn_wheel_back(messages: Sequence[Inputs], after_s: float) -> list[Inputs]:
    """Change the sign of one number in each command after a time."""
    changed = []
    for message in messages:
        records = list(read_records(message.records))
        for place, one in enumerate(records):
            if isinstance(one, Command) and message.step > after_s * STEPS_PER_S:
                targets = bytearray(one.targets)
                targets[7] ^= 0x80
                records[place] = Command(one.group, bytes(targets))
        (data,) = write_records(records)
        changed.append(msgspec.structs.replace(message, records=data))
    return changed


def test_equal_run_has_status_0(messages: list[Inputs], tmp_path: Path) -> None:
    write_log(tmp_path / "run.mcap", messages)

    status, result = resim(tmp_path / "run.mcap")

    assert status == ExitCode.OK
    assert result["is_equal"]
    assert result["engine"] == "mujoco"
    assert result["open_ends"] == 0
    assert result["states"] == result["equal_states"] == SECONDS + 1
    assert result["steps"] == SECONDS * STEPS_PER_S


def test_changed_command_has_status_1_and_names_the_robot(
    messages: list[Inputs], tmp_path: Path
) -> None:
    write_log(tmp_path / "run.mcap", turn_wheel_back(messages, 1.1))

    status, result = resim(tmp_path / "run.mcap")

    first = result["first_difference"]
    assert status == ExitCode.FAILED
    assert first["entities"] == ["r0"]
    assert first["time_s"] == pytest.approx(1.5, abs=0.02)
    assert first["differences"][0]["entity"] == "r0"
    text = CliRunner().invoke(app, [str(tmp_path / "run.mcap")]).stdout
    assert "r0" in text
    assert str(first["step"]) in text


@pytest.mark.parametrize(
    "changes",
    [
        ("--engine", "pybullet"),
        ("--gravity", "0,0,-1.62"),
        ("--step-hz", "500"),
        ("--ground-friction", "0.1"),
        ("--report",),
    ],
    ids=lambda one: one[0],
)
def test_changes_report_distances(
    messages: list[Inputs], tmp_path: Path, changes: tuple[str, ...]
) -> None:
    write_log(tmp_path / "run.mcap", messages)

    status, result = resim(tmp_path / "run.mcap", *changes)

    assert status == ExitCode.OK
    assert not result["is_exact"]
    assert len(result["distances"]) == SECONDS + 1
    is_changed = changes != ("--report",)
    assert (result["distances"][-1]["max_m"] > 0.0) is is_changed
    text = CliRunner().invoke(app, [str(tmp_path / "run.mcap"), *changes]).stdout
    assert len(text.splitlines()) == 3 + SECONDS + 1


def test_lost_messages_have_status_1(messages: list[Inputs], tmp_path: Path) -> None:
    write_log(tmp_path / "run.mcap", [*messages[:9], *messages[12:]])

    status, result = resim(tmp_path / "run.mcap")

    assert status == ExitCode.FAILED
    assert result["lost_messages"] == 3


def test_log_that_joined_later_has_status_1_without_report(tmp_path: Path) -> None:
    logged = LoggedWorld("mujoco", is_fresh=False)
    logged.spawn_robots(1)
    logged.poll()
    logged.step(STEPS_PER_S)
    write_log(tmp_path / "run.mcap", logged.messages)

    status, result = resim(tmp_path / "run.mcap")
    reported, _ = resim(tmp_path / "run.mcap", "--report")

    assert (status, result["is_equal"]) == (ExitCode.FAILED, False)
    assert reported == ExitCode.OK
    assert "--report" in CliRunner().invoke(app, [str(tmp_path / "run.mcap")]).stdout


def test_log_that_is_cut_at_its_end_is_not_equal(messages: list[Inputs], tmp_path: Path) -> None:
    write_log(tmp_path / "run.mcap", messages[:-1], is_closed=False)

    status, result = resim(tmp_path / "run.mcap")

    text = CliRunner().invoke(app, [str(tmp_path / "run.mcap")]).stdout
    assert (status, result["is_equal"]) == (ExitCode.FAILED, False)
    assert result["first_difference"] is None
    assert len(result["cuts"]) == 1
    assert "equal: " not in text


def test_log_that_ends_before_other_topics_is_cut(messages: list[Inputs], tmp_path: Path) -> None:
    write_log(tmp_path / "run.mcap", messages[:-1], until_s=5.0)

    status, result = resim(tmp_path / "run.mcap")

    assert (status, len(result["cuts"])) == (ExitCode.FAILED, 1)


def test_recording_that_ended_before_the_server_says_how_far_it_is_equal(
    messages: list[Inputs], tmp_path: Path
) -> None:
    write_log(tmp_path / "run.mcap", messages[:-1])

    status, result = resim(tmp_path / "run.mcap")

    text = CliRunner().invoke(app, [str(tmp_path / "run.mcap")]).stdout
    assert (status, result["open_ends"]) == (ExitCode.OK, 1)
    assert "equal: " not in text


def test_recording_of_two_worlds_is_refused(messages: list[Inputs], tmp_path: Path) -> None:
    write_log(tmp_path / "run.mcap", messages, other_world="moon")

    done = CliRunner().invoke(app, [str(tmp_path / "run.mcap"), "--json"])

    assert done.exit_code == ExitCode.USAGE
    assert "resim.several_worlds" in done.stderr


def test_recording_without_a_log_is_refused(messages: list[Inputs], tmp_path: Path) -> None:
    write_log(tmp_path / "run.mcap", messages[4:])

    done = CliRunner().invoke(app, [str(tmp_path / "run.mcap"), "--json"])

    assert done.exit_code == ExitCode.USAGE
    assert "resim.no_start" in done.stderr


@pytest.mark.parametrize(
    "wrong",
    [
        ("--gravity", "down"),
        ("--gravity", "1,2"),
        ("--gravity", "0,0,nan"),
        ("--step-hz", "0"),
        ("--step-hz", "inf"),
        ("--ground-friction", "inf"),
        ("--engine", "ode"),
    ],
    ids="=".join,
)
def test_wrong_options_are_refused(
    messages: list[Inputs], tmp_path: Path, wrong: tuple[str, str]
) -> None:
    write_log(tmp_path / "run.mcap", messages)

    done = CliRunner().invoke(app, [str(tmp_path / "run.mcap"), *wrong])

    assert done.exit_code == ExitCode.USAGE
    assert wrong[1] in done.stderr
    assert done.exception is None or isinstance(done.exception, SystemExit)


def test_missing_file_has_status_3(tmp_path: Path) -> None:
    assert CliRunner().invoke(app, [str(tmp_path / "none.mcap")]).exit_code == ExitCode.NOT_FOUND


def test_long_tables_are_shortened_and_keep_the_last_time() -> None:
    times = [
        Distance(time_s=float(time), mean_m=0.0, max_m=0.0, max_rad=0.0, entity="r")
        for time in range(100)
    ]

    lines = format_distances(times)

    assert MAX_ROWS <= len(lines) <= MAX_ROWS + 3
    assert lines[-1].split()[0] == "99.000"
