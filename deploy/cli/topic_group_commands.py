"""`zensim topic list`, `info`, `echo`, `hz`, `bw`, `delay` and `pub`, as of `ros2 topic`."""

import statistics
from dataclasses import dataclass
from typing import Annotated

import msgspec
import typer
import yaml
from rich.table import Table

from zensim.deploy.cli.command_session import complete_topics, open_client, print_json, print_table
from zensim.deploy.cli.driven_robots import wait_for_subscriber
from zensim.deploy.cli.topic_commands import (
    ROS_TYPES,
    MeasureOptions,
    Report,
    WindowOption,
    echo,
    hz,
    measure_topic,
    publish_at_rate,
)
from zensim.deploy.cli.topic_search import advise_topic, find_topics
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    encode,
    make_encoding,
    parse_schema_name,
)
from zensim.proto.codec.unknown_fields import describe_unknown_field
from zensim.proto.keys import last_chunk
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.network_protocols import Sample
from zensim.proto.options.command_options import (
    ClientOptions,
    ConnectionOptions,
    JsonOption,
    VerboseOption,
    flag,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.security.role_checks import require_access
from zensim.proto.security.roles import Operation
from zensim.proto.topic_catalog import CLOCK, ROBOT_TOPICS
from zensim.proto.topic_discovery import TopicEndpoint
from zensim.proto.verbosity import CURRENT, print_note
from zensim.spawner.client.topic_reader import read_topic

app = make_app("topic")
app.command("echo")(echo)
app.command("hz")(hz)

KILO = 1e3


TopicArgument = Annotated[
    str,
    typer.Argument(metavar="TOPIC", help="Name, such as r1/odom.", autocompletion=complete_topics),
]


class NoSuchTopic(BusError):
    """No program announces a topic."""

    code = ResultCode.NOT_FOUND


@app.command(
    "list",
    epilog="""Examples:
  zensim topic list
  zensim topic list odom --json""",
)
def list_command(
    part: Annotated[
        str, typer.Argument(metavar="PART", help="Only topics whose name contains this.")
    ] = "",
    *,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """List topics with their types and numbers of publishers and subscriptions."""
    with open_client("topic list", server) as client:
        topics = [one for one in find_topics(client) if part in one.key]
    if as_json:
        print_json(topics)
    elif CURRENT.is_quiet:
        print_lines("\n".join(one.key for one in topics))
    else:
        table = Table("topic", "type", box=None)
        for title in ("publishers", "subscriptions"):
            table.add_column(title, justify="right")
        for one in topics:
            counts = (str(len(one.publishers)), str(len(one.subscriptions)))
            table.add_row(one.key, one.ros_type, *counts)
        print_table(table)


@app.command("info")
def info_command(
    key: TopicArgument,
    *,
    verbose: VerboseOption = False,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Show type, publishers and subscriptions of a topic; with --verbose their nodes and QoS."""
    with open_client("topic info", server) as client:
        topics = find_topics(client)
        found = next((one for one in topics if one.key == key.strip("/")), None)
        if found is None:
            raise NoSuchTopic(f"there is no topic '{key}'; {advise_topic(key, topics)}")
    if as_json:
        print_json(found)
        return
    print_lines(f"Type: {found.ros_type}")
    for title, ends in (("Publisher", found.publishers), ("Subscription", found.subscriptions)):
        print_lines(f"{title} count: {len(ends)}")
        for one in ends if verbose else ():
            print_lines(_format_endpoint(one))


def _format_endpoint(one: TopicEndpoint) -> str:
    return f"  {one.node}: {one.ros_type}, {one.reliability}, {one.durability}, depth {one.depth}"


@dataclass(frozen=True, kw_only=True)
class BandwidthOptions(MeasureOptions):
    """All options of `zensim topic bw`, whose window is that of `ros2 topic bw`."""

    window: WindowOption = 100


@app.command(
    epilog="""Example:
  zensim topic bw r1/scan --duration 10"""
)
def bw(given: BandwidthOptions) -> None:
    """Measure the bandwidth of a topic, and print it every second."""
    arrivals: list[tuple[float, int]] = []

    def receive(now: float, samples: list[Sample]) -> None:
        arrivals.extend((now, len(sample.payload)) for sample in samples)
        del arrivals[: -given.window]

    with open_client("topic bw", given) as client:
        measure_topic(client, "topic bw", given, receive, lambda: _measure_bandwidth(arrivals))


def _measure_bandwidth(arrivals: list[tuple[float, int]]) -> Report | None:
    if len(arrivals) < 2:  # noqa: PLR2004  a rate needs two arrivals
        return None
    sizes = [size for _, size in arrivals]
    span_s = max(arrivals[-1][0] - arrivals[0][0], 1e-9)
    figures = {
        "bytes_per_s": sum(sizes[1:]) / span_s,
        "mean_bytes": statistics.fmean(sizes),
        "min_bytes": min(sizes),
        "max_bytes": max(sizes),
        "window": len(sizes),
    }
    return figures, (
        f"{figures['bytes_per_s'] / KILO:.2f} kB/s from {len(sizes)} messages; message size: mean "
        f"{figures['mean_bytes']:.0f} B, min {min(sizes)} B, max {max(sizes)} B"
    )


@app.command(
    epilog="""Example:
  zensim topic delay r1/odom --duration 10"""
)
def delay(given: MeasureOptions) -> None:
    """Measure how old the stamps of a topic are on arrival, in simulation time.

    The time of arrival is that of the newest message of the clock, which comes every 0.01 s.
    """
    delays: list[float] = []
    now_ns: list[int] = []
    with open_client("topic delay", given) as client:
        clock = read_topic(client.bus, CLOCK.key(given.world_name), WorldClock)

        def receive(_: float, samples: list[Sample]) -> None:
            if (newest := clock.newest()) is not None:
                now_ns[:] = [ns_from_time(newest.clock)]
            stamps = [read_stamp_ns(sample) for sample in samples]
            delays.extend((now_ns[0] - stamp) / NANOSECONDS for stamp in stamps if now_ns)
            del delays[: -given.window]

        measure_topic(client, "topic delay", given, receive, lambda: _measure_delays(delays))


def read_stamp_ns(sample: Sample) -> int:
    """Read the stamp of a message with a header [ns].

    Raises:
        MalformedPayload: Its type is unknown, or it has no header.
    """
    kind = ROS_TYPES.get(parse_schema_name(sample.encoding))
    message = None if kind is None else decode(kind, sample.payload, sample.encoding)
    header = getattr(message, "header", None)
    if header is None:
        raise MalformedPayload(f"the messages of {sample.key} have no header, so no stamp")
    return ns_from_time(header.stamp)


def _measure_delays(delays: list[float]) -> Report | None:
    if not delays:
        return None
    figures = {
        "mean_s": statistics.fmean(delays),
        "min_s": min(delays),
        "max_s": max(delays),
        "std_s": statistics.pstdev(delays),
        "window": len(delays),
    }
    line = (
        "average delay: {mean_s:.3f}  min: {min_s:.3f}s  max: {max_s:.3f}s  "
        "std dev: {std_s:.5f}s  window: {window}"
    )
    return figures, line.format(**figures)


@app.command(
    epilog="""Examples:
  zensim topic pub --once r1/cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.2}}'
  zensim topic pub -r 10 r1/cmd_vel '{linear: {x: 0.2}}'"""
)
def pub(
    key: TopicArgument,
    message_type: Annotated[
        str,
        typer.Argument(
            metavar="TYPE",
            help="Type, as geometry_msgs/msg/Twist; by default that of the topic of a robot.",
        ),
    ] = "",
    values: Annotated[
        str, typer.Argument(metavar="VALUES", help="Fields as YAML; those left out are 0.")
    ] = "",
    *,
    rate: Annotated[
        float, typer.Option("--rate", "-r", metavar="HZ", help=r"Message rate \[Hz].")
    ] = 1.0,
    once: Annotated[bool, flag("--once", "-1", help="Publish one message and exit.")] = False,
    times: Annotated[
        int,
        typer.Option("--times", "-t", min=0, metavar="N", help="Exit after N messages; 0 = never."),
    ] = 0,
    as_json: JsonOption = False,
    server: ConnectionOptions,
) -> None:
    """Publish messages on a topic, once or at a rate."""
    with open_client("topic pub", server) as client:
        if "*" in key:
            raise ValueError(f"'{key}' is of many topics; publish on one, such as r1/cmd_vel")
        message = make_message(name := key.strip("/"), message_type, values)
        if not rate > 0:
            raise ValueError(f"--rate must be positive, got {rate:g}")
        require_access(client.bus, client.world, Operation.PUBLISH, name)
        publisher = client.bus.advertise(name, make_encoding(message, Format.CDR))
        if not wait_for_subscriber(publisher):
            print_note("topic pub", f"nothing subscribes to {name}")
        count = 1 if once else times
        publish_at_rate(publisher, encode(message, Format.CDR), 1.0 / rate, count)
        _settle(client.bus)
        if as_json:
            print_json({"key": name, "published": count})


def _settle(bus: Bus) -> None:
    """Leave the session time to send what it has queued: a reply means it is through."""
    bus.list_tokens("sim/*/alive/server", 0.2)


def make_message(key: str, message_type: str, values: str) -> msgspec.Struct:
    """Make a message from its type and YAML.

    Raises:
        ValueError: The type is unknown, or the fields are not those of the type.
    """
    kind = ROS_TYPES.get(message_type)
    if kind is None and not values and message_type.lstrip()[:1] in ("", "{"):
        topic = ROBOT_TOPICS.get(last_chunk(key))
        kind, values = (topic.messages[0] if topic else None), message_type
    if kind is None:
        raise ValueError(
            f"type {message_type[:80]!r} is unknown; use one as geometry_msgs/msg/Twist"
        )
    try:
        fields = yaml.safe_load(values or "{}")
        message = msgspec.convert(fields, kind, strict=False)
    except (yaml.YAMLError, msgspec.ValidationError) as error:
        raise ValueError(f"{values[:80]!r} is no {kind.__name__}: {error}") from error
    if unknown := describe_unknown_field(kind, fields):
        raise ValueError(f"{values[:80]!r} is no {kind.__name__}: {unknown}")
    return message
