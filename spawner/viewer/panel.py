"""What stands in the page's panel, as HTML: the simulation's state and the followed robot."""

from html import escape
from typing import Final

from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.spawner.viewer.kinematics import Array
from zensim.spawner.viewer.scene import LastCommand, Status, pose_lines

COLOURS: Final = {"playing": "#4cc38a", "paused": "#e5b454"}
"""Of the dot before the state; any other state is red."""
STALE_S: Final = 1.0
"""A command older than this is shown with its age."""

Rows = list[tuple[str, str]]


def status_html(status: Status) -> str:
    """Write the state, simulation time, real-time factor and number of robots."""
    colour = COLOURS.get(status.state, "#e5695e")
    others = status.entities - status.robots
    robots = f"{status.robots}" + (f" + {others} without drive" if others else "")
    return _table(
        [
            ("State", f'<span style="color:{colour}">&#9679;</span> {escape(status.state)}'),
            ("Simulation time", clock_text(status.sim_time_s)),
            ("Real-time factor", f"{status.real_time_factor:.2f}"),
            ("Robots", robots),
        ]
    )


def robot_html(member: EntityModel, state: Array, command: LastCommand | None) -> str:
    """Write a robot's namespace, pose, speed and last command."""
    pose, speed = pose_lines(state)
    return _table(
        [
            ("Namespace", escape(member.namespace)),
            ("Pose", pose),
            ("Speed", speed),
            ("Command", command_text(command)),
        ]
    )


def command_text(command: LastCommand | None) -> str:
    """Write the last velocity command, and how old it is unless it is fresh."""
    if command is None:
        return "none yet"
    told = f"v {command.forward_mps:.2f} m/s  w {command.turn_radps:.2f} rad/s"
    return told if command.age_s < STALE_S else f"{told}, {command.age_s:.0f} s ago"


def clock_text(seconds: float) -> str:
    """Write a time as h:mm:ss.hh, without the hours when there are none."""
    minutes, rest = divmod(round(max(seconds, 0.0), 2), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return (f"{hours}:{minutes:02d}" if hours else f"{minutes}") + f":{rest:05.2f}"


def _table(rows: Rows) -> str:
    cells = "".join(
        f'<span style="opacity:.6">{label}</span><span style="white-space:pre-wrap">{value}</span>'
        for label, value in rows
    )
    return (
        '<div style="display:grid;grid-template-columns:max-content 1fr;column-gap:1em;'
        'row-gap:.15em;padding:.15em .7em;font-size:.85em;font-variant-numeric:tabular-nums">'
        f"{cells}</div>"
    )
