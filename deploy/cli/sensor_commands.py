"""`zensim sensors list`: the sensors of all robots, their topics, rates, subscribers and cost."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import msgspec
import typer
from rich.table import Table

from zensim.deploy.cli.command_session import open_client, print_json, print_table
from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.model_messages import Sensor
from zensim.proto.messages.sensing_messages import Environment, SensorFigures, SensorStats
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.network_protocols import Sample
from zensim.proto.options.command_options import ClientOptions, JsonOption
from zensim.proto.options.option_groups import expand_options, make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.sensor_libraries import find_advice
from zensim.proto.sensor_schedule import find_true_rate_hz
from zensim.proto.topic_catalog import SENSOR_STATS, TOPICS

app = make_app("sensors", has_default=True)

STATS_TIMEOUT_S = 1.0
MILLISECONDS = 1e3
UNKNOWN = "-"


class SensorRow(msgspec.Struct, frozen=True, kw_only=True):
    """A sensor as the command shows it; None = not known."""

    entity: str
    sensor: str
    kind: str
    topics: tuple[str, ...]
    """Keys; none if the sensor is not simulated."""
    messages: tuple[str, ...]
    """Types, one per topic."""
    rate_hz: float | None
    """Rate in simulation time."""
    process: str
    """The sensor process, else the agent; empty if there is none."""
    has_subscribers: bool | None = None
    published: int | None = None
    late: int | None = None
    cost_s: float | None = None
    frame_id: str = ""
    fault: str = ""
    """Why no process measures it, or slowly; begins with a slug."""


@app.callback(invoke_without_command=True)
@expand_options
def sensors(context: typer.Context, *, as_json: JsonOption = False, server: ClientOptions) -> None:
    """List sensors, or run a sensor process."""
    if context.invoked_subcommand is None:
        _show("sensors", server, as_json=as_json)


@app.command("list")
def list_sensors(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """List the sensors of all robots: topics, rates, subscribers, late measurements and cost."""
    _show("sensors list", server, as_json=as_json)


def _show(command: str, server: ClientOptions, *, as_json: bool) -> None:
    with open_client(command, server) as client:
        models = client.models()
        stats = fetch_sensor_stats(client.bus, server.world_name)
    rows = list_sensor_rows(models, stats)
    if as_json:
        print_json({"processes": [_summarize(one) for one in stats], "sensors": rows})
        return
    print_table(_make_table(rows))
    for one in stats:
        state = "active" if one.is_active else "idle"
        print_lines(
            f"{one.process}: {state}, {one.messages} messages, {one.late} late, "
            f"{one.cpu_s:.1f} s CPU"
        )
        for library, fault in one.missing.items():
            print_lines(f"{one.process}: no {library}: {fault}; {find_advice(library)}")
    for row in rows:
        if row.fault:
            print_lines(f"{row.entity} {row.sensor}: {row.fault}")
    if not stats and count_sensors_of_processes(models):
        print_lines("no sensor process; start one: 'zensim sensors run'")


def fetch_sensor_stats(bus: Bus, world: str) -> list[SensorStats]:
    """Fetch the statistics of all sensor processes, by name."""
    samples = bus.get(SENSOR_STATS.key(world, "*"), STATS_TIMEOUT_S)
    return sorted(_decode_stats(samples), key=lambda stats: stats.process)


def count_sensors_of_processes(models: GetModelsResponse) -> int:
    """Count the lidars and cameras of all entities, which sensor processes measure."""
    return sum(
        isinstance(sensor.settings, RaySensor | CameraSensor)
        for entity in models.entities
        for sensor in models.models[entity.model].sensors
    )


def list_sensor_rows(models: GetModelsResponse, stats: Sequence[SensorStats]) -> list[SensorRow]:
    """List the sensors of all entities, with the figures of sensor processes."""
    figures = {
        (of_sensor.entity, of_sensor.sensor, of_sensor.topic): (
            one.process if of_sensor.is_measured else "",
            of_sensor,
        )
        for one in stats
        for of_sensor in one.sensors
    }
    return [
        _make_row(entity, sensor, models.environment, figures)
        for entity in models.entities
        for sensor in models.models[entity.model].sensors
    ]


def _make_row(
    entity: EntityModel,
    sensor: Sensor,
    environment: Environment,
    figures: dict[tuple[str, str, str], tuple[str, SensorFigures]],
) -> SensorRow:
    owner = entity.namespace or entity.entity
    topics = tuple(keys.robot(owner, topic.name) for topic in sensor.topics)
    process, measured = figures.get((entity.entity, sensor.name, (*topics, "")[0]), ("", None))
    is_simulated = sensor.settings is not None and environment.step_ns > 0
    is_of_agent = not isinstance(sensor.settings, RaySensor | CameraSensor | None)
    return SensorRow(
        entity=entity.entity,
        sensor=sensor.name,
        kind=sensor.kind,
        topics=topics,
        messages=tuple(
            TOPICS[one.topic].messages[0].__name__ for one in sensor.topics if one.topic in TOPICS
        ),
        rate_hz=find_true_rate_hz(sensor.update_rate_hz, environment) if is_simulated else None,
        process=entity.agent if is_of_agent else process,
        has_subscribers=measured.has_subscribers if measured else None,
        published=measured.messages if measured else None,
        late=measured.late if measured else None,
        cost_s=measured.cost_s if measured and measured.messages else None,
        frame_id=sensor.frame_id,
        fault=measured.fault if measured else "",
    )


def _decode_stats(samples: Sequence[Sample]) -> Iterator[SensorStats]:
    for sample in samples:
        with suppress(MalformedPayload):
            yield decode(SensorStats, sample.payload, sample.encoding)


def _summarize(stats: SensorStats) -> dict[str, object]:
    return {
        "process": stats.process,
        "is_active": stats.is_active,
        "messages": stats.messages,
        "late": stats.late,
        "cpu_s": stats.cpu_s,
        "missing": stats.missing,
    }


def _make_table(rows: Sequence[SensorRow]) -> Table:
    table = Table("robot", "sensor", "type", "topic", "message", box=None)
    for title in ("rate [Hz]", "subscribed", "messages", "late", "cost [ms]"):
        table.add_column(title, justify="right")
    table.add_column("process")
    for row in rows:
        subscribed = UNKNOWN if row.has_subscribers is None else "yes"[: 3 * row.has_subscribers]
        table.add_row(
            row.entity,
            row.sensor,
            row.kind,
            "\n".join(row.topics) or "not simulated",
            "\n".join(row.messages),
            _format(row.rate_hz, "g"),
            subscribed or "no",
            _format(row.published, "d"),
            _format(row.late, "d"),
            _format(None if row.cost_s is None else row.cost_s * MILLISECONDS, ".2f"),
            row.process or UNKNOWN,
        )
    return table


def _format(value: float | None, style: str) -> str:
    return UNKNOWN if value is None else format(value, style)
