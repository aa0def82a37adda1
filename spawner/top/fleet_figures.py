"""Rows of `zensim top` from what programs report: no network, no clock."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, TypeVar

import msgspec
import numpy as np

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.process_messages import AgentStats, ProcessUsage
from zensim.proto.messages.sensing_messages import SensorStats
from zensim.proto.messages.telemetry_messages import (
    AgentCommands,
    GetModelsResponse,
    Snapshot,
    Stats,
)
from zensim.proto.messages.vehicle_messages import VehicleStatus
from zensim.spawner.top.local_processes import LocalProcess

MIB: Final = 1 << 20
NO_MODELS: Final = GetModelsResponse()


class FleetReading(msgspec.Struct, frozen=True, kw_only=True):
    """The last reports of all programs of a world."""

    stats: Stats | None = None
    """Stats of the server; None if none has reported."""
    agents: Mapping[str, AgentStats] = {}
    sensors: Mapping[str, SensorStats] = {}
    children: tuple[LocalProcess, ...] = ()
    """Child processes of these programs, on this host."""
    read_s: float = 0.0
    """Wall time at which `children` were read, from any origin."""
    snapshot: Snapshot | None = None
    models: GetModelsResponse = NO_MODELS
    odom_hz: Mapping[str, float] = {}
    """Measured rates by namespace [Hz, wall time]; others were not measured."""
    vehicles: Mapping[str, VehicleStatus] = {}
    """Vehicles of a fleet manager by entity."""
    is_stale: bool = False
    """Whether the server has not reported for some time."""


class ProcessRow(msgspec.Struct, frozen=True):
    """One process."""

    kind: str
    """`server`, `agent`, `sensors`, or `child` of one of them."""
    name: str
    host: str
    process_id: int
    cpu: float | None
    """Share of a core since the reading before; None = unknown."""
    memory_mib: float | None
    robots: int | None
    rate_hz: float | None
    """Drive states that an agent answers, steps of a server, messages of sensors [Hz, wall]."""
    due_hz: float | None = None
    """Drive states that the server sent an agent [Hz, wall]."""


class RobotRow(msgspec.Struct, frozen=True):
    """One robot."""

    name: str
    """Namespace."""
    model: str
    drive: str
    agent: str
    x: float | None
    y: float | None
    speed: float | None
    """[m/s]."""
    odom_hz: float | None
    """Measured rate of odometry [Hz, wall time]; None = not measured."""
    order: str | None = None
    """What it does as a vehicle of a fleet manager; None = it is none."""


Row = TypeVar("Row", ProcessRow, RobotRow)


def list_process_rows(now: FleetReading, before: FleetReading | None) -> list[ProcessRow]:
    """List the processes of a world; shares and rates need a reading before."""
    earlier = before or FleetReading()
    rows = []
    if now.stats is not None:
        rows.append(_make_server_row(now.stats, earlier.stats))
    due = now.stats.agent_commands if now.stats is not None else {}
    rows += [
        _make_agent_row(one, earlier.agents.get(name), due.get(name))
        for name, one in now.agents.items()
    ]
    rows += [_make_sensor_row(one, earlier.sensors.get(name)) for name, one in now.sensors.items()]
    known = {row.process_id for row in rows}
    children = {one.process_id: one for one in earlier.children}
    rows += [
        _make_child_row(one, children.get(one.process_id), now.read_s - earlier.read_s)
        for one in now.children
        if one.process_id not in known
    ]
    return rows


def _make_server_row(stats: Stats, before: Stats | None) -> ProcessRow:
    usage = stats.usage
    earlier = before or Stats()
    return _make_row(
        "server",
        stats.world,
        (usage, earlier.usage),
        robots=stats.entities,
        counts=(stats.steps, earlier.steps),
    )


def _make_agent_row(
    stats: AgentStats, before: AgentStats | None, commands: AgentCommands | None
) -> ProcessRow:
    earlier = before or AgentStats()
    row = _make_row(
        "agent",
        stats.agent,
        (stats.usage, earlier.usage),
        robots=stats.robots,
        counts=(stats.states, earlier.states),
    )
    due_hz = None if commands is None else commands.due_hz
    return msgspec.structs.replace(row, due_hz=due_hz)


def _make_sensor_row(stats: SensorStats, before: SensorStats | None) -> ProcessRow:
    earlier = before or SensorStats()
    return _make_row(
        "sensors",
        stats.process,
        (stats.usage, earlier.usage),
        robots=None,
        counts=(stats.messages, earlier.messages),
    )


def _make_child_row(
    child: LocalProcess, before: LocalProcess | None, elapsed_s: float
) -> ProcessRow:
    cpu = None
    if before is not None and elapsed_s > 0.0:
        cpu = (child.cpu_s - before.cpu_s) / elapsed_s
    memory_mib = child.memory_bytes / MIB
    return ProcessRow("child", child.name, "", child.process_id, cpu, memory_mib, None, None)


def _make_row(
    kind: str,
    name: str,
    usages: tuple[ProcessUsage, ProcessUsage],
    *,
    robots: int | None,
    counts: tuple[int, int],
) -> ProcessRow:
    usage, before = usages
    elapsed_s = usage.wall_s - before.wall_s
    is_same = before.process_id == usage.process_id != 0 and elapsed_s > 0.0
    return ProcessRow(
        kind=kind,
        name=name,
        host=usage.host,
        process_id=usage.process_id,
        cpu=(usage.cpu_s - before.cpu_s) / elapsed_s if is_same else None,
        memory_mib=usage.memory_bytes / MIB if usage.memory_bytes else None,
        robots=robots,
        # A reset counts anew.
        rate_hz=max(0, counts[0] - counts[1]) / elapsed_s if is_same else None,
    )


def list_robot_rows(now: FleetReading) -> list[RobotRow]:
    """List the robots of a world."""
    states = _read_states(now.snapshot)
    rows = []
    for one in now.models.entities:
        model = now.models.models[one.model]
        if model.drive is None:
            continue
        x, y, speed = states.get(one.entity, (None, None, None))
        rows.append(
            RobotRow(
                name=one.namespace or one.entity,
                model=model.name,
                drive=str(model.drive.__struct_config__.tag),
                agent=one.agent,
                x=x,
                y=y,
                speed=speed,
                odom_hz=now.odom_hz.get(one.namespace),
                order=_describe_order(now.vehicles.get(one.entity)),
            )
        )
    return rows


def _describe_order(vehicle: VehicleStatus | None) -> str | None:
    if vehicle is None:
        return None
    if vehicle.errors:
        return vehicle.errors[0]
    goal = f" to {vehicle.goal}" if vehicle.goal else ""
    return f"{vehicle.order}{goal}, {vehicle.task}, {vehicle.battery_percent:.0f} %".lstrip(", ")


def _read_states(
    snapshot: Snapshot | None,
) -> dict[str, tuple[float | None, float | None, float | None]]:
    """Read position [m] and speed [m/s] of each entity on the ground."""
    if snapshot is None or len(snapshot.base) != 8 * STATE_COLUMNS * len(snapshot.names):
        return {}
    base = np.frombuffer(snapshot.base, dtype="<f8").reshape(-1, STATE_COLUMNS)
    speeds = np.hypot(base[:, 7], base[:, 8])
    columns = zip(base[:, 0].tolist(), base[:, 1].tolist(), speeds.tolist(), strict=True)
    return dict(zip(snapshot.names, columns, strict=True))


def sort_rows(rows: Sequence[Row], column: str, *, is_descending: bool) -> list[Row]:
    """Sort rows by a column; rows without a value come last, and ties keep their order."""
    known = [row for row in rows if getattr(row, column) is not None]
    unknown = [row for row in rows if getattr(row, column) is None]
    key = "name" if column == "" else column
    return sorted(known, key=lambda row: getattr(row, key), reverse=is_descending) + unknown


def filter_rows(rows: Sequence[Row], text: str) -> list[Row]:
    """Choose the rows that have a text in one of their words, whatever its case."""
    wanted = text.casefold()
    return [
        row
        for row in rows
        if any(
            wanted in value.casefold()
            for value in msgspec.structs.astuple(row)
            if isinstance(value, str)
        )
    ]


def write_summary(now: FleetReading) -> str:
    """Write in one line how the world runs."""
    stats = now.stats
    if stats is None:
        return "no server has reported yet"
    wanted = f"{stats.target_real_time_factor:g}" if stats.target_real_time_factor else "unlimited"
    robots = sum(now.models.models[one.model].is_robot for one in now.models.entities)
    parts = (
        f"world {stats.world}: {stats.state} at {stats.sim_time_s:.1f} s",
        f"real-time factor {stats.real_time_factor:.2f} of {wanted}",
        f"{robots} robots, {stats.entities} entities, {len(now.agents)} agents",
        f"step {stats.step_time_s * 1e3:.2f} ms (max {stats.step_time_max_s * 1e3:.1f})",
        f"late {stats.late_max_s * 1e3:.1f} ms",
    )
    # First, as terminals cut the end of the line.
    silence = "NO REPORT: the server is gone or does not reply   " if now.is_stale else ""
    return silence + "   ".join(parts)


def format_value(column: str, value: object) -> str:
    """Write a value of a row."""
    if value is None:
        return "-"
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        return f"{value * 100.0:.1f} %" if column == "cpu" else f"{value:.{DIGITS[column]}f}"
    return str(value)


DIGITS: Final = {
    "memory_mib": 1,
    "rate_hz": 1,
    "due_hz": 1,
    "odom_hz": 1,
    "x": 2,
    "y": 2,
    "speed": 2,
}
PROCESS_TITLES: Final = {
    "kind": "process",
    "name": "name",
    "host": "host",
    "process_id": "pid",
    "cpu": "CPU",
    "memory_mib": "memory [MiB]",
    "robots": "robots",
    "rate_hz": "rate [Hz]",
    "due_hz": "due [Hz]",
}
ROBOT_TITLES: Final = {
    "name": "robot",
    "model": "model",
    "drive": "drive",
    "agent": "agent",
    "x": "x [m]",
    "y": "y [m]",
    "speed": "speed [m/s]",
    "odom_hz": "odom [Hz]",
    "order": "order",
}
