"""A model as text and as JSON values, and a one-line summary of its drive."""

from typing import Any

import msgspec

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    PlanarMove,
    TricycleDrive,
)
from zensim.proto.messages.model_messages import Joint, Model


def summarize_drive(drive: Drive) -> str:
    """Say what matters of a drive."""
    match drive:
        case DiffDrive():
            pair = drive.pairs[0]
            return f"separation {pair.separation_m:g} m, diameter {pair.diameter_m:g} m"
        case AckermannDrive():
            return (
                f"wheelbase {drive.wheelbase_m:g} m, track {drive.track_m:g} m, "
                f"wheel radius {drive.wheel_radius_m:g} m"
            )
        case TricycleDrive():
            return f"actuated wheel {drive.actuated_wheel_diameter_m:g} m across"
        case PlanarMove():
            return "the body takes the twist, sideways too"


def model_to_json(model: Model) -> dict[str, Any]:
    """List links, joints, frames, mass [kg], drive and report as JSON can hold them."""
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
        "report": msgspec.to_builtins(model.report),
    }


def format_model_tree(model: Model) -> str:
    """Draw links below the links that carry them, then the drive, then the report."""
    lines = [f"{model.name}: {model.mass_kg:.3f} kg", *_format_links(model), *_format_drive(model)]
    for entry in model.report:
        reason = f": {entry.reason}" if entry.reason else ""
        lines.append(f"{entry.status:<10} {entry.subject}{reason}")
    return "\n".join(lines)


def _format_links(model: Model) -> list[str]:
    below: dict[str, list[Joint]] = {}
    for joint in model.joints:
        below.setdefault(joint.parent, []).append(joint)
    masses = {link.name: link.inertial.mass_kg for link in model.links}
    lines = []
    root = model.links[0].name
    waiting: list[tuple[str, str, int]] = [(root, "", 0)]
    while waiting:
        link, by, depth = waiting.pop()
        lines.append(f"{'  ' * depth}{link} {masses[link]:.3f} kg{by}")
        lines += [
            f"{'  ' * depth}  ({frame.name}, merged)"
            for frame in model.frames
            if frame.parent == link
        ]
        waiting.extend(
            (joint.child, f" by {joint.kind} {joint.name}", depth + 1)
            for joint in reversed(below.get(link, []))
        )
    return lines


def _format_drive(model: Model) -> list[str]:
    if model.drive is None:
        return ["no drive"]
    if not isinstance(model.drive, DiffDrive):
        return [f"drive: {summarize_drive(model.drive)}"]
    return [
        f"drive: {pair.left_joint} and {pair.right_joint}, separation {pair.separation_m:g} m, "
        f"diameter {pair.diameter_m:g} m"
        for pair in model.drive.pairs
    ]
