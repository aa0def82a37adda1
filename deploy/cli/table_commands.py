"""`zensim bag export`: tables of a recording for pandas, polars and learning."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import typer

from zensim.deploy.cli.opened_recording import note_damage, open_recording
from zensim.deploy.cli.recording_options import SpanOption, StartOffsetOption, find_log_span
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import JsonOption, flag, parse_choice
from zensim.proto.printable_text import print_lines
from zensim.proto.verbosity import print_note
from zensim.recording.message_tables import read_tables
from zensim.recording.table_files import (
    MissingDatasetExtra,
    TableFacts,
    TableFormat,
    find_writer,
    write_tables,
)
from zensim.recording.topic_selection import TopicFilter, TopicSelection

FORMATS: tuple[TableFormat, ...] = get_args(TableFormat)


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """All options of `zensim bag export`."""

    path: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording: an .mcap file, or its folder.")
    ]
    topics: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TOPIC]...", help="Topics, such as '*/odom'; all if none is named."
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="New or empty folder.",
            show_default="name of the recording",
        ),
    ] = None
    table_format: Annotated[
        str, typer.Option("--to", metavar="parquet|csv|npz", help="Format of the tables.")
    ] = "parquet"
    start_offset: StartOffsetOption = 0.0
    duration: SpanOption = None
    arrays: Annotated[
        bool,
        flag("--arrays", help="Export arrays, too: covariances, ranges of scans, pixels, points."),
    ] = False
    as_json: JsonOption = False


def export_command(given: TableOptions) -> None:
    """Write a table for each kind of topic, with a row for each message and a column per field."""
    with exit_on_failure("bag export", MissingDatasetExtra):
        table_format = parse_choice("--to", given.table_format, FORMATS)
        find_writer(table_format)  # before the recording is read
        reader = open_recording("bag", given.path)
        selection = TopicSelection(topics=tuple(given.topics or ()), wants_all=not given.topics)
        chosen = TopicFilter(selection)
        start_ns, end_ns = find_log_span(reader, given.start_offset, given.duration)
        tables = read_tables(
            reader,
            lambda topic: chosen.accepts(topic.name),
            start_ns=start_ns,
            end_ns=end_ns,
            wants_arrays=given.arrays,
        )
        if not tables:
            names = ", ".join(sorted(topic.name for topic in reader.topics)[:5])
            raise ValueError(f"no messages of these topics; the recording has {names}")
        folder = given.output or given.path.with_name(f"{given.path.stem}_{table_format}")
        facts = write_tables(tables, folder, table_format)
    note_damage("bag", reader.damaged)
    if given.as_json:
        print_lines(msgspec.json.encode(facts).decode())
        return
    for one in facts:
        print_lines(f"{folder / one.file}: {one.rows} rows, {len(one.columns)} columns")
        _note_left_out(one)


def _note_left_out(facts: TableFacts) -> None:
    if facts.left_out:
        names = ", ".join(facts.left_out[:5])
        print_note("bag", f"{facts.file} is without {names}, whose shape differs")
    if facts.damaged:
        print_note("bag", f"{facts.damaged} messages of {facts.file} are damaged, and left out")
