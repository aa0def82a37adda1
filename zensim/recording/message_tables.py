"""Tables of a recording: one for each kind of topic, with a row for each message."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.schema import list_cdr_types
from zensim.proto.topic_catalog import find_robot_topic
from zensim.recording.message_columns import (
    Column,
    ColumnDecoder,
    TextColumn,
    join_columns,
    take_rows,
)
from zensim.recording.recording_reader import (
    LAST_NS,
    Accepts,
    RecordingReader,
    StoredMessage,
    StoredTopic,
    accept_all,
)

ROBOT: Final = "robot"
LOG_TIME: Final = "t_ns"
PUBLISH_TIME: Final = "publish_ns"
BATCH_BYTES: Final = 16 << 20
"""Size of the messages that are decoded at once."""
UNITS: Final = tuple(
    (re.compile(pattern), unit)
    for pattern, unit in (
        (r"(^|_)ns$|nanosec$", "ns"),
        (r"(^|\.)sec$|scan_time$|time_increment$", "s"),
        (r"linear_acceleration\.[xyz]$", "m/s^2"),
        (r"(angular|angular_velocity)\.[xyz]$", "rad/s"),
        (r"(linear|vector)\.[xyz]$", "m/s"),
        (r"(position|translation|point)\.[xyz]$", "m"),
        (r"(orientation|rotation)\.[xyzw]$", "1"),
        (r"(^|\.)(ranges|range|range_min|range_max|min_range|max_range)$", "m"),
        (r"(^|\.)(angle_min|angle_max|angle_increment|field_of_view)$", "rad"),
        (r"(^|\.)(latitude|longitude)$", "deg"),
        (r"(^|\.)(altitude|vertical_position)$", "m"),
        (r"magnetic_field\.[xyz]$", "T"),
        (r"fluid_pressure$", "Pa"),
        (r"(force)\.[xyz]$", "N"),
        (r"(torque)\.[xyz]$", "N m"),
    )
)
"""Units of columns by the end of their path; those of joints depend on the joint."""


class RecordedTable(msgspec.Struct, frozen=True, eq=False):
    """Messages of topics of one type, sorted by log time."""

    name: str
    """Suffix of the topics of robots, such as `odom`; of others the whole name."""
    ros_type: str
    columns: dict[str, Column]
    """`robot`, `t_ns` (log time), `publish_ns`, and the fields by dotted path."""
    left_out: tuple[str, ...]
    """Columns whose shape differs from message to message."""
    damaged: int
    """Messages that could not be decoded."""

    @property
    def units(self) -> dict[str, str]:
        """Units of the columns that have one: SI, and quaternions have `1`."""
        found = {path: find_unit(path) for path in self.columns}
        return {path: unit for path, unit in found.items() if unit}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns[LOG_TIME])


def find_unit(path: str) -> str:
    """Find the unit of a column; empty if it has none, or it is not known."""
    return next((unit for pattern, unit in UNITS if pattern.search(path)), "")


def find_table(topic: str) -> tuple[str, str]:
    """Find the table of a topic, and the namespace of its robot, which is empty for others."""
    key = topic.strip("/")
    spec = find_robot_topic(key)
    if spec is None:
        return key, ""
    return spec.suffix, key.removesuffix(spec.suffix).strip("/")


def read_tables(
    reader: RecordingReader,
    accepts: Accepts = accept_all,
    *,
    start_ns: int = 0,
    end_ns: int = LAST_NS,
    wants_arrays: bool = False,
) -> list[RecordedTable]:
    """Read the messages of a recording as tables, sorted by name; topics of unknown types are left.

    Args:
        reader: Recording.
        accepts: Chooses topics.
        start_ns: First log time.
        end_ns: Last log time.
        wants_arrays: See `ColumnDecoder`.

    Raises:
        OSError: A file cannot be read.
        ValueError: The compression is not supported.
    """
    known = list_cdr_types()
    builders: dict[tuple[str, str], _TableBuilder] = {}
    chosen = {
        topic: (find_table(topic.name)[0], topic.ros_type)
        for topic in reader.topics
        if topic.ros_type in known and topic.encoding == "cdr" and accepts(topic)
    }
    chunks = reader.chunks(chosen.__contains__, start_ns=start_ns, end_ns=end_ns)
    for batch in _group_chunks(chunks):
        by_table: dict[tuple[str, str], list[StoredMessage]] = {}
        for message in batch:
            by_table.setdefault(chosen[message[0]], []).append(message)
        for table, messages in by_table.items():
            if table not in builders:
                builders[table] = _TableBuilder(*table, known[table[1]], wants_arrays=wants_arrays)
            builders[table].add(messages)
    return [builder.build() for _, builder in sorted(builders.items())]


def _group_chunks(chunks: Iterable[list[StoredMessage]]) -> Iterator[list[StoredMessage]]:
    batch: list[StoredMessage] = []
    size = 0
    for chunk in chunks:
        batch += chunk
        size += sum(len(message[3]) for message in chunk)
        if size >= BATCH_BYTES:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch


class _TableBuilder:
    """Groups of rows of one table."""

    def __init__(
        self, name: str, ros_type: str, kind: type[msgspec.Struct], *, wants_arrays: bool
    ) -> None:
        self._name = name
        self._ros_type = ros_type
        self._decoder = ColumnDecoder(kind, wants_arrays=wants_arrays)
        self._robots: dict[str, int] = {}
        self._codes: dict[StoredTopic, int] = {}
        self._groups: list[Mapping[str, Column]] = []

    def add(self, messages: list[StoredMessage]) -> None:
        """Decode messages."""
        times = np.array([(log_ns, publish_ns) for _, log_ns, publish_ns, _ in messages], np.uint64)
        robots = np.array([self._find_robot(topic) for topic, *_ in messages], np.int32)
        for found in self._decoder.decode([payload for *_, payload in messages]):
            rows = found.messages
            own = {ROBOT: robots[rows], LOG_TIME: times[rows, 0], PUBLISH_TIME: times[rows, 1]}
            self._groups.append(own | found.columns)

    def _find_robot(self, topic: StoredTopic) -> int:
        if (found := self._codes.get(topic)) is None:
            robot = find_table(topic.name)[1]
            found = self._codes[topic] = self._robots.setdefault(robot, len(self._robots))
        return found

    def build(self) -> RecordedTable:
        """Join the groups, and sort the rows by log time."""
        columns: dict[str, Column] = {}
        left_out = []
        for path in dict.fromkeys(path for group in self._groups for path in group):
            column = join_columns(self._groups, path, LOG_TIME)
            if column is None:
                left_out.append(path)
            else:
                columns[path] = column
        for path in columns.keys() & {LOG_TIME, PUBLISH_TIME}:
            columns[path] = _to_signed(np.asarray(columns[path], np.uint64))
        times = columns.get(LOG_TIME, np.zeros(0))
        order = np.argsort(np.asarray(times), kind="stable")
        columns = {path: take_rows(column, order) for path, column in columns.items()}
        robots = np.asarray(columns.get(ROBOT, np.zeros(0)), np.int32)
        columns[ROBOT] = TextColumn(robots, tuple(self._robots))
        return RecordedTable(
            self._name, self._ros_type, columns, tuple(left_out), self._decoder.damaged
        )


def _to_signed(times: npt.NDArray[np.uint64]) -> Column:
    """Use int64, in which differences of times are, unless a time is beyond it."""
    is_near = times.max(initial=np.uint64(0)) <= np.iinfo(np.int64).max
    return times.astype(np.int64) if is_near else times
