"""`zensim resim`: run a recording again through the engine, and compare the states."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, NamedTuple

import msgspec
import typer

from zensim.deploy.cli.opened_recording import open_recording
from zensim.proto.codec.message_codec import Format, decode, make_encoding
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.standard_messages import NANOSECONDS, UInt8MultiArray
from zensim.proto.options.command_options import AllowFailedEngineOption, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.options.plain_options import parse_finite
from zensim.proto.printable_text import print_lines
from zensim.proto.settings.pace_settings import PaceSettings
from zensim.proto.settings.setting import make_settings
from zensim.proto.topic_catalog import INPUTS
from zensim.recording.recording_reader import RecordingReader, StoredTopic
from zensim.sim_server.physics.engine_config import parse_engine_name
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

if TYPE_CHECKING:
    from zensim.sim_server.input_log.resimulation import FirstDifference, ResimChanges, ResimResult
    from zensim.sim_server.input_log.state_comparison import Distance, StateDifference

app = make_app()
AXES = 3
MAX_ROWS = 20
"""Most rows of the table of distances."""
TAIL_NS = NANOSECONDS
"""Simulated and wall time after the log in which other topics may have messages."""


@dataclass(frozen=True, kw_only=True)
class ResimOptions:
    """All options of `zensim resim`."""

    path: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording with the topic of inputs.")
    ]
    engine: Annotated[
        str,
        typer.Option(
            metavar="pybullet|mujoco",
            help="Use this engine, and report how far trajectories part.",
            show_default="that of the recording",
        ),
    ] = ""
    allow_failed_engine: AllowFailedEngineOption = False
    step_hz: Annotated[
        float | None,
        typer.Option(metavar="HZ", help=r"Use this physics rate \[Hz], and report distances."),
    ] = None
    gravity: Annotated[
        str, typer.Option(metavar="X,Y,Z", help=r"Use this gravity \[m/s^2], and report.")
    ] = ""
    ground_friction: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="NUMBER", help="Use this friction of the ground, and report."
        ),
    ] = None
    report: Annotated[
        bool, flag("--report", help="Report distances, also of an unchanged run or other versions.")
    ] = False
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim resim run.mcap
  zensim resim run.mcap --engine mujoco
  zensim resim run.mcap --gravity 0,0,-1.62 --json"""
)
def resim(given: ResimOptions) -> None:
    """Run a recording again in the engine; status 1 unless all states are equal."""
    with exit_on_failure("resim", MissingServerExtra), server_extra():
        changes = make_changes(given)
        result = run_recording(given.path, changes)
    if given.as_json:
        print_lines(msgspec.json.encode(encode_result(result)).decode())
    else:
        print_lines("\n".join(format_result(given.path, result)))
    raise SystemExit(ExitCode.OK if result.is_passed else ExitCode.FAILED)


def make_changes(given: ResimOptions) -> "ResimChanges":
    """Make the changes of the options.

    Raises:
        ValueError: A value is not valid.
    """
    from zensim.sim_server.input_log.resimulation import ResimChanges

    hz = given.step_hz
    make_settings(PaceSettings, {"step_hz": hz})
    return ResimChanges(
        engine=parse_engine_name(given.engine),
        step_ns=None if hz is None else round(NANOSECONDS / hz),
        gravity=parse_gravity(given.gravity) if given.gravity else None,
        ground_friction=given.ground_friction,
        only_compares=given.report,
        allow_failed_engine=given.allow_failed_engine,
    )


def parse_gravity(text: str) -> tuple[float, float, float]:
    """Read `0,0,-9.81` [m/s^2].

    Raises:
        ValueError: It is no vector.
    """
    try:
        x, y, z = (parse_finite(part) for part in text.split(","))
    except ValueError:
        raise ValueError(
            f"--gravity {text[:40]!r} is not a vector; use X,Y,Z, as 0,0,-9.81"
        ) from None
    return x, y, z


def run_recording(path: Path, changes: "ResimChanges") -> "ResimResult":
    """Run a recording until its end, or until the first difference is measured.

    Raises:
        OSError: The recording cannot be read.
        ValueError: It is no recording, has no log of inputs, or one of another version.
    """
    from zensim.sim_server.input_log.resimulation import Resimulation

    with TemporaryDirectory(prefix="zensim-resim-") as folder:
        reader = open_recording("resim", path)
        run = Resimulation(Path(folder), changes)
        with closing(run):
            last = LogTimes(0, 0)
            for times, message in read_inputs(reader):
                last = times
                run.feed(message)
                if run.is_decided:
                    break
            return run.finish(() if run.is_decided else find_cuts(reader, last))


class LogTimes(NamedTuple):
    """Times of a message of the log [ns]."""

    log_ns: int
    publish_ns: int


