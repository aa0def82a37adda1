"""Reads a recording by time and topic: a file, the files of a folder, or a file never closed."""

import struct
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Final, TypeAlias

import msgspec

from zensim.proto.bounded_files import open_regular_file
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.ros2.qos_profiles import Qos
from zensim.recording.chunk_compression import DamagedChunk
from zensim.recording.file_index import (
    AttachmentPlace,
    ChunkPlace,
    FileIndex,
    list_files,
    read_index,
    read_record_of,
)
from zensim.recording.latched_messages import LatchedMessages
from zensim.recording.mcap_records import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    AttachedFile,
    MalformedRecord,
    Opcode,
    read_attachment,
    read_chunk,
)
from zensim.recording.mcap_scan import MAX_OTHERS, MAX_RECORD_BYTES, open_chunk
from zensim.recording.recorded_topics import QOS_METADATA, read_qos_profile
from zensim.recording.topic_selection import LATCHED_SUFFIXES
from zensim.recording.written_topics import OVERHEAD_BYTES

LAST_NS: Final = (1 << 64) - 1
"""Last log time that a file can have."""
RESET_NS: Final = NANOSECONDS
"""A file that begins so long before the end of the last one is of another run."""
MAX_LATCHED_BYTES: Final = 64 << 20
"""Most bytes of latched messages kept for the next seek; beyond it each seek reads them again."""
MESSAGE: Final = int(Opcode.MESSAGE)
MAX_WAITING_BYTES: Final = 1 << 30
"""Most bytes of messages of chunks whose times overlap: 50 MB of a file may claim terabytes."""


class StoredTopic(msgspec.Struct, frozen=True, eq=False):
    """A topic as files have it; one object for all files of a recording."""

    name: str
    """Name with the first slash."""
    ros_type: str
    """`pkg/msg/Name`."""
    encoding: str
    """Encoding of messages; `cdr` in files of ROS 2."""
    schema_encoding: str
    schema: bytes
    """Definition of the type, in its encoding."""
    channel_metadata: dict[str, str]
    qos: Qos
    is_latched: bool
    """Whether late subscribers get the last message."""

    def metadata(self) -> dict[str, str]:
        """Return what a file keeps with a channel: QoS and type hash."""
        return self.channel_metadata


StoredMessage: TypeAlias = tuple[StoredTopic, int, int, bytes]
"""Topic, log time [ns], publish time [ns], payload."""
Accepts: TypeAlias = Callable[[StoredTopic], bool]
Ordered: TypeAlias = tuple[int, int, StoredTopic, int, bytes]
"""Log time, position in its group, topic, publish time, payload: sorted by the first two."""
LoadableChunk: TypeAlias = tuple[int, Callable[[], list[Ordered]]]
"""First log time of a chunk, and what reads its messages."""


def accept_all(_: StoredTopic) -> bool:
    """Accept every topic."""
    return True


def is_latched(topic: StoredTopic) -> bool:
    """Accept latched topics."""
    return topic.is_latched


