"""`zensim drive`, `echo` and `hz`, and any payload decoded to plain values."""

import math
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import msgspec
import numpy as np
import typer

from zensim.deploy.cli.command_session import (
    complete_robots,
    complete_topics,
    open_client,
    print_json,
)
from zensim.deploy.cli.driven_robots import await_driver
from zensim.deploy.cli.topic_search import ABSENCE_TIMEOUT_S, note_absence
from zensim.proto.bus.bus_session import Bus, BusPublisher
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    detect_format,
    encode,
    parse_schema_name,
)
from zensim.proto.keys import last_chunk
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.network_protocols import Sample
from zensim.proto.options.command_options import ConnectionOptions, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.schema import list_messages
from zensim.proto.security.role_checks import require_access
from zensim.proto.security.roles import Operation
from zensim.proto.topic_catalog import CMD_VEL, TOPICS, TopicScope
from zensim.proto.verbosity import print_announcement, print_note
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.client.topic_reader import TopicReader, keep_raw

ROS_TYPES = {kind.ros_type: kind for kind in list_messages().values() if hasattr(kind, "ros_type")}
ZENSIM_TYPES = {
    topic.suffix: topic.messages[0]
    for topic in TOPICS.values()
    if topic.scope is not TopicScope.ROBOT
}
GETTABLE_NAMES = {
    topic.suffix
    for topic in TOPICS.values()
    if topic.scope is not TopicScope.ROBOT and topic.is_gettable
}
"""Names of topics that can be queried; services have other names."""
ARRAY_TYPES = dict.fromkeys(
    ("base", "joint_positions", "joint_velocities", "joint_efforts", "targets", "motions"), "<f8"
)
CLAIM_TYPE = "<u4"
MAX_NESTING = 64
_NOT_FINITE = {"inf": ".Inf", "-inf": "-.Inf", "nan": ".nan"}
app = make_app()
POLL_S = 0.002
QUEUE_DEPTH = 65536
KeyArgument = Annotated[
    str,
    typer.Argument(
        metavar="KEY",
        help="Key expression, such as r1/odom or '*/odom'.",
        autocompletion=complete_topics,
    ),
]
DurationOption = Annotated[
    float,
    typer.Option(
        "--duration", min=0.0, metavar="SECONDS", help=r"Duration \[s]; 0 = until Ctrl-C."
    ),
]
WindowOption = Annotated[
    int, typer.Option("--window", min=2, metavar="N", help="Average over the last N messages.")
]


def to_plain(sample: Sample) -> object:
    """Decode a payload to dicts, lists and numbers, or to a text if it is malformed."""
    try:
        return _decode_sample(sample)
    except (ValueError, RecursionError) as error:
        return f"{len(sample.payload)} bytes, not decoded: {error}"


def _decode_sample(sample: Sample) -> object:
    kind = ROS_TYPES.get(parse_schema_name(sample.encoding))
    if sample.key.startswith("sim/"):
        kind = ZENSIM_TYPES.get(last_chunk(sample.key))
    if kind is not None:
        message = decode(kind, sample.payload, sample.encoding)
        return {
            name: _decode_field(name, getattr(message, name)) for name in message.__struct_fields__
        }
    if detect_format(sample.payload, sample.encoding) is Format.JSON:
        return _to_json_types(msgspec.json.decode(sample.payload))
    if detect_format(sample.payload, sample.encoding) is Format.MSGPACK:
        return _to_json_types(msgspec.msgpack.decode(sample.payload))
    raise MalformedPayload(f"CDR of an unknown type; the encoding is {sample.encoding[:80]!r}")


def _to_json_types(value: object, depth: int = 0) -> object:
    """Replace the types of MessagePack that JSON lacks."""
    if depth > MAX_NESTING:
        raise MalformedPayload(f"values are nested more than {MAX_NESTING} deep")
    if isinstance(value, dict):
        return {str(key): _to_json_types(inner, depth + 1) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_json_types(inner, depth + 1) for inner in value]
    if isinstance(value, msgspec.msgpack.Ext):
        return {"extension": value.code, "data": list(bytes(value.data))}
    return list(value) if isinstance(value, bytes) else value


def _decode_field(name: str, value: object) -> object:
    if isinstance(value, bytes):
        kind = CLAIM_TYPE if name == "claims" else ARRAY_TYPES.get(name, "u1")
        return np.frombuffer(value, dtype=kind).tolist()
    return msgspec.to_builtins(value)


def to_yaml_lines(plain: object, indent: str = "") -> Iterator[str]:
    """Format plain values as YAML, like `ros2 topic echo`."""
    if isinstance(plain, dict):
        for key, value in plain.items():
            yield from _yaml_entry(f"{indent}{key}:", value, indent + "  ")
    elif isinstance(plain, (list, tuple)):
        for value in plain:
            yield from _yaml_entry(f"{indent}-", value, indent + "  ")
    else:
        yield indent + _yaml_scalar(plain)