def read_inputs(reader: RecordingReader) -> Iterator[tuple[LogTimes, Inputs]]:
    """Read the log of inputs of a recording, in the order of its files.

    Raises:
        ResimRefused: It has the logs of several worlds.
    """
    from zensim.sim_server.input_log.resimulation import check_topic

    found = ""
    bytes_encoding = make_encoding(UInt8MultiArray, Format.CDR)
    for chunk in reader.chunks(is_input_topic):
        for topic, log_ns, publish_ns, payload in chunk:
            found = found or topic.name
            check_topic(topic.name, found)
            data = decode(UInt8MultiArray, payload, bytes_encoding).data
            yield LogTimes(log_ns, publish_ns), decode(Inputs, data, INPUTS.encoding)


def find_cuts(reader: RecordingReader, last: LogTimes) -> list[str]:
    """Find out why the end of the log is missing in a recording.

    Args:
        reader: Of the recording, after all messages of the log were read.
        last: Of the last one.
    """
    found = [f"{file.name} was never closed" for file in reader.unclosed]
    if reader.damaged:
        found.append(f"{reader.damaged} places of the recording are damaged")
    # A paused world makes no inputs, and a fast one many seconds between two messages.
    after = reader.runs[-1].messages(start_ns=last.log_ns + TAIL_NS)
    if any(publish_ns > last.publish_ns + TAIL_NS for _, _, publish_ns, _ in after):
        found.append("other topics go on after the last message of the log")
    return found


def is_input_topic(topic: StoredTopic) -> bool:
    """Whether a topic of a recording is the log of inputs of a world."""
    parts = topic.name.strip("/").split("/")
    is_of_world = len(parts) == len(INPUTS.key("world").split("/"))
    return is_of_world and parts[0] == "sim" and parts[-1] == INPUTS.suffix


def encode_result(result: "ResimResult") -> dict[str, object]:
    """Make the JSON of a result."""
    return {"is_equal": result.is_equal, **msgspec.to_builtins(result)}


def format_result(path: Path, result: "ResimResult") -> list[str]:
    """Write a result in lines."""
    lines = [
        f"{path}: {result.engine}, {result.simulated_s:.3f} s, {result.steps} steps, "
        f"{result.inputs} inputs"
    ]
    if result.lost_messages:
        lines.append(f"lost: {result.lost_messages} messages of the log are not in the recording")
    if result.skipped_messages:
        lines.append(f"not run: {result.skipped_messages} messages, which no start precedes")
    lines += [f"cut: {reason}; what was after it in the log is unknown" for reason in result.cuts]
    lines += [f"left out: {name}: {reason}" for name, reason in result.refused_models.items()]
    if (first := result.first_difference) is not None:
        lines += format_difference(first)
    if not result.is_exact:
        return [*lines, *format_inexact(result), *format_distances(result.distances)]
    if first is not None:
        return lines
    if not result.control_steps:
        return [*lines, "not compared: no control step was recorded after a start"]
    counts = f"{result.control_steps} control steps, {result.equal_states} states"
    return [*lines, f"{write_extent(result)}: {counts}; the last has hash {result.digest}"]


def write_extent(result: "ResimResult") -> str:
    """Write up to where the states are equal."""
    if result.cuts:
        return f"equal up to {result.simulated_s:.3f} s, where the log is cut"
    if result.open_ends:
        return f"equal up to {result.simulated_s:.3f} s, where the recording ends"
    return "equal"


def format_inexact(result: "ResimResult") -> list[str]:
    """Write why distances are all that is known, unless --report asks for them."""
    if result.only_compares:
        return []
    return ["not compared bit by bit: the log begins in a running world; use --report for status 0"]


def format_difference(first: "FirstDifference") -> list[str]:
    """Write where states first differ, and by how much."""
    more = f" and {first.count - len(first.entities)} more" * (first.count > len(first.entities))
    lines = [
        f"first difference: step {first.step} ({first.time_s:.3f} s): "
        f"{', '.join(first.entities)}{more}",
        *(f"  input since the control step before: {one}" for one in first.inputs),
    ]
    if first.measured_s is not None:
        lines.append(f"differences at {first.measured_s:.3f} s:")
        lines += [f"  {format_state_difference(one)}" for one in first.differences]
    return lines


def format_state_difference(one: "StateDifference") -> str:
    """Write how far an entity is from where it was recorded."""
    return (
        f"{one.entity}: {one.position_m:.3g} m, {one.angle_rad:.3g} rad, "
        f"{one.speed_m_s:.3g} m/s, {one.turn_rate_rad_s:.3g} rad/s, joints {one.joints:.3g}"
    )


def format_distances(distances: Sequence["Distance"]) -> list[str]:
    """Write a table of at most `MAX_ROWS` times, evenly chosen, with the last."""
    every = -(-len(distances) // MAX_ROWS) or 1
    chosen = [*distances[:-1:every], *distances[-1:]]
    return [
        "distances from the recorded states:",
        "  time [s]   mean [m]    max [m]  max [rad]  farthest",
        *(
            f"  {one.time_s:8.3f} {one.mean_m:10.3g} {one.max_m:10.3g} {one.max_rad:10.3g}  "
            f"{one.entity}"
            for one in chosen
        ),
    ]
