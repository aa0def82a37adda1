"""Contents of a recording: times, topics, counts, files; also of one that was never closed."""

from pathlib import Path

import msgspec

from zensim.recording.file_index import FileIndex, list_files, read_index


class BagTopic(msgspec.Struct, frozen=True):
    """A topic of a recording."""

    name: str
    ros_type: str
    messages: int


class BagInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of a file, or of all files of a recording."""

    files: tuple[str, ...]
    size: int
    """Bytes."""
    messages: int
    start_ns: int
    """First log time: simulation time, unless it was recorded otherwise."""
    end_ns: int
    chunks: int
    compressions: tuple[str, ...]
    topics: tuple[BagTopic, ...]
    attachments: tuple[str, ...]
    unclosed: tuple[str, ...]
    """Files that were read in whole, since they have no summary."""
    damaged: int = 0
    """Number of places where bytes were skipped."""

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message [s]."""
        return (self.end_ns - self.start_ns) / 1e9


def read_info(path: Path) -> BagInfo:
    """Read the contents of a file, or of the files in a folder.

    Raises:
        OSError: A file cannot be read, or there is none.
        ValueError: A file is not an MCAP file.
    """
    files = list_files(path)
    indexes = [read_index(file) for file in files]
    places = [place for one in indexes for place in one.chunks]
    times = [one.times for one in indexes if one.times is not None]
    return BagInfo(
        files=tuple(map(str, files)),
        size=sum(file.stat().st_size for file in files),
        messages=sum(sum(one.counts.values()) for one in indexes),
        start_ns=min((start for start, _ in times), default=0),
        end_ns=max((end for _, end in times), default=0),
        chunks=sum(not one.is_loose for one in places),
        compressions=tuple(sorted({one.compression for one in places if not one.is_loose})),
        topics=_merge_topics(indexes),
        attachments=tuple(sorted({file.name for one in indexes for file in one.attachments})),
        unclosed=tuple(
            str(file) for file, one in zip(files, indexes, strict=True) if not one.is_closed
        ),
        damaged=sum(one.damaged for one in indexes),
    )


def _merge_topics(indexes: list[FileIndex]) -> tuple[BagTopic, ...]:
    merged: dict[tuple[str, str], int] = {}
    for one in indexes:
        for number, channel in one.channels.items():
            schema = one.schemas.get(channel.schema)
            key = channel.topic, schema.name if schema is not None else ""
            merged[key] = merged.get(key, 0) + one.counts.get(number, 0)
    return tuple(BagTopic(*key, count) for key, count in sorted(merged.items()))
