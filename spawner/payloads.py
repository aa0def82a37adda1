"""Any payload on the network as plain values that a person or a program can read."""

import math
from collections.abc import Iterator

import msgspec
import numpy as np

from zensim.proto.bus import Sample
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    detect_format,
    parse_schema_name,
)
from zensim.proto.keys import last_chunk
from zensim.proto.messages import agent_messages, standard_messages, telemetry_messages

TOPIC_TYPES: dict[str, type[msgspec.Struct]] = {
    kind.ros_type: kind
    for kind in (
        standard_messages.Odometry,
        standard_messages.TFMessage,
        standard_messages.JointState,
        standard_messages.String,
        standard_messages.Clock,
        standard_messages.Twist,
        standard_messages.TwistStamped,
        standard_messages.PoseStamped,
    )
}
TELEMETRY_TYPES: dict[str, type[msgspec.Struct]] = {
    "clock": telemetry_messages.WorldClock,
    "stats": telemetry_messages.Stats,
    "snapshot": telemetry_messages.Snapshot,
    "events": telemetry_messages.Event,
    "state": agent_messages.DriveState,
    "command": agent_messages.DriveCommand,
}
ARRAYS = {"base": "<f8", "joint_positions": "<f8", "joint_velocities": "<f8", "targets": "<f8"}
CLAIMS = "<u4"
MAX_DEPTH = 64


def as_plain(sample: Sample) -> object:
    """Read a payload into dicts, lists and numbers; what cannot be read is said in words."""
    try:
        return _plain(sample)
    except (ValueError, RecursionError) as error:
        return f"{len(sample.payload)} bytes that cannot be read: {error}"


def _plain(sample: Sample) -> object:
    kind = TOPIC_TYPES.get(parse_schema_name(sample.encoding))
    if sample.key.startswith("sim/"):
        kind = TELEMETRY_TYPES.get(last_chunk(sample.key))
    if kind is not None:
        message = decode(kind, sample.payload, sample.encoding)
        return {name: _value(name, getattr(message, name)) for name in message.__struct_fields__}
    if detect_format(sample.payload, sample.encoding) is Format.JSON:
        return _readable(msgspec.json.decode(sample.payload))
    if detect_format(sample.payload, sample.encoding) is Format.MSGPACK:
        return _readable(msgspec.msgpack.decode(sample.payload))
    raise MalformedPayload(f"CDR of unknown type; the Encoding is {sample.encoding[:80]!r}")


def _readable(value: object, depth: int = 0) -> object:
    """Turn what MessagePack knows and JSON does not into what both do."""
    if depth > MAX_DEPTH:
        raise MalformedPayload(f"values are nested more than {MAX_DEPTH} deep")
    if isinstance(value, dict):
        return {str(key): _readable(inner, depth + 1) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_readable(inner, depth + 1) for inner in value]
    if isinstance(value, msgspec.msgpack.Ext):
        return {"extension": value.code, "data": list(bytes(value.data))}
    return list(value) if isinstance(value, bytes) else value


def _value(name: str, value: object) -> object:
    if isinstance(value, bytes):
        kind = CLAIMS if name == "claims" else ARRAYS.get(name, "u1")
        return np.frombuffer(value, dtype=kind).tolist()
    return msgspec.to_builtins(value)


_NOT_FINITE = {"inf": ".Inf", "-inf": "-.Inf", "nan": ".nan"}


def as_lines(plain: object, indent: str = "") -> Iterator[str]:
    """Lay plain values out as YAML, as `ros2 topic echo` does."""
    if isinstance(plain, dict):
        for key, value in plain.items():
            yield from _entry(f"{indent}{key}:", value, indent + "  ")
    elif isinstance(plain, (list, tuple)):
        for value in plain:
            yield from _entry(f"{indent}-", value, indent + "  ")
    else:
        yield indent + _scalar(plain)


def _entry(head: str, value: object, indent: str) -> Iterator[str]:
    if isinstance(value, (dict, list, tuple)) and not value:
        yield f"{head} {'{}' if isinstance(value, dict) else '[]'}"
    elif isinstance(value, (list, tuple)) and all(isinstance(v, (int, float)) for v in value):
        yield f"{head} [{', '.join(_scalar(v) for v in value)}]"
    elif isinstance(value, (dict, list, tuple)):
        yield head
        yield from as_lines(value, indent)
    else:
        yield f"{head} {_scalar(value)}"


def _scalar(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else _NOT_FINITE[str(value)]
    if isinstance(value, str):
        return msgspec.json.encode(value).decode()
    if isinstance(value, bool) or value is None:
        return str(value).lower().replace("none", "null")
    return str(value)
