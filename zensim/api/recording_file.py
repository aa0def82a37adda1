"""Recording: the messages of a recording by topic and time, and tables of them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Error, Invalid, NotFound
from zensim.api.argument_checks import check_range, check_text
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.schema import list_cdr_types
from zensim.recording.message_columns import TextColumn
from zensim.recording.message_tables import read_tables
from zensim.recording.recording_parts import list_further_files
from zensim.recording.recording_reader import LAST_NS, Accepts, RecordingReader
from zensim.recording.topic_selection import TopicFilter, TopicSelection

MAX_TIME_S: Final = 9e9
"""Log times have 63 bits [ns]."""


class StoredValue(msgspec.Struct, frozen=True):
    """A message of a recording."""

    topic: str
    """Name with the first slash."""
    ros_type: str
    """`pkg/msg/Name`."""
    time: float
    """Log time [s]: simulation time, unless it was recorded otherwise."""
    published: float
    """Time of day at which it was received [s]."""
    payload: bytes
    """CDR, as it was on the network."""

    @property
    def data(self) -> msgspec.Struct:
        """The decoded message, with the fields of its ROS 2 type.

        Raises:
            Invalid: zensim does not know the type, or the bytes are not that message.
        """
        kind = list_cdr_types().get(self.ros_type)
        if kind is None:
            raise Invalid(f"type '{self.ros_type}' of {self.topic} is not known", slug="no_type")
        try:
            return decode(kind, self.payload, "application/cdr")
        except MalformedPayload as error:
            text = f"a message of {self.topic} is no {self.ros_type}: {error}"
            raise Invalid(text, slug="malformed") from error


class Recording:
    """A recording that is read: an MCAP file, also one that was never closed, or a folder of files.

    Attributes:
        path: As given.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the index.

        Args:
            path: File or folder.

        Raises:
            NotFound: There is none.
            Invalid: It is not an MCAP file.
            Error: It cannot be read.
        """
        self.path = Path(path)
        with reading(self.path):
            self._reader = RecordingReader(self.path)

    @property
    def topics(self) -> dict[str, str]:
        """Types of the topics, such as `nav_msgs/msg/Odometry`, by name."""
        return {topic.name: topic.ros_type for topic in self._reader.topics}

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages of each topic."""
        counts: dict[str, int] = {}
        for topic, count in self._reader.counts.items():
            counts[topic.name] = counts.get(topic.name, 0) + count
        return counts

    @property
    def start(self) -> float:
        """First log time [s]."""
        return self._reader.start_ns / NANOSECONDS

    @property
    def end(self) -> float:
        """Last log time [s]."""
        return self._reader.end_ns / NANOSECONDS

    @property
    def is_closed(self) -> bool:
        """Whether all files were closed; of others, the last moments may be missing."""
        return not self._reader.unclosed

    @property
    def damaged(self) -> int:
        """Number of places that could not be read so far, whose messages are left out."""
        return self._reader.damaged

    @property
    def further_files(self) -> tuple[Path, ...]:
        """Files of this recording that are not read, as after a reset; give their folder instead.

        Raises:
            Error: The folder cannot be read.
        """
        with reading(self.path):
            return tuple(list_further_files(self.path))

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Named texts; `zensim` has world, engine, seed and version."""
        return self._reader.metadata

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the attached files, such as `world.sdf`."""
        return tuple(dict.fromkeys(one.name for one in self._reader.attachments))

    def attachment(self, name: str) -> bytes:
        """Read an attached file.

        Raises:
            NotFound: There is none of this name.
            Invalid: It is damaged.
            Error: The file cannot be read.
        """
        if name not in self.attachments:
            raise NotFound(
                f"no file '{name}' is attached", hint=f"of {', '.join(self.attachments)}"
            )
        with reading(self.path):
            return self._reader.read_attachment(name)

    def messages(
        self, *topics: str, start: float = 0.0, end: float | None = None
    ) -> Iterator[StoredValue]:
        """Read messages by log time.

        Args:
            topics: Names, with wildcards such as `*/odom`; all if none is given.
            start: First log time [s].
            end: Last log time [s]; None = to the end.

        Raises:
            Invalid: A topic or time is not valid, or the compression is not supported.
            Error: A file cannot be read.
        """
        start_ns, end_ns = to_log_time("start", start), to_log_time("end", end)
        return self._read_messages(make_filter(topics), start_ns, end_ns)

    def _read_messages(self, accepts: Accepts, start_ns: int, end_ns: int) -> Iterator[StoredValue]:
        with reading(self.path):
            found = self._reader.messages(accepts, start_ns=start_ns, end_ns=end_ns)
            for topic, log_ns, publish_ns, payload in found:
                times = log_ns / NANOSECONDS, publish_ns / NANOSECONDS
                yield StoredValue(topic.name, topic.ros_type, *times, payload)

    def table(
        self, *topics: str, start: float = 0.0, end: float | None = None, arrays: bool = False
    ) -> dict[str, npt.NDArray[np.generic]]:
        """Read messages of one type as columns, with a row for each message.

        Args:
            topics: Names, with wildcards such as `*/odom`.
            start: First log time [s].
            end: Last log time [s]; None = to the end.
            arrays: Whether to return arrays, too, such as covariances and ranges.

        Returns:
            Columns (n,) by path: `robot`, `t_ns` (log time), `publish_ns`, and fields such as
            `pose.pose.position.x`; arrays are (n, k).

        Raises:
            NotFound: There are no messages of these topics.
            Invalid: They are of several kinds, a topic or time is not valid, or the compression
                is not supported.
            Error: A file cannot be read.
        """
        chosen = make_filter(topics)
        start_ns, end_ns = to_log_time("start", start), to_log_time("end", end)
        with reading(self.path):
            tables = read_tables(
                self._reader, chosen, start_ns=start_ns, end_ns=end_ns, wants_arrays=arrays
            )
        if not tables:
            raise NotFound(f"no messages of {', '.join(topics) or 'any topic'}", slug="no_messages")
        if len(tables) > 1:
            kinds = ", ".join(table.name for table in tables)
            raise Invalid(f"these topics are of several kinds: {kinds}", hint="name one")
        return {
            path: np.array(column.to_list()) if isinstance(column, TextColumn) else column
            for path, column in tables[0].columns.items()
        }

    def __repr__(self) -> str:
        """Write path, topics and times."""
        return (
            f"Recording({str(self.path)!r}: {len(self.topics)} topics, "
            f"{self.start:.3f} to {self.end:.3f} s)"
        )


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Convert the errors of a reader to those of the API.

    Raises:
        NotFound: There is no recording.
        Invalid: It is no MCAP file, or is damaged, or its compression is not supported.
        Error: It cannot be read.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise NotFound(f"there is no recording '{path}'", slug="no_recording") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise Error(f"'{path}' cannot be read: {reason}", slug="no_recording") from error
    except Error:
        raise
    except ValueError as error:
        raise Invalid(str(error), slug="no_recording") from error


def to_log_time(what: str, seconds: float | None) -> int:
    """Convert seconds to a log time [ns]; None is the last that there is.

    Raises:
        Invalid: It is no number, or out of range.
    """
    if seconds is None:
        return LAST_NS
    check_range(what, seconds, -MAX_TIME_S, MAX_TIME_S)
    return round(seconds * NANOSECONDS)


def make_filter(topics: tuple[str, ...]) -> Accepts:
    """Make the function that chooses topics by name; all if none is given.

    Raises:
        Invalid: One is no text.
    """
    for topic in topics:
        check_text("topic", topic)
    chosen = TopicFilter(TopicSelection(topics=topics, wants_all=not topics))
    return lambda topic: chosen.accepts(topic.name)
