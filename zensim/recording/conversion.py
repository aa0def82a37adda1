"""Writes recordings anew: split, merged, filtered by topic and time, compressed otherwise."""

import hashlib
import heapq
from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path

import msgspec

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.recording.mcap_records import AttachedFile, Metadata
from zensim.recording.recording_parts import PartSettings, RecordingParts
from zensim.recording.recording_reader import (
    LAST_NS,
    Accepts,
    RecordingReader,
    RunSpan,
    StoredMessage,
    StoredTopic,
    list_spans,
)
from zensim.recording.staged_recording import staged_recording
from zensim.recording.topic_selection import TopicFilter


class ConversionSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What is copied, and how it is written."""

    chosen: TopicFilter
    start_ns: int = 0
    """Time since the first message of the first recording."""
    end_ns: int = LAST_NS
    parts: PartSettings


class ConversionResult(msgspec.Struct, frozen=True, kw_only=True):
    """What was written."""

    output: str
    messages: int
    topics: int
    bytes: int
    damaged: int
    """Number of places of the inputs that could not be read."""


def convert_recordings(
    readers: Sequence[RecordingReader], settings: ConversionSettings
) -> ConversionResult:
    """Write recordings to a new one, in the order of log times.

    Each file begins with the latched messages of its time. Attached files and metadata are copied,
    equal ones once.

    Raises:
        OSError: A file cannot be read or written, or the output exists.
        ValueError: No topic is chosen, a topic has two types, recordings with resets are merged, or
            the start is after the end.
    """
    topics = merge_topics(readers, settings.chosen)
    require_mergeable(readers)
    runs = [run for reader in readers for run in reader.runs]
    length_ns = max(run.end_ns for run in runs) - min(run.start_ns for run in runs)
    if settings.start_ns > length_ns:
        start_s, length_s = settings.start_ns / NANOSECONDS, length_ns / NANOSECONDS
        raise ValueError(f"the start is at {start_s:g} s, and the recording ends at {length_s:g} s")
    with staged_recording(settings.parts.path) as path:
        parts = _write_parts(readers, topics, settings, path)
    return ConversionResult(
        output=str(settings.parts.path),
        messages=parts.written,
        topics=len(set(topics.values())),
        bytes=parts.written_bytes,
        damaged=sum(one.damaged for one in readers),
    )


def _write_parts(
    readers: Sequence[RecordingReader],
    topics: dict[StoredTopic, StoredTopic],
    settings: ConversionSettings,
    path: Path,
) -> RecordingParts[StoredTopic]:
    parts: RecordingParts[StoredTopic] = RecordingParts(
        msgspec.structs.replace(settings.parts, path=path)
    )
    try:
        for attachment in _list_attachments(readers):
            parts.attach(attachment)
        for number, messages in enumerate(_list_runs(readers, topics, settings)):
            _write_run(parts, messages, is_first=not number)
        parts.close(_list_metadata(readers))
    except BaseException:
        parts.discard()
        raise
    return parts


def merge_topics(
    readers: Iterable[RecordingReader], chosen: TopicFilter
) -> dict[StoredTopic, StoredTopic]:
    """Find for each chosen topic the one that stands for it in the output.

    Raises:
        ValueError: None is chosen, or one has two types.
    """
    found: dict[str, StoredTopic] = {}
    merged = {}
    for topic in (one for reader in readers for one in reader.topics if chosen.accepts(one.name)):
        known = found.setdefault(topic.name, topic)
        if (known.ros_type, known.encoding) != (topic.ros_type, topic.encoding):
            raise ValueError(
                f"topic {topic.name} has types {known.ros_type} and {topic.ros_type}; leave it out "
                "by `exclude_topics`, or convert the recordings one by one"
            )
        merged[topic] = known
    if not merged:
        raise ValueError("no topic of the recording is chosen; 'zensim bag info' lists them")
    return merged


def require_mergeable(readers: Sequence[RecordingReader]) -> None:
    """Check that several recordings have one time line.

    Raises:
        ValueError: Time was reset in one of them.
    """
    for reader in readers if len(readers) > 1 else ():
        if len(reader.runs) > 1:
            raise ValueError(
                f"time was reset {len(reader.runs) - 1} times in {reader.path}, so others cannot "
                "be merged with it; merge single files of it"
            )


def _list_runs(
    readers: Sequence[RecordingReader],
    topics: dict[StoredTopic, StoredTopic],
    settings: ConversionSettings,
) -> Iterator[Iterator[StoredMessage]]:
    """List the messages between two resets of the output."""
    accepts = topics.__contains__
    if len(readers) == 1:
        for span in list_spans(readers[0].runs, settings.start_ns, settings.end_ns):
            yield _rename(_read_span(span, accepts), topics)
        return
    first_ns = min(reader.start_ns for reader in readers)
    spans = [
        span
        for reader in readers
        for span in list_spans(
            reader.runs,
            max(0, settings.start_ns - reader.start_ns + first_ns),
            settings.end_ns - reader.start_ns + first_ns,
        )
    ]
    sources = [_read_span(span, accepts) for span in spans]
    yield _rename(heapq.merge(*sources, key=itemgetter(1)), topics)


def _read_span(span: RunSpan, accepts: Accepts) -> Iterator[StoredMessage]:
    """Read a part of a run; what was latched before it comes first."""
    if span.start_ns > span.run.start_ns:
        for topic, _, _, payload in span.run.latched_at(span.start_ns - 1, accepts):
            yield topic, span.start_ns, span.start_ns, payload
    yield from span.run.messages(accepts, start_ns=span.start_ns, end_ns=span.end_ns)


def _rename(
    messages: Iterable[StoredMessage], topics: dict[StoredTopic, StoredTopic]
) -> Iterator[StoredMessage]:
    return (
        (topics[topic], log_ns, publish_ns, payload)
        for topic, log_ns, publish_ns, payload in messages
    )


def _write_run(
    parts: RecordingParts[StoredTopic], messages: Iterator[StoredMessage], *, is_first: bool
) -> None:
    for message in messages:
        if not is_first:
            parts.start_part(*message[1:3])
            is_first = True
        parts.write(message)


def _list_metadata(readers: Iterable[RecordingReader]) -> Iterable[Metadata]:
    """List named texts; equal ones once."""
    return {
        (name, tuple(texts.items())): Metadata(name, texts)
        for reader in readers
        for name, texts in reader.metadata.items()
    }.values()


def _list_attachments(readers: Iterable[RecordingReader]) -> Iterator[AttachedFile]:
    """Read the attached files; equal ones once."""
    known = set()
    for attachment in (one for reader in readers for one in reader.read_attachments()):
        key = attachment.name, hashlib.sha256(attachment.content).digest()
        if key not in known:
            known.add(key)
            yield attachment
