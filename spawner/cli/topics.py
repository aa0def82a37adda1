"""`zensim drive`, `echo`, `hz`."""

import math
import statistics
import time
from itertools import pairwise
from typing import Annotated

import msgspec
import typer

from zensim.proto import keys
from zensim.proto.bus import BusError, Publisher, Sample, Subscription
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.spawner.cli.session import AsJson, Connect, WorldName, client_for
from zensim.spawner.payloads import as_lines, as_plain

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

POLL_S = 0.002
QUEUE_DEPTH = 65536
LISTENER_WAIT_S = 3.0


class NobodyListens(BusError):
    """A command would reach nobody."""


@app.command(context_settings={"ignore_unknown_options": True})
def drive(
    robot: Annotated[str, typer.Argument(help="Namespace of the robot.")],
    linear: Annotated[float, typer.Argument(help="Forward [m/s].")],
    angular: Annotated[float, typer.Argument(help="Turn left [rad/s].")] = 0.0,
    *,
    rate: Annotated[float, typer.Option(help="Messages a second.")] = 10.0,
    duration: Annotated[float, typer.Option(help="Seconds; 0 = until Ctrl-C.")] = 0.0,
    once: Annotated[bool, typer.Option("--once", help="Send one message and leave.")] = False,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Send a robot velocity commands; Ctrl-C stops it."""
    with client_for("drive", connect, world_name) as client:
        twist = _twist(linear, angular)
        if not rate > 0:
            raise ValueError(f"--rate {rate:g} is no rate; use more than 0")
        key = keys.robot(robot.strip("/"), keys.CMD_VEL)
        publisher = client.bus.advertise(key, make_encoding(Twist, Format.CDR))
        _wait_for_listener(publisher, key)
        typer.echo(f"zensim drive: {key} at {linear:g} m/s, {angular:g} rad/s", err=True)
        count = 1 if once else math.ceil(duration * rate) if duration > 0 else 0
        try:
            _repeat(publisher, encode(twist, Format.CDR), 1.0 / rate, count)
        finally:
            if not once:
                publisher.send(encode(Twist(), Format.CDR))


def _twist(linear: float, angular: float) -> Twist:
    if not (math.isfinite(linear) and math.isfinite(angular)):
        raise ValueError(f"{linear:g} m/s, {angular:g} rad/s cannot be driven; use finite numbers")
    return Twist(Vector3(x=linear), Vector3(z=angular))


def _wait_for_listener(publisher: Publisher, key: str) -> None:
    deadline = time.monotonic() + LISTENER_WAIT_S
    while not publisher.is_matched:
        if time.monotonic() > deadline:
            robot = key.rsplit("/", 1)[0]
            raise NobodyListens(f"nobody listens on {key}; start its agent: 'zensim agent {robot}'")
        time.sleep(POLL_S)


def _repeat(publisher: Publisher, payload: bytes, period_s: float, count: int) -> None:
    """Send at a steady rate; count 0 = for ever."""
    start, sent = time.monotonic(), 0
    while count == 0 or sent < count:
        publisher.send(payload)
        sent += 1
        time.sleep(max(0.0, start + sent * period_s - time.monotonic()))


@app.command()
def echo(
    key: Annotated[str, typer.Argument(help="Key expression, such as r1/odom or '*/odom'.")],
    *,
    count: Annotated[int, typer.Option("--count", "-n", help="Messages; 0 = for ever.")] = 0,
    once: Annotated[bool, typer.Option("--once", help="The same as --count 1.")] = False,
    timeout: Annotated[
        float, typer.Option(help="Give up when nothing comes for so many seconds; 0 = never.")
    ] = 0.0,
    as_json: AsJson = False,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Print what is published on a key."""
    with client_for("echo", connect, world_name) as client:
        wanted = 1 if once else count
        listener = client.bus.subscribe(key.strip("/"), QUEUE_DEPTH)
        # Last values first: tf_static and robot_description are put once, long before we came.
        samples = client.bus.get(key.strip("/"))
        shown = 0
        while True:
            for sample in samples:
                _show(sample, as_json=as_json)
                shown += 1
                if shown == wanted:
                    return
            samples = _next(listener, key, timeout)


def _next(listener: Subscription, key: str, timeout_s: float) -> list[Sample]:
    deadline = time.monotonic() + (timeout_s or math.inf)
    while not (samples := listener.take()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"nothing came on {key} within {timeout_s:g} s")
        time.sleep(POLL_S)
    return samples


def _show(sample: Sample, *, as_json: bool) -> None:
    plain = as_plain(sample)
    if as_json:
        line = msgspec.json.encode({"key": sample.key, "message": plain}).decode()
        typer.echo(line)
        return
    typer.echo(f"# {sample.key}")
    for line in as_lines(plain):
        typer.echo(line)
    typer.echo("---")


@app.command()
def hz(
    key: Annotated[str, typer.Argument(help="Key expression, such as r1/odom or '*/odom'.")],
    *,
    window: Annotated[int, typer.Option(min=2, help="Messages to average over.")] = 1000,
    duration: Annotated[float, typer.Option(help="Seconds; 0 = until Ctrl-C.")] = 0.0,
    as_json: AsJson = False,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Measure how often something is published on a key."""
    with client_for("hz", connect, world_name) as client:
        listener = client.bus.subscribe(key.strip("/"), QUEUE_DEPTH)
        end = time.monotonic() + (duration or math.inf)
        arrivals: list[float] = []
        report_at = min(time.monotonic() + 1.0, end)
        while (now := time.monotonic()) <= end or report_at <= end:
            arrivals.extend(now for _ in listener.take())
            del arrivals[:-window]
            if now >= report_at:
                report_at = now + 1.0
                _report_rate(arrivals, as_json=as_json)
            time.sleep(POLL_S)


def _report_rate(arrivals: list[float], *, as_json: bool) -> None:
    if len(arrivals) < 2:  # noqa: PLR2004  a rate needs two
        typer.echo("zensim hz: no new messages", err=True)
        return
    gaps = [later - earlier for earlier, later in pairwise(arrivals)]
    span_s = max(arrivals[-1] - arrivals[0], 1e-9)
    figures = {
        "rate_hz": len(gaps) / span_s,
        "min_s": min(gaps),
        "max_s": max(gaps),
        "std_s": statistics.pstdev(gaps),
        "window": len(arrivals),
    }
    if as_json:
        typer.echo(msgspec.json.encode(figures).decode())
        return
    typer.echo(
        "average rate: {rate_hz:.3f}  min: {min_s:.4f}s  max: {max_s:.4f}s  "
        "std dev: {std_s:.5f}s  window: {window}".format(**figures)
    )