class RecordedFile:
    """A file of a recording with the topics of its channels."""

    def __init__(self, index: FileIndex, topics: Mapping[int, StoredTopic]) -> None:
        self.index = index
        self.topics = topics
        self._damaged: set[int] = set()

    @property
    def damaged(self) -> int:
        """Number of places that could not be read so far."""
        return self.index.damaged + len(self._damaged)

    def read_messages(
        self, place: ChunkPlace, wanted: Mapping[int, StoredTopic], span: range, first: int = 0
    ) -> list[Ordered]:
        """Read the messages of channels within a time, in the order of the file; none if damaged.

        Args:
            place: Where they are.
            wanted: Topics by channel.
            span: Log times [ns].
            first: Position of the chunk, which the positions of its messages follow.

        Raises:
            OSError: The file cannot be read.
            ValueError: The compression is not supported.
        """
        try:
            records = self._read_records(place)
        except (DamagedChunk, MalformedRecord, struct.error):
            self._damaged.add(place.at)
            return []
        found: list[Ordered] = []
        unpack, head, record_head = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, RECORD_HEAD.size
        find, append = wanted.get, found.append
        start_ns, end_ns = span.start, span.stop
        at, last, others = 0, len(records) - head, 0
        while at <= last and others <= MAX_OTHERS:
            opcode, length, channel, _, log_ns, publish_ns = unpack(records, at)
            end = at + record_head + length
            if end > len(records):
                break
            if opcode != MESSAGE:
                others += 1
            elif start_ns <= log_ns < end_ns:
                topic = find(channel)
                if topic is not None:
                    append((log_ns, first + at, topic, publish_ns, records[at + head : end]))
            at = end
        return found

    def read_attachment(self, place: AttachmentPlace) -> AttachedFile:
        """Read an attached file.

        Raises:
            OSError: The file cannot be read.
            MalformedRecord: It is damaged.
        """
        with open_regular_file(self.index.path) as stream:
            return read_attachment(read_record_of(stream, place.at, place.length)[1])

    def _read_records(self, place: ChunkPlace) -> bytes:
        with open_regular_file(self.index.path) as stream:
            if place.is_loose:
                stream.seek(place.at)
                return stream.read(place.length)
            opcode, body = read_record_of(stream, place.at, place.length)
        if opcode != Opcode.CHUNK:
            raise MalformedRecord(f"there is no chunk at byte {place.at}")
        return open_chunk(read_chunk(body)).records


