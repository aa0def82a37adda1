"""The files of a recording: a new one by size, by time or at a reset, each whole in itself."""

import shutil
from pathlib import Path
from typing import Final

import msgspec

from zensim.recording.bag_metadata import PartFacts, write_bag_metadata
from zensim.recording.latched_messages import LatchedMessages
from zensim.recording.mcap_records import AttachedFile, Channel, Metadata, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.message_definitions import write_definition
from zensim.recording.output_file import OutputFile
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic

FLUSH_PERIOD_S: Final = 0.5
SUFFIX: Final = ".mcap"
ENCODING: Final = "cdr"
SCHEMA_ENCODING: Final = "ros2msg"


class DiskFull(OSError):
    """Less than the least free space is left."""


class PartSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Where files are written, and when a new one begins."""

    path: Path
    """A file with suffix `.mcap`, or a new folder as of rosbag2."""
    max_bytes: int = 0
    """0 = no limit."""
    max_duration_ns: int = 0
    """Of log time; 0 = no limit."""
    min_free_bytes: int = 0
    """The recording ends before the disk has less."""
    is_synchronous: bool = False


class Part:
    """One file."""

    def __init__(self, path: Path, *, is_synchronous: bool) -> None:
        self.output = OutputFile(path, is_synchronous=is_synchronous)
        self.writer = McapWriter(self.output)
        self.channels: dict[RecordedTopic, int] = {}
        self._schemas: dict[str, int] = {}
        self.start_ns: int | None = None

    def find_channel(self, topic: RecordedTopic) -> int:
        """Find the channel of a topic; define it at its first message."""
        if (found := self.channels.get(topic)) is not None:
            return found
        number = self.channels[topic] = len(self.channels) + 1
        name = topic.ros_type
        schema = self._schemas.get(name)
        if schema is None:
            schema = self._schemas[name] = len(self._schemas) + 1
            text = write_definition(topic.kind).encode()
            self.writer.define(Schema(schema, name, SCHEMA_ENCODING, text))
        self.writer.define(Channel(number, schema, topic.name, ENCODING, topic.metadata()))
        return number

    def describe(self) -> PartFacts:
        """Describe what is in the file."""
        counts = self.writer.counts
        return PartFacts(
            file=self.output.path.name,
            span_ns=self.writer.span_ns,
            topics={
                (topic.name, topic.ros_type, topic.metadata()["offered_qos_profiles"]): counts.get(
                    number, 0
                )
                for topic, number in self.channels.items()
            },
        )


class RecordingParts:
    """Writes messages to files; used by one thread."""

    def __init__(self, settings: PartSettings) -> None:
        """Create the first file.

        Raises:
            OSError: It exists, or cannot be created.
        """
        self._settings = settings
        self._is_folder = settings.path.suffix != SUFFIX
        if self._is_folder:
            settings.path.mkdir(parents=True)
        elif settings.path.exists():
            raise FileExistsError(f"{settings.path} exists; give another --output")
        self._number = 0
        self._done: list[PartFacts] = []
        self._latched = LatchedMessages()
        self._flush_at_s = 0.0
        self._bytes = 0
        self._is_closed = False
        self.offered = 0
        """Messages that were to be written."""
        self._part = self._open()

    @property
    def written(self) -> int:
        """Messages in all files."""
        done = sum(one.messages for one in self._done)
        return done if self._is_closed else done + self._part.writer.messages

    @property
    def written_bytes(self) -> int:
        """Bytes of all files."""
        return self._bytes if self._is_closed else self._bytes + self._part.output.position

    @property
    def topics(self) -> int:
        """Number of topics in the last file."""
        return len(self._part.channels)

    def write(self, message: RecordedMessage) -> None:
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
        elif self._is_full(log_ns):
            self.start_part(log_ns, publish_ns)
            part = self._part
            if topic.is_latched:
                return  # the new part begins with it
        self.offered += 1
        part.writer.write_message(part.find_channel(topic), log_ns, publish_ns, payload)

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
        following = self._open()
        self._close_part()
        self._part = following
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
            self._part.writer.flush()
            self._part.output.reserve(self._part.writer.summary_bytes)

    def attach(self, attachment: AttachedFile) -> None:
        """Write a file into the recording.

        Raises:
            OSError: See `write`.
        """
        self._part.writer.attach(attachment)

    def close(self, facts: Metadata, attachment: AttachedFile) -> None:
        """Close the last file, with facts on the recording.

        Raises:
            OSError: The disk is full; what was written is readable all the same.
        """
        try:
            self._part.writer.flush()
        finally:
            self._part.output.release()
            try:
                self._part.writer.attach(attachment)
                self._part.writer.add_metadata(facts)
            finally:
                self._close_part()
                self._is_closed = True

    def _close_part(self) -> None:
        part = self._part
        try:
            part.writer.flush()
        finally:
            # The summary has the room that was kept for it.
            part.output.release()
            try:
                part.writer.close()
            finally:
                part.output.close()
                self._bytes += part.output.position
                self._done.append(part.describe())
                self._write_metadata()

    def _write_metadata(self) -> None:
        if self._is_folder:
            text = write_bag_metadata(self._done)
            (self._settings.path / "metadata.yaml").write_text(text, encoding="utf-8")

    def _open(self) -> Part:
        path = self._make_path()
        self._number += 1
        part = Part(path, is_synchronous=self._settings.is_synchronous)
        try:
            part.output.reserve(part.writer.summary_bytes)
        except OSError:
            part.output.close()
            raise
        return part

    def _make_path(self) -> Path:
        path, number = self._settings.path, self._number
        if self._is_folder:
            return path / f"{path.name}_{number}{SUFFIX}"
        return path.with_name(f"{path.stem}_{number}{SUFFIX}") if number else path

    def _check_space(self) -> None:
        least = self._settings.min_free_bytes
        if not least:
            return
        free = shutil.disk_usage(self._part.output.path.parent).free
        if free < least:
            raise DiskFull(
                f"{free >> 20} MiB are free at {self._part.output.path.parent}, less than "
                f"--min-free {least >> 20} MiB"
            )
