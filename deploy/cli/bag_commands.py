"""`zensim bag`: inspect, repair, export, convert and draw recordings."""

from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from zensim.deploy.cli.convert_commands import CONVERT_EXAMPLES, convert_command
from zensim.deploy.cli.opened_recording import note_unread
from zensim.deploy.cli.plot_commands import plot_command
from zensim.deploy.cli.recording_options import TopicListCommand
from zensim.deploy.cli.table_commands import export_command
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.recording.bag_info import BagInfo, read_info
from zensim.recording.recovery import RecoveryResult, recover_file

app = make_app("bag")
app.command(
    "export",
    epilog="""Examples:
  zensim bag export run.mcap --output tables
  zensim bag export run.mcap '*/odom' '*/cmd_vel' --to csv -o tables""",
)(export_command)
app.command("convert", cls=TopicListCommand, epilog=CONVERT_EXAMPLES)(convert_command)
app.command(
    "plot",
    epilog="""Examples:
  zensim bag plot run.mcap 'r*/odom:twist.linear.x'
  zensim bag plot run.mcap r1/odom:position.x r1/cmd_vel:linear.x -o run.svg
  zensim bag plot run.mcap 'sim/*/stats:real_time_factor'""",
)(plot_command)

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE|FOLDER", help="Recording: an .mcap file, or its folder.")
]
WALL_TIME_NS = 10**18
"""Log times above it (September 2001) are times of day."""


@app.command(
    "info",
    epilog="""Examples:
  zensim bag info run.mcap
  zensim bag info run --json""",
)
def info_command(path: FileArgument, *, as_json: JsonOption = False) -> None:
    """Show files, times, topics and attachments, also of a recording that was never closed."""
    with exit_on_failure("bag info"):
        found = read_info(path)
        note_unread("bag", path, found.unclosed)
    if as_json:
        facts = {**msgspec.to_builtins(found), "duration_s": found.duration_s}
        print_lines(msgspec.json.encode(facts).decode())
    else:
        print_lines("\n".join(format_info(found)))


def format_info(found: BagInfo) -> list[str]:
    """Write the contents as `ros2 bag info` does."""
    width = max((len(one.name) for one in found.topics), default=0)
    return [
        f"Files:        {', '.join(found.files)}",
        f"Size:         {found.size / 1e6:.1f} MB",
        f"Storage:      mcap, compression {', '.join(found.compressions) or 'none'}",
        f"Duration:     {found.duration_s:.3f} s",
        f"Start:        {_format_time(found.start_ns)}",
        f"End:          {_format_time(found.end_ns)}",
        f"Messages:     {found.messages} in {found.chunks} chunks",
        f"Attachments:  {', '.join(found.attachments) or 'none'}",
        f"Topics:       {len(found.topics)}",
        *(f"  {one.name:<{width}}  {one.messages:>8}  {one.ros_type}" for one in found.topics),
    ]


def _format_time(time_ns: int) -> str:
    if time_ns < WALL_TIME_NS:
        return f"{time_ns / 1e9:.3f} s of simulation time"
    return datetime.fromtimestamp(time_ns / 1e9, timezone.utc).isoformat(timespec="milliseconds")


@app.command(
    "recover",
    epilog="""Examples:
  zensim bag recover run.mcap
  zensim bag recover run.mcap --output whole.mcap""",
)
def recover_command(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="An .mcap file.")],
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="New file.", show_default="FILE_recovered.mcap"
        ),
    ] = None,
    any_size: Annotated[
        bool, flag("--any-size", help="Accept chunks of any size in all, which may take long.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Copy all whole chunks of a file that was never closed, or is damaged, to a new file."""
    with exit_on_failure("bag recover"):
        target = output or path.with_name(f"{path.stem}_recovered.mcap")
        result = recover_file(path, target, is_any_size=any_size)
    if as_json:
        print_lines(msgspec.json.encode(result).decode())
    else:
        print_lines(format_result(result))


def format_result(result: RecoveryResult) -> str:
    """Write in one line what was recovered."""
    text = f"{result.file}: {result.messages} messages in {result.chunks} chunks"
    if not result.was_closed:
        text += "; the recording was never closed"
    if result.damaged:
        text += f"; {result.skipped_bytes} damaged bytes skipped in {result.damaged} places"
    if result.cut_bytes:
        text += f"; {result.cut_bytes} bytes of a record that is not whole left out"
    if result.unknown_messages:
        text += f"; {result.unknown_messages} messages of unknown topics left out"
    return text
