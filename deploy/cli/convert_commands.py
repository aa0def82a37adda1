"""`zensim bag convert`: split, merge, filter and re-compress recordings."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec
import typer

from zensim.deploy.cli.opened_recording import note_damage, open_recording
from zensim.deploy.cli.recording_options import (
    ExcludeRegexOption,
    ExcludeTopicsOption,
    MaxBagDurationOption,
    MaxBagSizeOption,
    RegexOption,
    SpanOption,
    StartOffsetOption,
    StorageProfileOption,
    find_span,
)
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.options.command_options import JsonOption, parse_choice
from zensim.proto.printable_text import print_lines
from zensim.recording.byte_sizes import parse_size
from zensim.recording.conversion import ConversionSettings, convert_recordings
from zensim.recording.mcap_writer import DEFAULT_PRESET, PRESETS
from zensim.recording.recording_parts import PartSettings
from zensim.recording.topic_selection import TopicFilter, TopicSelection

CONVERT_EXAMPLES: Final = """Examples:
  zensim bag convert run.mcap -o short.mcap --start-offset 30 --duration 10
  zensim bag convert run -o parts --max-bag-size 500MB --storage-preset-profile zstd_small
  zensim bag convert day1.mcap day2.mcap -o both.mcap --regex '/odom$' """


@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """All options of `zensim bag convert`."""

    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH", help="Files or folders; several are merged by log time."),
    ]
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER|FILE.mcap",
            help="New folder with metadata.yaml as of rosbag2, or one file.",
        ),
    ]
    topics: Annotated[
        list[str] | None,
        typer.Option(metavar="TOPIC...", help="Only these topics, such as '*/odom'."),
    ] = None
    regex: RegexOption = ""
    exclude_regex: ExcludeRegexOption = ""
    exclude_topics: ExcludeTopicsOption = None
    start_offset: StartOffsetOption = 0.0
    duration: SpanOption = None
    max_bag_size: MaxBagSizeOption = "0"
    max_bag_duration: MaxBagDurationOption = 0.0
    storage_preset_profile: StorageProfileOption = DEFAULT_PRESET
    as_json: JsonOption = False


def convert_command(given: ConvertOptions) -> None:
    """Write recordings to a new one: split, merged, filtered, or compressed otherwise."""
    with exit_on_failure("bag convert"):
        settings = make_conversion_settings(given)
        readers = [open_recording("bag", path, given.paths) for path in given.paths]
        result = convert_recordings(readers, settings)
    note_damage("bag", result.damaged)
    if given.as_json:
        print_lines(msgspec.json.encode(result).decode())
    else:
        size = f"{result.bytes / 1e6:.1f} MB"
        print_lines(
            f"{result.output}: {result.messages} messages of {result.topics} topics, {size}"
        )


def make_conversion_settings(given: ConvertOptions) -> ConversionSettings:
    """Make the settings of the options.

    Raises:
        ValueError: One is not valid.
    """
    preset = parse_choice("--storage-preset-profile", given.storage_preset_profile, tuple(PRESETS))
    start_ns, end_ns = find_span("--duration", given.start_offset, given.duration)
    is_named = bool(given.topics or given.regex)
    selection = TopicSelection(
        topics=tuple(given.topics or ()),
        wants_all=not is_named,
        regex=given.regex,
        exclude_regex=given.exclude_regex,
        exclude_topics=tuple(given.exclude_topics or ()),
    )
    return ConversionSettings(
        chosen=TopicFilter(selection),
        start_ns=start_ns,
        end_ns=end_ns,
        parts=PartSettings(
            path=given.output,
            max_bytes=parse_size("--max-bag-size", given.max_bag_size),
            max_duration_ns=round(given.max_bag_duration * NANOSECONDS),
            chunks=PRESETS[preset],
        ),
    )
