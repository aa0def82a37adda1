"""Log records as JSON, one object a line, and a limit on warnings that repeat."""

import json
import logging
import re
import time
from collections.abc import Callable
from datetime import datetime, timezone
from typing import Final

from zensim.proto.printable_text import printable, printable_lines

MAX_EVENT_WORDS: Final = 5
WORDS_PATTERN: Final = re.compile(r"[A-Za-z_]+(?: [A-Za-z_]+(?![\w=]))*(?![\w=])")
REPEATS_PER_PERIOD: Final = 20
PERIOD_S: Final = 10.0


class LogContext:
    """What each record of this process has in common; the program's thread writes it."""

    world = ""
    request = b""
    """Id of the request that is handled."""
    read_time_ns: Callable[[], int | None] = staticmethod(lambda: None)
    """Reads simulation time."""


CONTEXT = LogContext()


class JsonFormatter(logging.Formatter):
    """Writes each record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Write a record and its traceback."""
        moment = datetime.fromtimestamp(record.created, timezone.utc)
        message = record.getMessage()
        trace = self.formatException(record.exc_info) if record.exc_info else None
        line = {
            "ts": moment.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "level": record.levelname,
            "logger": record.name,
            # The same for each repeat.
            "event": find_event(str(record.msg)) or find_event(message) or "log",
            "world": CONTEXT.world,
            "request": format_request(CONTEXT.request),
            "sim_time_ns": CONTEXT.read_time_ns(),
            "message": printable(message),
            "exception": trace and printable_lines(trace),
        }
        # By json, not msgspec: help texts and short commands do without that import.
        return json.dumps(line, ensure_ascii=False, separators=(",", ":"))


def find_event(message: str) -> str:
    """Find the slug of a message: its words up to the first value; empty if it begins with one."""
    match = WORDS_PATTERN.match(message)
    return "_".join(match[0].lower().split()[:MAX_EVENT_WORDS]) if match else ""


def format_request(request: bytes) -> str:
    """Write the id of a request: as its text, else in hexadecimal digits."""
    try:
        text = request.decode("ascii")
    except UnicodeDecodeError:
        return request.hex()
    return text if text.isprintable() else request.hex()


class RepeatLimit(logging.Filter):
    """Leaves out warnings that repeat too often; the next that passes has their number."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = now_s
        self._began_s = now_s()
        self._counts: dict[tuple[str, str], int] = {}
        self._left_out: dict[tuple[str, str], int] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is written."""
        if record.levelno < logging.WARNING:
            return True
        if self._now_s() - self._began_s >= PERIOD_S:
            self._began_s = self._now_s()
            # Other threads filter at the same time.
            counts, self._counts = self._counts, {}
            for repeated, total in tuple(counts.items()):
                if total > REPEATS_PER_PERIOD:
                    left_out = self._left_out.get(repeated, 0) + total - REPEATS_PER_PERIOD
                    self._left_out[repeated] = left_out
        key = (record.name, str(record.msg))
        count = self._counts[key] = self._counts.get(key, 0) + 1
        if count > REPEATS_PER_PERIOD:
            return False
        if left_out := self._left_out.pop(key, 0):
            record.msg, record.args = f"{record.getMessage()} left_out={left_out}", ()
        return True
