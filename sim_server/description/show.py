"""A model for people, as a tree, and for programs, as plain values."""

from typing import Any

import msgspec

from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Joint, Model
from zensim.sim_server.description.drive_words import in_words


def model_json(model: Model) -> dict[str, Any]:
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


def model_tree(model: Model) -> str:
    """Draw links below the links that carry them, then the drive, then the report."""
    lines = [f"{model.name}: {model.mass_kg:.3f} kg", *_branch(model), *_drive_lines(model)]
    for entry in model.report:
        reason = f": {entry.reason}" if entry.reason else ""
        lines.append(f"{entry.status:<10} {entry.subject}{reason}")
    return "\n".join(lines)


def _branch(model: Model) -> list[str]:
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


def _drive_lines(model: Model) -> list[str]:
    if model.drive is None:
        return ["no drive"]
    if not isinstance(model.drive, DiffDrive):
        return [f"drive: {in_words(model.drive)}"]
    return [
        f"drive: {pair.left_joint} and {pair.right_joint}, separation {pair.separation_m:g} m, "
        f"diameter {pair.diameter_m:g} m"
        for pair in model.drive.pairs
    ]
