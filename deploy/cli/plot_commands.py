"""`zensim bag plot`: draw numbers of a recording over time."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

import msgspec
import typer

from zensim.deploy.cli.opened_recording import note_damage, open_recording
from zensim.deploy.cli.recording_options import SpanOption, StartOffsetOption, find_log_span
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import JsonOption
from zensim.proto.printable_text import print_lines
from zensim.recording.message_series import MessageSeries, parse_series_choice, read_series

SUFFIXES: Final = (".png", ".svg", ".pdf")


class MissingPlotExtra(Exception):
    """The packages of the plot extra are not installed."""


class DrawnSeries(msgspec.Struct, frozen=True):
    """What `--json` prints of a line of the chart."""

    topic: str
    field: str
    unit: str
    run: int
    points: int


@dataclass(frozen=True, kw_only=True)
class PlotOptions:
    """All options of `zensim bag plot`."""

    path: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording: an .mcap file, or its folder.")
    ]
    series: Annotated[
        list[str],
        typer.Argument(
            metavar="TOPIC:FIELD...",
            help="Topics with wildcards, and the path of a field or its end, such as "
            "'r*/odom:twist.linear.x'.",
        ),
    ]
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Picture: .png, .svg or .pdf.",
            show_default="name of the recording, .png",
        ),
    ] = None
    start_offset: StartOffsetOption = 0.0
    duration: SpanOption = None
    as_json: JsonOption = False


def plot_command(given: PlotOptions) -> None:
    """Draw fields of messages over time, as PNG, SVG or PDF."""
    with exit_on_failure("bag plot", MissingPlotExtra):
        choices = [parse_series_choice(text) for text in given.series]
        target = given.output or given.path.with_name(f"{given.path.stem}.png")
        if target.suffix not in SUFFIXES:
            raise ValueError(
                f"--output {target.name} has no known format; use {', '.join(SUFFIXES)}"
            )
        if find_spec("matplotlib") is None:
            raise MissingPlotExtra("matplotlib is not installed; use pip install 'zensim[plot]'")
        reader = open_recording("bag", given.path)
        start_ns, end_ns = find_log_span(reader, given.start_offset, given.duration)
        found = read_series(reader, choices, start_ns=start_ns, end_ns=end_ns)
        _draw(found, target, given.path.name)
    note_damage("bag", reader.damaged)
    _report(found, target, as_json=given.as_json)


def _draw(found: list[MessageSeries], target: Path, title: str) -> None:
    # It takes 0.5 s to load, which a wrong name should not cost.
    from zensim.recording.series_chart import draw_series

    if not found:
        raise ValueError("there are no messages of these topics at that time")
    draw_series(found, target, title=title)


def _report(found: list[MessageSeries], target: Path, *, as_json: bool) -> None:
    drawn = [DrawnSeries(one.topic, one.field, one.unit, one.run, len(one.values)) for one in found]
    if as_json:
        facts = {"file": str(target), "series": drawn}
        print_lines(msgspec.json.encode(facts).decode())
        return
    points = sum(one.points for one in drawn)
    print_lines(f"{target}: {len(drawn)} lines, {points} points")
