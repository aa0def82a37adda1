"""Options that several commands of recordings share, with the names of rosbag2."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Final

import typer
from typer.core import TyperCommand

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.options.command_options import seconds
from zensim.recording.recording_reader import LAST_NS, RecordingReader

TOPICS_PANEL, FILES_PANEL, TIME_PANEL = "Topics", "Files", "Time"
"""Headings of help texts."""

RegexOption = Annotated[
    str,
    typer.Option(
        "--regex",
        "-e",
        metavar="EXPRESSION",
        help="Topics whose name has a match, such as '^/r[0-9]+/odom$'.",
        rich_help_panel=TOPICS_PANEL,
    ),
]
ExcludeRegexOption = Annotated[
    str,
    typer.Option(
        "--exclude-regex",
        "-x",
        metavar="EXPRESSION",
        help="Leave out topics with a match.",
        rich_help_panel=TOPICS_PANEL,
    ),
]
ExcludeTopicsOption = Annotated[
    list[str] | None,
    typer.Option(metavar="TOPIC...", help="Leave out these topics.", rich_help_panel=TOPICS_PANEL),
]
MaxBagSizeOption = Annotated[
    str,
    typer.Option(
        "--max-bag-size",
        "-b",
        metavar="BYTES",
        help="Begin a new file at this size, such as 500MB; 0 = never.",
        rich_help_panel=FILES_PANEL,
    ),
]
MaxBagDurationOption = Annotated[
    float,
    seconds(
        "--max-bag-duration",
        "-d",
        help=r"Begin a new file after this log time \[s]; 0 = never.",
        rich_help_panel=FILES_PANEL,
    ),
]
StorageProfileOption = Annotated[
    str,
    typer.Option(
        "--storage-preset-profile",
        metavar="none|zstd_fast|zstd_small",
        help="Compression, as of rosbag2: none, fast, or small and slow.",
        rich_help_panel=FILES_PANEL,
    ),
]
StartOffsetOption = Annotated[
    float,
    seconds(help=r"Begin this time after the first message \[s].", rich_help_panel=TIME_PANEL),
]
SpanOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help=r"Length of the part that is used \[s].",
        show_default="to the end",
        rich_help_panel=TIME_PANEL,
    ),
]


TOPIC_LISTS: Final = ("--topics", "--exclude-topics", "--topic-types", "--exclude-topic-types")


class TopicListCommand(TyperCommand):
    """Takes several values after options of topics and types, as rosbag2 does."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parse the words after the name of the command."""
        return super().parse_args(ctx, list(repeat_options(args, TOPIC_LISTS)))


def repeat_options(words: Sequence[str], options: Collection[str]) -> Iterator[str]:
    """Write an option with several values once for each; a recording is none of them."""
    option = ""
    for number, word in enumerate(words):
        if word.startswith("-"):
            option = word if word in options else ""
            has_value = number + 1 < len(words) and is_topic(words[number + 1])
            if not (option and has_value):
                yield word
        elif option and is_topic(word):
            yield from (option, word)
        else:
            option = ""
            yield word


def is_topic(word: str) -> bool:
    """Whether a word after an option of topics is one of them, and no option and no recording."""
    path = Path(word)
    return not (word.startswith("-") or path.is_file() or any(path.glob("*.mcap")))


def find_span(option: str, start_s: float, span_s: float | None) -> tuple[int, int]:
    """Find start and end of a part of a recording, since its first message [ns].

    Raises:
        ValueError: The part has a length that is not more than 0; `option` says it.
    """
    start_ns = round(start_s * NANOSECONDS)
    if span_s is None:
        return start_ns, LAST_NS
    if not span_s > 0:
        raise ValueError(f"{option} {span_s:g} is not valid; use more than 0")
    return start_ns, start_ns + round(span_s * NANOSECONDS)


def find_log_span(reader: RecordingReader, start_s: float, span_s: float | None) -> tuple[int, int]:
    """Find the log times [ns] of a part that `--duration` ends; raises what `find_span` raises."""
    start_ns, end_ns = find_span("--duration", start_s, span_s)
    return reader.start_ns + start_ns, min(reader.start_ns + end_ns, LAST_NS)
