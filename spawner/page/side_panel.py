"""Side panel: orders of visitors, and states of simulation and robots as HTML."""

from collections.abc import Callable
from typing import Any, Final

import msgspec

from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.proto.messages.vehicle_messages import VehicleStatus
from zensim.proto.printable_text import to_html
from zensim.proto.service_catalog import Service
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.render_state import LastCommand, SimulationStatus, format_state, is_moving
from zensim.spawner.page.script_messages import HeadOrder


def ignore(_found: object) -> None:
    """Ignore a response or a reason."""


class WorldCall(msgspec.Struct, frozen=True, eq=False):
    """A call of a service of the world, which the loop of the viewer makes."""

    service: Service[Any, Any]
    request: msgspec.Struct
    on_reply: Callable[[Any], None] = ignore
    """Called with the response."""
    on_error: Callable[[str], None] = ignore
    """Called with the reason of a refusal or failure."""
    timeout_s: float = 0.0
    """Timeout of a long call, made on a thread; 0 = a short one, for which drawing waits."""


class WatchedTopic(msgspec.Struct, frozen=True):
    """A topic whose newest messages a visitor is shown."""

    topic: str
    """Name in the topic catalog."""
    entity: str = ""
    """Empty for a topic of the world."""
    name: str = ""
    """Name of a topic of an entity, see `SensorTopic.name`."""


Order = HeadOrder | WorldCall
"""What a visitor requests of the world."""


AMBER: Final = "var(--zensim-amber)"
"""Colour of what is not as wanted; the style sheet of the page has a tone for each theme."""
RED: Final = "var(--zensim-red)"
CONNECTING: Final = SimulationStatus(state="connecting…")
"""State that is shown until the first one has come, or none has come for a while."""
STATE_COLOURS: Final = {
    "playing": "var(--zensim-green)",
    "paused": AMBER,
    "stopped": "var(--mantine-color-dimmed)",
    CONNECTING.state: "var(--mantine-color-dimmed)",
}
"""Colours of the state; any other state is red."""
SHORT: Final = 0.95
"""Share of the wanted real-time factor below which it counts as not reached."""
WITHOUT_COMMANDS: Final = "its behaviour, or a client without cmd_vel"
"""What drives a robot that moves although no command is seen and no order is known."""

PanelRows = list[tuple[str, str]]


def make_status_html(status: SimulationStatus) -> str:
    """Format state, simulation time, real-time factor beside the wanted one, and robots."""
    colour = STATE_COLOURS.get(status.state, RED)
    state = f'<span style="color:{colour}">&#9679;</span> {to_html(status.state)}'
    malformed = [("Malformed sensor messages", f"{status.malformed}")] if status.malformed else []
    cells = [
        ("State", state),
        ("Time", format_clock(status.sim_time_s)),
        ("Real-time factor", _write_factor(status)),
        ("Robots", f"{status.robots}"),
        *malformed,
    ]
    written = "".join(f"<div><dt>{label}</dt><dd>{value}</dd></div>" for label, value in cells)
    return f'<dl class="zensim-status" data-state="{to_html(status.state)}">{written}</dl>'


def is_short(state: str, reached: float, wanted: float) -> bool:
    """Whether a simulation is slower than wanted; 0 wanted = as fast as possible."""
    return state == "playing" and 0.0 < reached < SHORT * wanted


def _write_factor(status: SimulationStatus) -> str:
    reached = status.real_time_factor
    wanted = status.stats.target_real_time_factor if status.stats is not None else 0.0
    text = f"{reached:.2f}" + (f" of {wanted:.2f}" if wanted else "")
    if not is_short(status.state, reached, wanted):
        return text
    return f'<span style="color:{AMBER}">{text}</span>'


def make_robot_html(
    member: EntityModel,
    state: Array,
    command: LastCommand | None,
    vehicle: VehicleStatus | None = None,
) -> str:
    """Format namespace, place, speed of a robot, what commands it, and its order, if it has one."""
    position, heading, speed = format_state(state)
    order = vehicle.order if vehicle is not None else ""
    return _make_table(
        [
            ("Namespace", to_html(member.namespace)),
            ("Position", position),
            ("Heading", heading),
            ("Speed", speed),
            ("Commanded by", format_command(command, moves=is_moving(state), order=order)),
            *(_list_vehicle_rows(vehicle) if vehicle is not None else ()),
        ]
    )


def _list_vehicle_rows(vehicle: VehicleStatus) -> PanelRows:
    where = f" to {vehicle.goal}" if vehicle.goal else f" at {vehicle.last_node}"
    order = f"{vehicle.order}{where}" if vehicle.order else "none yet"
    rows = [
        ("Order", to_html(order)),
        ("Task", to_html(vehicle.task)),
        ("Battery", f"{vehicle.battery_percent:.0f} %"),
    ]
    if vehicle.errors:
        text = "\n".join(to_html(one) for one in vehicle.errors)
        rows.append(("Errors", f'<span style="color:{RED}">{text}</span>'))
    return rows


def format_command(command: LastCommand | None, *, moves: bool = False, order: str = "") -> str:
    """Format what drives a robot, and an old velocity command with its age.

    Args:
        command: Of its `cmd_vel`; None if there was none. Orders of clients need none.
        moves: Whether the robot does.
        order: Of a fleet manager; empty if there is none.
    """
    by = f"order {to_html(order)}" if order else WITHOUT_COMMANDS
    driver = by if moves else "nothing"
    if command is None:
        return driver
    text = f"cmd_vel  v {command.forward_mps:.2f} m/s  w {command.turn_radps:.2f} rad/s"
    return text if command.is_fresh else f"{driver}; {text}, {command.age_s:.0f} s ago"


def format_clock(seconds: float) -> str:
    """Format a time [s] as h:mm:ss.hh, or m:ss.hh below one hour."""
    minutes, rest = divmod(round(max(seconds, 0.0), 2), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return (f"{hours}:{minutes:02d}" if hours else f"{minutes}") + f":{rest:05.2f}"


def _make_table(rows: PanelRows) -> str:
    cells = "".join(
        f'<span style="opacity:.75">{label}</span><span style="white-space:pre-wrap">{value}</span>'
        for label, value in rows
    )
    return (
        '<div style="display:grid;grid-template-columns:max-content 1fr;column-gap:1em;'
        'row-gap:.15em;padding:.15em .7em;font-size:.85em;font-variant-numeric:tabular-nums">'
        f"{cells}</div>"
    )