def _yaml_entry(head: str, value: object, indent: str) -> Iterator[str]:
    if isinstance(value, (dict, list, tuple)) and not value:
        yield f"{head} {'{}' if isinstance(value, dict) else '[]'}"
    elif isinstance(value, (list, tuple)) and all(isinstance(v, (int, float)) for v in value):
        yield f"{head} [{', '.join(_yaml_scalar(v) for v in value)}]"
    elif isinstance(value, (dict, list, tuple)):
        yield head
        yield from to_yaml_lines(value, indent)
    else:
        yield f"{head} {_yaml_scalar(value)}"


def _yaml_scalar(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else _NOT_FINITE[str(value)]
    if isinstance(value, str):
        return msgspec.json.encode(value).decode()
    if isinstance(value, bool) or value is None:
        return str(value).lower().replace("none", "null")
    return str(value)


@dataclass(frozen=True, kw_only=True)
class MeasureOptions(ConnectionOptions):
    """All options of a command that measures a topic."""

    key: KeyArgument
    window: WindowOption = 1000
    duration: DurationOption = 0.0
    as_json: JsonOption = False


@app.command(
    context_settings={"ignore_unknown_options": True},
    epilog="""Examples:
  zensim drive r1 0.2 0.5
  zensim drive r1 0.2 --duration 3""",
)
def drive(
    robot: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT", help="Namespace of the robot.", autocompletion=complete_robots
        ),
    ],
    linear: Annotated[float, typer.Argument(metavar="LINEAR", help=r"Forward velocity \[m/s].")],
    angular: Annotated[
        float, typer.Argument(metavar="ANGULAR", help=r"Yaw rate, positive to the left \[rad/s].")
    ] = 0.0,
    *,
    rate: Annotated[float, typer.Option(metavar="HZ", help=r"Message rate \[Hz].")] = 10.0,
    duration: DurationOption = 0.0,
    once: Annotated[
        bool, flag("--once", help="Publish one message and exit without a stop command.")
    ] = False,
    as_json: JsonOption = False,
    server: ConnectionOptions,
) -> None:
    """Publish velocity commands to a robot, and a stop command at the end."""
    with open_client("drive", server) as client:
        twist = _make_twist(linear, angular)
        if not rate > 0:
            raise ValueError(f"--rate must be positive, got {rate:g}")
        key = CMD_VEL.key(robot.strip("/"))
        require_access(client.bus, client.world, Operation.PUBLISH, key)
        publisher = client.bus.advertise(key, CMD_VEL.encoding)
        await_driver(client, publisher, robot.strip("/"))
        text = f"{key} at {linear:g} m/s, {angular:g} rad/s"
        facts = {"key": key, "linear": linear, "angular": angular}
        print_announcement("drive", text, facts, as_json=as_json)
        count = 1 if once else math.ceil(duration * rate) if duration > 0 else 0
        end_s = time.monotonic() + duration
        try:
            publish_at_rate(publisher, encode(twist, Format.CDR), 1.0 / rate, count)
            time.sleep(0.0 if once else max(0.0, end_s - time.monotonic()))
        finally:
            if not once:
                publisher.send(encode(Twist(), Format.CDR))


def _make_twist(linear: float, angular: float) -> Twist:
    if not (math.isfinite(linear) and math.isfinite(angular)):
        raise ValueError(f"velocities must be finite, got {linear:g} m/s, {angular:g} rad/s")
    return Twist(Vector3(x=linear), Vector3(z=angular))


def publish_at_rate(publisher: BusPublisher, payload: bytes, period_s: float, count: int) -> None:
    """Publish at a fixed rate; count 0 = forever."""
    start, sent = time.monotonic(), 0
    while True:
        publisher.send(payload)
        sent += 1
        if sent == count:
            return
        time.sleep(max(0.0, start + sent * period_s - time.monotonic()))


@app.command(
    epilog="""Examples:
  zensim echo r1/odom --once
  zensim echo '*/odom' --json --timeout 5"""
)
def echo(
    key: KeyArgument,
    *,
    count: Annotated[
        int,
        typer.Option(
            *("--count", "-n"),
            min=0,
            metavar="N",
            help="Exit after N messages; 0 = print until Ctrl-C.",
        ),
    ] = 0,
    once: Annotated[bool, flag("--once", help="Same as --count 1.")] = False,
    timeout: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", help=r"Fail after this time without a message \[s]; 0 = never."
        ),
    ] = 0.0,
    as_json: JsonOption = False,
    server: ConnectionOptions,
) -> None:
    """Print the messages of a topic, latched ones first."""
    with open_client("echo", server) as client:
        limit = 1 if once else count
        bare, printed = key.strip("/"), 0
        require_access(client.bus, client.world, Operation.SUBSCRIBE, bare)
        subscription = client.bus.subscribe_copying(bare, QUEUE_DEPTH)
        # tf_static and robot_description are published once, before this command started.
        reader = TopicReader(subscription, keep_raw, first=get_last_messages(client.bus, bare))
        for samples in _receive(client, "echo", bare, reader):
            for sample in samples:
                _print_sample(sample, as_json=as_json)
                printed += 1
                if printed == limit:
                    return
            if reader.is_silent(timeout or math.inf):
                raise TimeoutError(f"no message on {bare} within {timeout:g} s")


