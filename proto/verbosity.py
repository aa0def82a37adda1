"""How much a command prints besides its data: notes, logs, and failures as text or JSON."""

import json
import logging
import os
import sys
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from zensim.proto.json_logs import JsonFormatter, RepeatLimit
from zensim.proto.printable_text import PrintableFormatter, print_lines

LOG = logging.getLogger("zensim")
LOG_FORMAT = "%(levelname)s %(name)s %(message)s"
LOG_FORMATS: Final = ("text", "json")
LOG_FORMAT_VARIABLE: Final = "ZENSIM_LOG_FORMAT"
"""Variable of `--log-format`; programs hand their choice to those that they start."""


class Verbosity:
    """The choice of `--quiet`, `--verbose` and `--json` of the command that runs."""

    is_quiet = False
    is_verbose = False
    is_json = False
    log_format = ""
    """Format of `LOG_FORMATS`; empty = as the variable says."""

    options: Mapping[str, str] = MappingProxyType({})
    """Options of the command as they are typed, by the settings that they give."""


CURRENT = Verbosity()


def set_verbosity(*, is_quiet: bool, is_verbose: bool, is_json: bool, log_format: str = "") -> None:
    """Choose how much this process prints, from now on.

    Raises:
        ValueError: Quiet and verbose exclude each other, or the format is unknown.
    """
    CURRENT.is_quiet, CURRENT.is_verbose, CURRENT.is_json = is_quiet, False, is_json
    CURRENT.log_format = log_format
    if log_format not in ("", *LOG_FORMATS):
        raise ValueError(
            f"`log_format` must be one of {', '.join(LOG_FORMATS)}; got {log_format[:40]!r}"
        )
    if is_quiet and is_verbose:
        raise ValueError("`quiet` and `verbose` exclude each other; give one of them")
    CURRENT.is_verbose = is_verbose


def configure_logging(usual_level: int = logging.WARNING) -> None:
    """Log to standard error: at a program's usual level, or as `set_verbosity` says."""
    level = usual_level
    if CURRENT.is_quiet:
        level = max(usual_level, logging.WARNING)
    elif CURRENT.is_verbose:
        level = min(usual_level, logging.INFO)
    handler = logging.StreamHandler(sys.stderr)
    is_json = (CURRENT.log_format or os.environ.get(LOG_FORMAT_VARIABLE)) == "json"
    handler.setFormatter(JsonFormatter() if is_json else PrintableFormatter(LOG_FORMAT))
    handler.addFilter(RepeatLimit())
    logging.basicConfig(handlers=[handler])
    LOG.setLevel(level)


def print_announcement(
    command: str, text: str, facts: Mapping[str, object], *, as_json: bool
) -> None:
    """Print what a program does: a line on standard error, or facts on standard output."""
    if as_json:
        print_lines(json.dumps(facts))
    elif not CURRENT.is_quiet:
        print_lines(f"zensim {command}: {text}", err=True)


def print_note(command: str, text: str) -> None:
    """Print a note to standard error, unless the command is quiet."""
    if not CURRENT.is_quiet:
        print_lines(f"zensim {command}: note: {text}", err=True)
