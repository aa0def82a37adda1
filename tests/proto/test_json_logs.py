"""Log lines as JSON, and warnings that repeat."""

import itertools
import json
import logging
import sys
from collections.abc import Callable, Iterator
from datetime import datetime

import pytest

from tests.fakes import ManualClock
from zensim.proto.json_logs import (
    CONTEXT,
    PERIOD_S,
    REPEATS_PER_PERIOD,
    JsonFormatter,
    RepeatLimit,
    find_event,
    format_request,
)


@pytest.fixture(autouse=True)
def _context() -> Iterator[None]:
    CONTEXT.world, CONTEXT.request, CONTEXT.read_time_ns = "lab", b"id-1", lambda: 250
    yield
    CONTEXT.world, CONTEXT.request, CONTEXT.read_time_ns = "", b"", lambda: None


def a_record(message: str, *values: object, level: int = logging.WARNING) -> logging.LogRecord:
    return logging.LogRecord("zensim.x", level, "x.py", 1, message, values, None)


def test_line_has_time_event_and_context() -> None:
    record = a_record("drive command dropped agent=%s reason=%s", "a1", "old")

    line = json.loads(JsonFormatter().format(record))

    moment = datetime.fromisoformat(line.pop("ts").replace("Z", "+00:00"))
    assert abs(moment.timestamp() - record.created) < 0.002
    assert line == {
        "level": "WARNING",
        "logger": "zensim.x",
        "event": "drive_command_dropped",
        "world": "lab",
        "request": "id-1",
        "sim_time_ns": 250,
        "message": "drive command dropped agent=a1 reason=old",
        "exception": None,
    }


def test_line_stays_one_line_with_hostile_values_and_tracebacks() -> None:
    record = a_record("fault body=%s", 'a\n"b\ud800\x1b[31m')
    try:
        int("one\ntwo\ud800")
    except ValueError:
        record.exc_info = sys.exc_info()

    text = JsonFormatter().format(record)

    assert len(text.splitlines()) == 1
    line = json.loads(text)
    assert line["message"].isprintable()
    assert "ValueError" in line["exception"]


@pytest.mark.parametrize(
    ("message", "event"),
    [
        ("serving world=%s endpoint=%s", "serving"),
        ("journal not written reason=%s", "journal_not_written"),
        ("no such service of ros key=%s", "no_such_service_of_ros"),
        ("the last start crashed while restoring; its", "the_last_start_crashed_while"),
        ("journal %s", "journal"),
        ("world=default up", ""),
        ("%s agent=%s", ""),
        ("", ""),
    ],
)
def test_event_is_the_words_before_the_first_value(message: str, event: str) -> None:
    assert find_event(message) == event


@pytest.mark.parametrize(
    ("request_id", "text"), [(b"", ""), (b"id-1", "id-1"), (b"\xff\x01", "ff01"), (b"\n", "0a")]
)
def test_request_is_text_or_digits(request_id: bytes, text: str) -> None:
    assert format_request(request_id) == text


def test_warning_that_repeats_is_left_out_and_counted() -> None:
    clock = ManualClock()
    limit = RepeatLimit(clock)
    passed = [limit.filter(a_record("fault body=%d", number)) for number in range(100)]

    clock.now_s += PERIOD_S
    record = a_record("fault body=%d", 7)
    passes_later = limit.filter(record)

    assert sum(passed) == REPEATS_PER_PERIOD
    assert passes_later
    assert record.getMessage() == f"fault body=7 left_out={100 - REPEATS_PER_PERIOD}"


def test_other_warnings_and_all_notes_pass() -> None:
    limit = RepeatLimit(ManualClock())
    for number in range(100):
        limit.filter(a_record("fault body=%d", number))

    assert limit.filter(a_record("other fault"))
    assert all(limit.filter(a_record("note", level=logging.INFO)) for _ in range(100))


def test_count_of_what_was_left_out_is_kept_until_it_is_written() -> None:
    clock = ManualClock()
    limit = RepeatLimit(clock)
    for number in range(100):
        limit.filter(a_record("fault body=%d", number))
    for _ in range(2):
        clock.sleep(PERIOD_S)
        limit.filter(a_record("other fault"))
    record = a_record("fault body=%d", 7)
    limit.filter(record)

    assert record.getMessage() == f"fault body=7 left_out={100 - REPEATS_PER_PERIOD}"


class Name(str):
    """A logger's name; another thread logs whenever it is looked up."""

    __slots__ = ()
    log_meanwhile: Callable[[], object] = staticmethod(lambda: None)

    def __hash__(self) -> int:
        type(self).log_meanwhile()
        return super().__hash__()


def test_another_thread_logs_while_warnings_are_counted() -> None:
    clock = ManualClock()
    limit = RepeatLimit(clock)
    record = a_record("fault")
    record.name = Name("zensim.x")
    for _ in range(100):
        limit.filter(record)
    others = itertools.count()
    clock.sleep(PERIOD_S)
    Name.log_meanwhile = lambda: limit.filter(a_record(f"other fault {next(others)}"))
    try:
        assert limit.filter(record)
    finally:
        Name.log_meanwhile = lambda: None

    assert record.getMessage() == f"fault left_out={100 - REPEATS_PER_PERIOD}"
    assert next(others) > 0
