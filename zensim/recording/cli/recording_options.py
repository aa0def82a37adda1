"""Options that several commands of recordings share, with the names of rosbag2."""

from typing import Annotated

import typer

from zensim.proto.messages.standard_messages import NANOSECONDS

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
    typer.Option(
        metavar="TOPIC", help="Leave out a topic; repeatable.", rich_help_panel=TOPICS_PANEL
    ),
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
    typer.Option(
        "--max-bag-duration",
        "-d",
        min=0.0,
        metavar="SECONDS",
        help=r"Begin a new file after this log time \[s]; 0 = never.",
        rich_help_panel=FILES_PANEL,
    ),
]
StartOffsetOption = Annotated[
    float,
    typer.Option(
        min=0.0,
        metavar="SECONDS",
        help=r"Begin so long after the first message \[s].",
        rich_help_panel=TIME_PANEL,
    ),
]


def find_end_ns(option: str, start_s: float, duration_s: float) -> int:
    """Find where a part of a recording ends, since its first message [ns].

    Raises:
        ValueError: The duration is not more than 0.
    """
    if not duration_s > 0:
        raise ValueError(f"{option} {duration_s:g} is not valid; use more than 0")
    return round(start_s * NANOSECONDS) + round(duration_s * NANOSECONDS)