def get_last_messages(bus: Bus, key: str) -> list[Sample]:
    """Get the last message of each topic; a key expression never calls the services it covers."""
    is_pattern = "*" in key
    if key.startswith("**"):
        # It covers the services of ROS 2, too.
        return [one for name in sorted(GETTABLE_NAMES) for one in bus.get(f"sim/*/{name}")]
    if key.startswith("sim/") and not is_pattern and last_chunk(key) not in GETTABLE_NAMES:
        return []
    return [
        one
        for one in bus.get(key)
        if not one.key.startswith("sim/") or last_chunk(one.key) in GETTABLE_NAMES
    ]


def _receive(
    client: SimClient, command: str, key: str, reader: TopicReader[Sample]
) -> Iterator[list[Sample]]:
    """Take messages again and again; note once that there is no such topic."""
    is_looked_up = False
    while True:
        yield reader.take()
        if not is_looked_up and reader.last is None and reader.is_silent(ABSENCE_TIMEOUT_S):
            is_looked_up = True
            note_absence(client, command, key)
        time.sleep(POLL_S)


def _print_sample(sample: Sample, *, as_json: bool) -> None:
    plain = to_plain(sample)
    if as_json:
        print_json({"key": sample.key, "message": plain})
        return
    print_lines(f"# {sample.key}")
    for line in to_yaml_lines(plain):
        print_lines(line)
    print_lines("---")


@app.command(
    epilog="""Example:
  zensim hz r1/odom --duration 10"""
)
def hz(given: MeasureOptions) -> None:
    """Measure the message rate of a topic, and print it every second."""
    arrivals: list[float] = []

    def receive(now: float, samples: list[Sample]) -> None:
        arrivals.extend(now for _ in samples)
        del arrivals[: -given.window]

    with open_client("hz", given) as client:
        measure_topic(client, "hz", given, receive, lambda: _measure_rate(arrivals))


Report = tuple[Mapping[str, float], str]
"""Figures, and a line with them."""


def measure_topic(
    client: SimClient,
    command: str,
    given: MeasureOptions,
    receive: Callable[[float, list[Sample]], None],
    measure: Callable[[], Report | None],
) -> None:
    """Receive the messages of the topic of the options, and print figures every second.

    Args:
        client: Of the world of the topic.
        command: Name of the command, for notes.
        given: Which topic, and for how long.
        receive: Called with the monotonic time [s] and the new messages.
        measure: Makes the figures after a second with messages; None if those are too few.
    """
    key = given.key.strip("/")
    require_access(client.bus, client.world, Operation.SUBSCRIBE, key)
    reader = TopicReader(client.bus.subscribe_copying(key, QUEUE_DEPTH), keep_raw)
    end = time.monotonic() + (given.duration or math.inf)
    report_at, has_new = min(time.monotonic() + 1.0, end), False
    for samples in _receive(client, command, key, reader):
        now = time.monotonic()
        if now > end and report_at > end:
            return
        receive(now, samples)
        has_new |= bool(samples)
        if now >= report_at:
            report_at = now + 1.0
            _print_report(command, measure() if has_new else None, as_json=given.as_json)
            has_new = False


def _print_report(command: str, report: Report | None, *, as_json: bool) -> None:
    if report is None:
        print_note(command, "no new messages")
    elif as_json:
        print_json(report[0])
    else:
        print_lines(report[1])


def _measure_rate(arrivals: list[float]) -> Report | None:
    if len(arrivals) < 2:  # noqa: PLR2004  a rate needs two arrivals
        return None
    gaps = [later - earlier for earlier, later in pairwise(arrivals)]
    span_s = max(arrivals[-1] - arrivals[0], 1e-9)
    figures = {
        "rate_hz": len(gaps) / span_s,
        "min_s": min(gaps),
        "max_s": max(gaps),
        "std_s": statistics.pstdev(gaps),
        "window": len(arrivals),
    }
    line = (
        "average rate: {rate_hz:.3f}  min: {min_s:.4f}s  max: {max_s:.4f}s  "
        "std dev: {std_s:.5f}s  window: {window}"
    )
    return figures, line.format(**figures)
