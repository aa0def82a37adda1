"""The files of a recording: a new one by size, by time or at a reset, each whole in itself."""

import errno
import json
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from operator import itemgetter
from pathlib import Path
from typing import Final, Generic

import msgspec

from zensim.proto.bounded_files import (
    MAX_OWN_FILE_BYTES,
    open_regular_file,
    read_file,
    read_text_file,
)
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.recording.bag_metadata import CUSTOM_DATA, PartFacts, write_bag_metadata
from zensim.recording.file_index import read_index
from zensim.recording.latched_messages import LatchedMessages
from zensim.recording.mcap_records import (
    RECORD_HEAD,
    AttachedFile,
    Channel,
    Metadata,
    Schema,
    read_attachment,
)
from zensim.recording.mcap_writer import DEFAULT_CHUNKS, ChunkSettings, McapWriter
from zensim.recording.output_file import OutputFile, find_reserve
from zensim.recording.recorded_topics import QOS_METADATA
from zensim.recording.recovery import recover_file
from zensim.recording.written_topics import Topic, WrittenTopic

FLUSH_PERIOD_S: Final = 0.5
FLUSH_PERIOD_NS: Final = NANOSECONDS // 2
"""Log time after which a chunk is written, where files of equal runs have to be equal."""
SUFFIX: Final = ".mcap"
MAX_CHANNELS: Final = (1 << 16) - 1
"""Most channels of a file: their numbers have 16 bits."""
METADATA_FILE: Final = "metadata.yaml"
FILE_IN_METADATA: Final = re.compile(r"[^\s\"',/\[\]]+" + re.escape(SUFFIX))
PART: Final = "part"
"""Key of the number of a file, counted from 0, in its facts."""


class DiskFull(OSError):
    """Less than the least free space is left."""


class PartSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Where files are written, and when a new one begins."""

    path: Path
    """A file with suffix `.mcap`, or a new folder as of rosbag2."""
    max_bytes: int = 0
    """0 = no limit."""
    max_duration_ns: int = 0
    """Longest log time of a file; 0 = no limit."""
    min_free_bytes: int = 0
    """The recording ends before the disk has less."""
    is_synchronous: bool = False
    keep_ns: int = 0
    """Files are deleted as soon as later ones have this much log time; 0 = never."""
    chunks: ChunkSettings = DEFAULT_CHUNKS
    custom_data: tuple[tuple[str, str], ...] = ()
    """Names and texts that are kept with the recording, as of rosbag2."""
    is_reproducible: bool = False
    """Whether chunks end by log time instead of wall time."""
    continues: bool = False
    """Whether the recording may exist: its files stay, and the next number follows."""


class Part:
    """One file."""

    def __init__(self, path: Path, settings: PartSettings) -> None:
        self.output = OutputFile(path, is_synchronous=settings.is_synchronous)
        self.writer = McapWriter(self.output, settings.chunks)
        self.channels: dict[WrittenTopic, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}
        self.start_ns: int | None = None
        self.attached: list[tuple[int, int]] = []
        """Position and length of each attachment."""

    def has_room(self, topic: WrittenTopic) -> bool:
        """Whether there is a number for the channel of a topic."""
        return len(self.channels) < MAX_CHANNELS or topic in self.channels

    def find_channel(self, topic: WrittenTopic) -> int:
        """Find the channel of a topic; define it at its first message.

        Raises:
            OSError: Channels have no more numbers.
        """
        if (found := self.channels.get(topic)) is not None:
            return found
        if len(self.channels) >= MAX_CHANNELS:
            raise OSError(
                errno.EOVERFLOW, f"a file has at most {MAX_CHANNELS} topics; record fewer"
            )
        number = self.channels[topic] = len(self.channels) + 1
        kind = topic.ros_type, topic.schema
        schema = self._schemas.get(kind)
        if schema is None:
            schema = self._schemas[kind] = len(self._schemas) + 1
            self.writer.define(Schema(schema, kind[0], topic.schema_encoding, kind[1]))
        self.writer.define(Channel(number, schema, topic.name, topic.encoding, topic.metadata()))
        return number

    def attach(self, attachment: AttachedFile) -> None:
        """Write a file into this one.

        Raises:
            OSError: It could not be written.
        """
        at = self.output.position
        self.writer.attach(attachment)
        self.attached.append((at, self.output.position - at))

    def read_attachments(self) -> Iterator[AttachedFile]:
        """Read the attachments that were written.

        Raises:
            OSError: The file cannot be read.
        """
        with open_regular_file(self.output.path) as stream:
            for at, length in self.attached:
                stream.seek(at + RECORD_HEAD.size)
                yield read_attachment(stream.read(length - RECORD_HEAD.size))

    def describe(self) -> PartFacts:
        """Describe what is in the file."""
        counts = self.writer.counts
        return PartFacts(
            file=self.output.path.name,
            span_ns=self.writer.span_ns,
            topics={
                (topic.name, topic.ros_type, topic.metadata().get(QOS_METADATA, "")): counts.get(
                    number, 0
                )
                for topic, number in self.channels.items()
            },
            bytes=self.output.position,
        )


def remove_recording(path: Path) -> None:
    """Remove the files of a recording: those that are written to this path, and no others.

    `run_1.mcap` may be the second file of `run.mcap`, or a recording of its own: each file says
    which it is.

    Raises:
        OSError: One cannot be removed.
    """
    is_folder = path.suffix != SUFFIX
    if is_folder and not path.is_dir():
        return
    metadata = (path if is_folder else path.parent) / METADATA_FILE
    is_own = is_folder or is_described(path)
    for file in list(list_own_files(path)):
        file.unlink()
        find_reserve(file).unlink(missing_ok=True)
    if is_own:
        metadata.unlink(missing_ok=True)
    if is_folder:
        with suppress(OSError):  # others' files are in it
            path.rmdir()


def list_further_files(path: Path) -> list[Path]:
    """List the other files of the recording that a file is the first of; none of a folder.

    Raises:
        OSError: The folder cannot be read.
    """
    return [] if path.is_dir() else [one for one in list_own_files(path) if one != path]


def list_missing_files(path: Path) -> list[str]:
    """List the files that the metadata of a folder name and that are not there; none of a file.

    Raises:
        OSError: The folder cannot be read.
    """
    metadata = path / METADATA_FILE
    if not path.is_dir() or not metadata.exists():
        return []
    text = read_file(metadata, MAX_OWN_FILE_BYTES).decode(errors="replace")
    named = dict.fromkeys(FILE_IN_METADATA.findall(text))
    return [name for name in named if not (path / name).exists()]


def list_own_files(path: Path) -> Iterator[Path]:
    """List the files of the recording at a path; the first may be deleted (`keep_ns`).

    Raises:
        OSError: The folder cannot be read.
    """
    is_folder = path.suffix != SUFFIX
    folder, stem = (path, path.name) if is_folder else (path.parent, path.stem)
    if not is_folder and path.exists():
        yield path
    named = re.compile(rf"{re.escape(stem)}_([0-9]+){re.escape(SUFFIX)}")
    found = [
        (file, int(match[1])) for file in folder.glob("*") if (match := named.fullmatch(file.name))
    ]
    facts = None if is_folder or not path.exists() else _read_facts(path, 0)
    for file, number in sorted(found, key=itemgetter(1)):
        if is_folder:
            yield file
        elif (own := _read_facts(file, number)) is not None:
            facts = facts or own
            if own == facts:
                yield file


def _read_facts(file: Path, number: int) -> dict[str, str] | None:
    """Read the facts of a recording in its file with a number; None if it is no such file."""
    try:
        metadata = read_index(file).metadata
    except (OSError, ValueError):
        return None
    texts = {name: text for one in metadata for name, text in one.texts.items()}
    return texts if texts.pop(PART, "") == str(number) else None


def finish_file(file: Path) -> PartFacts:
    """Give a file of a recording that was cut off its summary, and describe it.

    Raises:
        OSError: It cannot be read.
    """
    try:
        index = read_index(file)
        if not index.is_closed:
            _replace_by_recovered(file)
            index = read_index(file)
    except ValueError:  # killed before anything was written
        return PartFacts(file=file.name, span_ns=(0, 0), topics={}, bytes=file.stat().st_size)
    names = {
        number: (
            one.topic,
            index.schemas[one.schema].name if one.schema in index.schemas else "",
            one.metadata.get(QOS_METADATA, ""),
        )
        for number, one in index.channels.items()
    }
    return PartFacts(
        file=file.name,
        span_ns=index.times or (0, 0),
        topics={name: index.counts.get(number, 0) for number, name in names.items()},
        bytes=file.stat().st_size,
    )


def _replace_by_recovered(file: Path) -> None:
    """Replace a file by its whole records; it stays if the disk has no room for both."""
    recovered = file.with_name(f".{file.name}.recovered")
    recovered.unlink(missing_ok=True)
    try:
        recover_file(file, recovered)
        recovered.replace(file)
    except OSError:
        recovered.unlink(missing_ok=True)


def name_part(path: Path, number: int) -> Path:
    """Name a file of a recording, counted from 0."""
    if path.suffix != SUFFIX:
        return path / f"{path.name}_{number}{SUFFIX}"
    return path.with_name(f"{path.stem}_{number}{SUFFIX}") if number else path


def require_new(path: Path) -> None:
    """Check that a file or folder does not exist.

    Raises:
        FileExistsError: It does.
    """
    if path.exists():
        raise FileExistsError(f"{path} exists; give another `output`")


def is_described(path: Path) -> bool:
    """Whether the metadata beside a file is of it, or of one of this name that is gone."""
    try:
        text = read_text_file(path.parent / METADATA_FILE, MAX_OWN_FILE_BYTES)
    except (OSError, UnicodeDecodeError):
        return False
    return json.dumps(path.name) in text


class RecordingParts(Generic[Topic]):
    """Writes messages to files; used by one thread."""

    def __init__(self, settings: PartSettings, facts: Metadata | None = None) -> None:
        """Create the first file.

        Args:
            settings: Where, and how large files are.
            facts: Texts with which each file begins, and to which its number is added.

        Raises:
            OSError: It exists and is not continued, or cannot be created.
        """
        if not settings.continues:
            require_new(settings.path)
        # A program that records itself may change its directory.
        path = settings.path.absolute()
        self._settings, self._facts = msgspec.structs.replace(settings, path=path), facts
        self._is_limited = bool(settings.max_bytes or settings.max_duration_ns)
        self._is_folder = path.suffix != SUFFIX
        self._folder = path if self._is_folder else path.parent
        if self._is_folder:
            path.mkdir(parents=True, exist_ok=settings.continues)
        self._before = tuple(list_own_files(path)) if settings.continues else ()
        self._metadata_file = self._find_metadata_file()
        self._number = 0
        self._done: list[PartFacts] = []
        self._latched: LatchedMessages[Topic] = LatchedMessages()
        self._flush_at_s = 0.0
        self._bytes = 0
        self._is_closed = False
        self.offered = 0
        """Messages that were to be written."""
        self.deleted = 0
        """Messages in files that were deleted, as newer ones are kept."""
        self._flushed_ns = 0
        self._part = self._open()
        self._tally: tuple[int, tuple[Part, ...]] = (0, (self._part,))
        """Messages in closed files, also in deleted ones, and the open files; replaced at once,
        as another thread reads it."""

    @property
    def written(self) -> int:
        """Messages that were written, also to files that are deleted."""
        closed, parts = self._tally
        return closed + sum(one.writer.messages for one in parts)

    @property
    def written_bytes(self) -> int:
        """Bytes of all files."""
        return self._bytes + sum(one.output.position for one in self._tally[1])

    @property
    def topics(self) -> int:
        """Number of topics in the last file."""
        return len(self._part.channels)

    def write(self, message: tuple[Topic, int, int, bytes]) -> None:
        """Write a message; latched ones only when they change.

        Raises:
            OSError: The disk is full, or cannot be written.
        """
        topic, log_ns, publish_ns, payload = message
        if topic.is_latched and not self._latched.add(topic, payload):
            return
        part = self._part
        if part.start_ns is None:
            part.start_ns = log_ns
        elif (self._is_limited and self._is_full(log_ns)) or not part.has_room(topic):
            self._start_part_for(message)
            part = self._part
            if topic.is_latched:
                return  # the new part begins with it
        self.offered += 1
        channel = part.channels.get(topic) or part.find_channel(topic)
        part.writer.write_message(channel, log_ns, publish_ns, payload)
        if self._settings.is_reproducible and log_ns >= self._flushed_ns + FLUSH_PERIOD_NS:
            self._flushed_ns = log_ns
            part.writer.flush()

    def _start_part_for(self, message: tuple[Topic, int, int, bytes]) -> None:
        """Begin the next file for a message, which counts as offered if there is none."""
        try:
            self.start_part(*message[1:3])
        except OSError:
            self.offered += 1
            raise

    def _is_full(self, log_ns: int) -> bool:
        settings, part = self._settings, self._part
        if settings.max_bytes and part.output.position >= settings.max_bytes:
            return True
        start_ns = part.start_ns if part.start_ns is not None else log_ns
        return bool(settings.max_duration_ns) and log_ns - start_ns >= settings.max_duration_ns

    def start_part(self, log_ns: int, publish_ns: int) -> None:
        """Begin the next file with the latched messages, at this time.

        Raises:
            OSError: See `write`.
        """
        ended, self._part = self._part, self._open()
        self._tally = self._tally[0], (ended, self._part)
        # The new file is the present one already: what fails here ends the recording there.
        self._close_part(ended)
        following = self._part
        self._flushed_ns = log_ns
        if self._settings.keep_ns:
            for one in ended.read_attachments():
                following.attach(one)
            self._delete_old()
        self._part.start_ns = log_ns
        for topic, _, _, payload in self._latched.list_at(log_ns, publish_ns):
            self.offered += 1
            channel = self._part.find_channel(topic)
            self._part.writer.write_message(channel, log_ns, publish_ns, payload)

    def flush_if_due(self, now_s: float) -> None:
        """Write what waits each half second of wall time; check the free space.

        Raises:
            OSError: See `write`.
        """
        if now_s >= self._flush_at_s:
            self._flush_at_s = now_s + FLUSH_PERIOD_S
            self._check_space()
            if not self._settings.is_reproducible:
                self._part.writer.flush()
            self._part.output.reserve(self._part.writer.summary_bytes)

    def attach(self, attachment: AttachedFile) -> None:
        """Write a file into the recording.

        Raises:
            OSError: See `write`.
        """
        self._part.attach(attachment)

    def close(
        self, facts: Iterable[Metadata] = (), attachments: Iterable[AttachedFile] = ()
    ) -> None:
        """Close the last file, with facts on the recording.

        Raises:
            OSError: The disk is full; what was written is readable all the same.
        """
        if self._is_closed:
            return
        try:
            self._part.writer.flush()
        finally:
            self._part.output.release()
            try:
                for attachment in attachments:
                    self._part.writer.attach(attachment)
                for one in facts:
                    self._part.writer.add_metadata(one)
            finally:
                self._is_closed = True
                self._close_part(self._part)

    def discard(self) -> None:
        """Close the last file if need be, and remove all files of this recording."""
        with suppress(OSError):
            self.close()
        for one in self._done:
            (self._folder / one.file).unlink(missing_ok=True)
        if self._metadata_file is not None:
            self._metadata_file.unlink(missing_ok=True)
        if self._is_folder:
            with suppress(OSError):
                self._folder.rmdir()

    def _close_part(self, part: Part) -> None:
        try:
            part.writer.flush()
        finally:
            # The summary has the room that was kept for it.
            part.output.release()
            try:
                part.writer.close()
            finally:
                part.output.close()
                facts = part.describe()
                self._done.append(facts)
                closed, parts = self._tally
                self._bytes += facts.bytes
                left = tuple(one for one in parts if one is not part)
                self._tally = closed + facts.messages, left
                self._write_metadata()

    def _find_metadata_file(self) -> Path | None:
        """Find where metadata is written; that of another recording in the folder stays."""
        file = self._folder / METADATA_FILE
        is_of_another = file.exists() and not is_described(self._settings.path)
        return None if is_of_another else file

    def _write_metadata(self) -> None:
        if self._metadata_file is not None:
            if self._before:
                self._done[:0] = map(finish_file, self._before)
                self._before = ()
            text = write_bag_metadata(self._done, self._settings.custom_data)
            self._metadata_file.write_text(text, encoding="utf-8")

    def _delete_old(self) -> None:
        """Delete files without which enough log time is left."""
        done, keep_ns = self._done, self._settings.keep_ns
        while done and sum(one.duration_ns for one in done[1:]) >= keep_ns:
            oldest = done.pop(0)
            self.deleted += oldest.messages
            self._bytes -= oldest.bytes
            (self._folder / oldest.file).unlink(missing_ok=True)  # it may have been moved away
            self._write_metadata()

    def _open(self) -> Part:
        skips = self._settings.continues
        while (self._number or skips) and name_part(self._settings.path, self._number).exists():
            self._number += 1  # of another recording, such as run_1.mcap beside run.mcap
        number, self._number = self._number, self._number + 1
        part = Part(name_part(self._settings.path, number), self._settings)
        try:
            if (facts := self._facts) is not None:
                texts = {**facts.texts, PART: str(number)}
                part.writer.add_metadata(Metadata(facts.name, texts))
            if self._settings.custom_data:
                texts = dict(self._settings.custom_data)
                part.writer.add_metadata(Metadata(CUSTOM_DATA, texts))
            part.output.reserve(part.writer.summary_bytes)
        except OSError:
            part.output.close()
            raise
        return part

    def _check_space(self) -> None:
        least = self._settings.min_free_bytes
        if not least:
            return
        free = shutil.disk_usage(self._part.output.path.parent).free
        if free < least:
            raise DiskFull(
                f"{free >> 20} MiB are free at {self._part.output.path.parent}, less than "
                f"{least >> 20} MiB (`min_free`)"
            )
