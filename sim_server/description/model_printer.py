"""A model as text and as JSON values."""

from typing import Any

import msgspec

from zensim.proto.messages.model_messages import Joint, Model, Sensor
from zensim.sim_server.description.plugins.plugin_registry import summarize_drive
from zensim.sim_server.description.plugins.sensor_reader import estimate_cost_s
from zensim.sim_server.description.plugins.sensor_topics import find_message


def model_to_json(model: Model) -> dict[str, Any]:
    """Convert links, joints, frames, mass [kg], drive, sensors and report to JSON values."""
    return {
        "name": model.name,
        "links": [{"name": link.name, "mass_kg": link.inertial.mass_kg} for link in model.links],
        "joints": [
            {"name": joint.name, "kind": joint.kind, "parent": joint.parent, "child": joint.child}
            for joint in model.joints
        ],
        "frames": msgspec.to_builtins(model.frames),
        "mass_kg": model.mass_kg,
        "is_static": model.is_static,
        "drive": msgspec.to_builtins(model.drive),
        "joint_state": msgspec.to_builtins(model.joint_state),
        "sensors": [_sensor_to_json(sensor) for sensor in model.sensors],
        "report": msgspec.to_builtins(model.report),
    }


def _sensor_to_json(sensor: Sensor) -> dict[str, Any]:
    return {
        "name": sensor.name,
        "kind": sensor.kind,
        "link": sensor.frame,
        "is_simulated": sensor.settings is not None,
        "topics": [{"name": topic.name, "message": find_message(topic)} for topic in sensor.topics],
        "frame_id": sensor.frame_id,
        "update_rate_hz": sensor.update_rate_hz,
        "cpu_s_per_message": sensor.settings and estimate_cost_s(sensor.settings),
    }


def format_model_tree(model: Model) -> str:
    """Format the link tree, then the drive, then the report."""
    drive = f"drive: {summarize_drive(model.drive)}" if model.drive else "no drive"
    lines = [f"{model.name}: {model.mass_kg:.3f} kg", *_format_links(model), drive]
    for entry in model.report:
        reason = f": {entry.reason}" if entry.reason else ""
        lines.append(f"{entry.status:<10} {entry.subject}{reason}")
    return "\n".join(lines)


def _format_links(model: Model) -> list[str]:
    children: dict[str, list[Joint]] = {}
    for joint in model.joints:
        children.setdefault(joint.parent, []).append(joint)
    masses = {link.name: link.inertial.mass_kg for link in model.links}
    lines = []
    root = model.links[0].name
    pending: list[tuple[str, str, int]] = [(root, "", 0)]
    while pending:
        link, moved_by, depth = pending.pop()
        lines.append(f"{'  ' * depth}{link} {masses[link]:.3f} kg{moved_by}")
        lines += [
            f"{'  ' * depth}  ({frame.name}, merged)"
            for frame in model.frames
            if frame.parent == link
        ]
        pending.extend(
            (joint.child, f" by {joint.kind} {joint.name}", depth + 1)
            for joint in reversed(children.get(link, []))
        )
    return lines
