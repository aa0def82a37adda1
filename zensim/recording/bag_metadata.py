"""`metadata.yaml` of a recording, as rosbag2 reads it."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import msgspec

CUSTOM_DATA: Final = "custom_data"
VERSION: Final = 5
"""The newest that Humble reads; newer distributions read it, too."""


class PartFacts(msgspec.Struct, frozen=True, kw_only=True):
    """What one file has."""

    file: str
    span_ns: tuple[int, int]
    """First and last log time [ns]."""
    topics: Mapping[tuple[str, str, str], int]
    """Number of messages, by name, type and QoS profiles."""
    bytes: int
    """Length of the file."""

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(self.topics.values())

    @property
    def duration_ns(self) -> int:
        """Log time from the first to the last message [ns]."""
        return self.span_ns[1] - self.span_ns[0]


def write_bag_metadata(
    parts: Sequence[PartFacts], custom_data: Iterable[tuple[str, str]] = ()
) -> str:
    """Write the metadata of the files of a recording, in their order.

    Args:
        parts: The files.
        custom_data: Names and texts of the user.
    """
    counts: dict[tuple[str, str, str], int] = {}
    for part in parts:
        for topic, count in part.topics.items():
            counts[topic] = counts.get(topic, 0) + count
    filled = [part for part in parts if part.messages] or list(parts)
    start_ns = min(part.span_ns[0] for part in filled)
    end_ns = max(part.span_ns[1] for part in filled)
    content = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(counts.values()),
        "topics_with_message_count": [
            _describe_topic(topic, count) for topic, count in sorted(counts.items())
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.file for part in parts],
        "files": [_describe_file(part) for part in parts],
        **({CUSTOM_DATA: dict(custom_data)} if custom_data else {}),
    }
    # JSON is YAML.
    return json.dumps({"rosbag2_bagfile_information": content}, indent=1) + "\n"


def _describe_topic(topic: tuple[str, str, str], count: int) -> dict[str, object]:
    name, ros_type, qos = topic
    metadata = {
        "name": name,
        "type": ros_type,
        "serialization_format": "cdr",
        "offered_qos_profiles": qos,
    }
    return {"topic_metadata": metadata, "message_count": count}


def _describe_file(part: PartFacts) -> dict[str, object]:
    start_ns, end_ns = part.span_ns
    return {
        "path": part.file,
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": end_ns - start_ns},
        "message_count": part.messages,
    }
