"""Numbers of a recording over time: one field of the messages of each topic that is chosen."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto import keys
from zensim.proto.messages.standard_messages import NANOSECONDS, String
from zensim.proto.schema import list_cdr_types
from zensim.recording.message_columns import Column, ColumnDecoder, TextColumn
from zensim.recording.message_tables import find_unit
from zensim.recording.recording_reader import (
    LAST_NS,
    RecordingReader,
    RecordingRun,
    StoredMessage,
    StoredTopic,
)

FloatColumn = npt.NDArray[np.float64]
ITEM: Final = re.compile(r"(.+)\[(\d+)\]\Z")
TEXT_FIELD: Final = "data"
MAX_NAMES: Final = 8
CHOICE_FORM: Final = "TOPIC:FIELD, such as 'r*/odom:twist.linear.x'"


class SeriesChoice(msgspec.Struct, frozen=True):
    """Which numbers are wanted."""

    topics: str
    """Name with wildcards: `*` is any part of one part of a name, `**` any number of parts."""
    field: str
    """Dotted path, or its end: `twist.linear.x` is `twist.twist.linear.x` of odometry."""


class MessageSeries(msgspec.Struct, frozen=True, eq=False):
    """A field of the messages of one topic, in one run."""

    topic: str
    field: str
    """Whole path."""
    run: int
    """Counted from 0; time begins anew in each."""
    times_s: FloatColumn
    """Log time of each message, ascending."""
    values: FloatColumn

    @property
    def unit(self) -> str:
        """Unit of the values; empty if it is not known."""
        return find_unit(self.field)


class NoSuchSeries(ValueError):
    """No topic or field of a recording is the one that was named."""


def parse_series_choice(text: str) -> SeriesChoice:
    """Parse `TOPIC:FIELD`.

    Raises:
        NoSuchSeries: It has no topic or no field.
    """
    topics, _, field = text.partition(":")
    if not (topics.strip("/") and field):
        raise NoSuchSeries(f"{text[:60]!r} names no field of a topic; write {CHOICE_FORM}")
    return SeriesChoice(topics.strip("/"), field)


def read_series(
    reader: RecordingReader,
    choices: Iterable[SeriesChoice],
    *,
    start_ns: int = 0,
    end_ns: int = LAST_NS,
) -> list[MessageSeries]:
    """Read the numbers of all topics that are chosen, by choice, topic and run.

    Args:
        reader: Recording.
        choices: At least one topic has to fit each.
        start_ns: First log time.
        end_ns: Last log time.

    Raises:
        NoSuchSeries: No topic has the name or field of a choice, or it has no numbers.
        OSError: A file cannot be read.
    """
    found = []
    for choice in choices:
        topics = _choose_topics(reader, choice)
        for number, run in enumerate(reader.runs):
            readers = {topic: _FieldReader(topic, choice.field) for topic in topics}
            _read_run(run, readers, range(start_ns, end_ns))
            found += [one for each in readers.values() for one in each.build(number)]
    return found


def _choose_topics(reader: RecordingReader, choice: SeriesChoice) -> list[StoredTopic]:
    chosen = [one for one in reader.topics if keys.intersect(choice.topics, one.name.strip("/"))]
    if not chosen:
        names = _list_names(sorted(one.name for one in reader.topics))
        raise NoSuchSeries(f"no topic is named '{choice.topics}'; the recording has {names}")
    known = list_cdr_types()
    for one in chosen:
        if one.ros_type not in known or one.encoding != "cdr":
            raise NoSuchSeries(f"{one.name} has messages of type {one.ros_type}, not known here")
    return sorted(chosen, key=lambda one: one.name)


def _read_run(run: RecordingRun, readers: "dict[StoredTopic, _FieldReader]", span: range) -> None:
    for chunk in run.chunks(readers.__contains__, start_ns=span.start, end_ns=span.stop):
        by_topic: dict[StoredTopic, list[StoredMessage]] = {}
        for message in chunk:
            by_topic.setdefault(message[0], []).append(message)
        for topic, messages in by_topic.items():
            readers[topic].add(messages)


class _FieldReader:
    """Collects a field of the messages of a topic."""

    def __init__(self, topic: StoredTopic, field: str) -> None:
        self._topic = topic
        self._field = field
        self._decoder = ColumnDecoder(list_cdr_types()[topic.ros_type], wants_arrays=True)
        self._parts: dict[str, list[tuple[FloatColumn, FloatColumn]]] = {}

    def add(self, messages: Sequence[StoredMessage]) -> None:
        """Decode messages.

        Raises:
            NoSuchSeries: They have no such field, or it has no numbers.
        """
        times = np.array([log_ns for _, log_ns, *_ in messages], np.float64) / NANOSECONDS
        for found in self._decoder.decode([payload for *_, payload in messages]):
            for path, values in self._find_values(found.columns):
                self._parts.setdefault(path, []).append((times[found.messages], values))

    def build(self, run: int) -> Iterator[MessageSeries]:
        """Make the series of one run, in the order of time; none without messages."""
        for path, parts in self._parts.items():
            times = np.concatenate([one for one, _ in parts])
            values = np.concatenate([one for _, one in parts])
            order = np.argsort(times, kind="stable")
            yield MessageSeries(self._topic.name, path, run, times[order], values[order])

    def _find_values(self, columns: dict[str, Column]) -> list[tuple[str, FloatColumn]]:
        if self._topic.ros_type == String.ros_type and self._field != TEXT_FIELD:
            return [(self._field, _read_json(columns[TEXT_FIELD], self._field))]
        path, item = self._find_path(columns)
        column = columns[path]
        if isinstance(column, TextColumn):
            raise NoSuchSeries(f"{self._topic.name}:{path} is a text, not a number")
        if item is not None:
            column = column[:, item] if item < column.shape[1] else np.full(len(column), math.nan)
        if column.ndim > 1:
            raise NoSuchSeries(
                f"{self._topic.name}:{path} has {column.shape[1]} numbers; name one: {path}[0]"
            )
        return [(self._field if item is not None else path, column.astype(np.float64))]

    def _find_path(self, columns: dict[str, Column]) -> tuple[str, int | None]:
        """Find the column that is named, and the item of an array."""
        if paths := _list_matches(columns, self._field):
            return self._require_one(paths), None
        named = ITEM.match(self._field)
        if named is not None and (paths := _list_matches(columns, named[1])):
            return self._require_one(paths), int(named[2])
        names = _list_names(columns)
        raise NoSuchSeries(f"{self._topic.name} has no field '{self._field}'; it has {names}")

    def _require_one(self, paths: Sequence[str]) -> str:
        if len(paths) > 1:
            raise NoSuchSeries(
                f"'{self._field}' of {self._topic.name} may be {_list_names(paths)}; write more"
            )
        return paths[0]


def _list_matches(columns: Iterable[str], field: str) -> list[str]:
    """List the paths that are a field, or else end with it."""
    paths = list(columns)
    return [field] if field in paths else [one for one in paths if one.endswith(f".{field}")]


def _read_json(column: Column, field: str) -> FloatColumn:
    """Read a number from each text, which is JSON, such as of statistics; NaN where it has none."""
    if not isinstance(column, TextColumn):
        raise TypeError("texts have a column of texts")
    numbers = np.array([_read_number(text, field) for text in column.texts], np.float64)
    return numbers[column.codes]


def _read_number(text: str, field: str) -> float:
    try:
        value: object = msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError):
        return math.nan
    for name in field.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    try:
        return float(value) if isinstance(value, (int, float)) else math.nan
    except OverflowError:  # an integer of hundreds of digits
        return math.nan


def _list_names(names: Iterable[str]) -> str:
    listed = list(names)
    more = f" and {len(listed) - MAX_NAMES} more" if len(listed) > MAX_NAMES else ""
    return ", ".join(listed[:MAX_NAMES]) + more