class RecordingRun:
    """Files between two resets of time; its messages are sorted by log time."""

    def __init__(self, files: Sequence[RecordedFile]) -> None:
        self._files = tuple(files)
        times = [one.index.times for one in files if one.index.times is not None]
        self.start_ns = min((start for start, _ in times), default=0)
        """First log time."""
        self.end_ns = max((end for _, end in times), default=0)
        self._latched: list[StoredMessage] = []
        self._latched_bytes = 0
        self._latched_until_ns = -1
        """Up to this log time, latched messages were read."""

    @property
    def attachments(self) -> tuple[AttachmentPlace, ...]:
        """Files that are attached to the files of this run, in their order."""
        return tuple(one for file in self._files for one in file.index.attachments)

    def read_attachment(self, name: str) -> bytes:
        """Read an attached file of this run; see `RecordingReader.read_attachment`."""
        return _read_attachment(self._files, name)

    def messages(
        self, accepts: Accepts = accept_all, *, start_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[StoredMessage]:
        """Read messages by log time; those of one time in the order of the files.

        In memory are those chunks only whose times overlap.

        Args:
            accepts: Chooses topics.
            start_ns: First log time that is wanted.
            end_ns: Last log time that is wanted.

        Raises:
            OSError: A file cannot be read.
            ValueError: The compression is not supported, or chunks whose times overlap have more
                than 1 GiB.
        """
        waiting: list[Ordered] = []
        listed = self._list_chunks(accepts, range(start_ns, end_ns + 1))
        for begin_ns, load in sorted(listed, key=itemgetter(0)):
            due = bisect_left(waiting, (begin_ns,))
            yield from _to_messages(waiting[:due])
            waiting = waiting[due:]
            if waiting:
                _require_room(waiting)
            waiting += load()
            waiting.sort()
        yield from _to_messages(waiting)

    def chunks(
        self, accepts: Accepts = accept_all, *, start_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[list[StoredMessage]]:
        """Read the messages of one chunk after the other; see `messages`.

        They are in the order in which they were written, which is that of their receipt.
        """
        listed = self._list_chunks(accepts, range(start_ns, end_ns + 1))
        return (list(_to_messages(load())) for _, load in listed)

    def latched_at(self, time_ns: int, accepts: Accepts = accept_all) -> list[StoredMessage]:
        """Read what latched topics have at a log time: the last message; of `/tf_static` all."""
        latched: LatchedMessages[StoredTopic] = LatchedMessages()
        for topic, log_ns, _, payload in self._list_latched(time_ns):
            if log_ns > time_ns:
                break
            if accepts(topic):
                latched.add(topic, payload)
        return list(latched.list_at(time_ns, time_ns))

    def _list_latched(self, time_ns: int) -> Iterable[StoredMessage]:
        """List the latched messages at least up to a log time; each is read once.

        Each seek of a replay asks for them. Those that repeat the one before are left out.
        """
        first_ns = self._latched_until_ns + 1
        if self._latched_bytes > MAX_LATCHED_BYTES:
            return self.messages(is_latched, end_ns=time_ns)
        if time_ns >= first_ns:
            last = {topic: payload for topic, _, _, payload in self._latched}
            # What an error ends is read again by the next seek.
            found, length = list[StoredMessage](), self._latched_bytes
            for message in self.messages(is_latched, start_ns=first_ns, end_ns=time_ns):
                if last.get(message[0]) != message[3]:
                    last[message[0]] = message[3]
                    found.append(message)
                    length += len(message[3])
                if length > MAX_LATCHED_BYTES:
                    self._latched.clear()
                    self._latched_bytes = length
                    return self._list_latched(time_ns)
            self._latched.extend(found)
            self._latched_bytes, self._latched_until_ns = length, time_ns
        return self._latched

    def _list_chunks(self, accepts: Accepts, span: range) -> Iterator[LoadableChunk]:
        """List the chunks with wanted messages, in the order of the files."""
        first = 0
        for file in self._files:
            wanted = {number: one for number, one in file.topics.items() if accepts(one)}
            wants_all = len(wanted) == len(file.topics)
            for place in file.index.chunks:
                first += MAX_RECORD_BYTES  # equal times keep the order of the file
                is_in_time = place.start_ns < span.stop and place.end_ns >= span.start
                if is_in_time and (wants_all or place.has_any(wanted.keys())):
                    yield place.start_ns, partial(file.read_messages, place, wanted, span, first)


class RecordingReader:
    """Index of a recording; messages are read when they are asked for."""

    def __init__(self, path: Path) -> None:
        """Read the index of each file; a file without one is read in whole.

        Args:
            path: An MCAP file, or a folder with such files.

        Raises:
            OSError: A file cannot be read, or there is none.
            ValueError: A file is not an MCAP file, or its compression is not supported.
        """
        self.path = path
        topics: dict[tuple[str, str, str], StoredTopic] = {}
        self._files = [_open_file(file, topics) for file in list_files(path)]
        self.topics = tuple(topics.values())
        """All topics, in the order of their first definition."""
        self.runs = tuple(map(RecordingRun, _split_runs(self._files)))
        """Runs, at least one; another one for each reset of time."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files, in the order of their numbers."""
        return tuple(one.index.path for one in self._files)

    @property
    def unclosed(self) -> tuple[Path, ...]:
        """Files that were never closed."""
        return tuple(one.index.path for one in self._files if not one.index.is_closed)

    @property
    def damaged(self) -> int:
        """Number of places that could not be read so far."""
        return sum(one.damaged for one in self._files)

    @property
    def start_ns(self) -> int:
        """First log time of the first run."""
        return self.runs[0].start_ns

    @property
    def end_ns(self) -> int:
        """Last log time of the last run."""
        return self.runs[-1].end_ns

    @property
    def counts(self) -> dict[StoredTopic, int]:
        """Number of messages of each topic."""
        counts = dict.fromkeys(self.topics, 0)
        for file in self._files:
            for number, topic in file.topics.items():
                counts[topic] += file.index.counts.get(number, 0)
        return counts

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Named texts; of equal names the last."""
        return {one.name: one.texts for file in self._files for one in file.index.metadata}

    @property
    def attachments(self) -> tuple[AttachmentPlace, ...]:
        """Attached files; a recording of several files has some more than once."""
        return tuple(one for file in self._files for one in file.index.attachments)

    def messages(
        self, accepts: Accepts = accept_all, *, start_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[StoredMessage]:
        """Read the messages of one run after the other; see `RecordingRun.messages`."""
        return chain.from_iterable(
            run.messages(accepts, start_ns=start_ns, end_ns=end_ns) for run in self.runs
        )

    def chunks(
        self, accepts: Accepts = accept_all, *, start_ns: int = 0, end_ns: int = LAST_NS
    ) -> Iterator[list[StoredMessage]]:
        """Read the messages of one chunk after the other; see `RecordingRun.chunks`."""
        return chain.from_iterable(
            run.chunks(accepts, start_ns=start_ns, end_ns=end_ns) for run in self.runs
        )

    def read_attachments(self) -> Iterator[AttachedFile]:
        """Read all attached files, one at a time.

        Raises:
            OSError: A file cannot be read.
            MalformedRecord: An attached file is damaged.
        """
        for file in self._files:
            for place in file.index.attachments:
                yield file.read_attachment(place)

    def read_attachment(self, name: str) -> bytes:
        """Read an attached file; of equal names the last.

        Raises:
            KeyError: There is none.
            OSError: The file cannot be read.
            MalformedRecord: It is damaged.
        """
        return _read_attachment(self._files, name)


class RunSpan(msgspec.Struct, frozen=True):
    """The part of a run between two positions: times since the first message, without resets."""

    number: int
    """Number of the run."""
    run: RecordingRun
    shift_ns: int
    """Position of a message less its log time."""
    start_ns: int
    """First log time that is wanted."""
    end_ns: int
    """Last log time that is wanted."""


def list_spans(runs: Sequence[RecordingRun], start_ns: int, end_ns: int) -> Iterator[RunSpan]:
    """List what lies between two positions [ns]; position 0 is the first message."""
    first = 0
    for number, run in enumerate(runs):
        last = first + run.end_ns - run.start_ns
        shift = first - run.start_ns
        if first <= end_ns and last >= start_ns:
            yield RunSpan(number, run, shift, max(run.start_ns, start_ns - shift), end_ns - shift)
        first = last


def _read_attachment(files: Sequence[RecordedFile], name: str) -> bytes:
    for file in reversed(files):
        for place in reversed(file.index.attachments):
            if place.name == name:
                return file.read_attachment(place).content
    raise KeyError(name)


def _require_room(waiting: Sequence[Ordered]) -> None:
    size = sum(len(one[4]) for one in waiting) + OVERHEAD_BYTES * len(waiting)
    if size > MAX_WAITING_BYTES:
        raise ValueError(
            f"chunks whose times overlap have more than {MAX_WAITING_BYTES >> 20} MiB; choose "
            "fewer topics"
        )


def _to_messages(ordered: Iterable[Ordered]) -> Iterator[StoredMessage]:
    return (
        (topic, log_ns, publish_ns, payload) for log_ns, _, topic, publish_ns, payload in ordered
    )


def _open_file(path: Path, topics: dict[tuple[str, str, str], StoredTopic]) -> RecordedFile:
    """Read the index of a file; complete the topics of the recording."""
    index = read_index(path)
    found = {}
    for number, channel in index.channels.items():
        schema = index.schemas.get(channel.schema)
        name = schema.name if schema is not None else ""
        key = channel.topic, name, channel.encoding
        if key not in topics:
            qos = read_qos_profile(channel.metadata.get(QOS_METADATA, ""))
            is_latched = qos.durability == "transient_local"
            if QOS_METADATA not in channel.metadata:
                is_latched = channel.topic.rpartition("/")[2] in LATCHED_SUFFIXES
            topics[key] = StoredTopic(
                *key,
                schema_encoding=schema.encoding if schema is not None else "",
                schema=schema.text if schema is not None else b"",
                channel_metadata=channel.metadata,
                qos=qos,
                is_latched=is_latched,
            )
        found[number] = topics[key]
    return RecordedFile(index, found)


def _split_runs(files: Sequence[RecordedFile]) -> list[list[RecordedFile]]:
    """Group the files between resets: time goes back from one to the next."""
    runs: list[list[RecordedFile]] = []
    last: tuple[int, int] | None = None
    for file in files:
        times = file.index.times
        is_back = (
            times is not None
            and last is not None
            and (times[0] <= last[0] or times[0] < last[1] - RESET_NS)
        )
        if is_back or not runs:
            runs.append([])
        runs[-1].append(file)
        last = times or last
    return runs
