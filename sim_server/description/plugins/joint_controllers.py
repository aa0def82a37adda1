"""Controllers of joints: of parameter files, of `<ros2_control>`, or one for all joints by default.

Joints of the drive belong to it alone, as ros2_control gives a command interface to one controller.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.model_messages import (
    DEFAULT_STOPPED_VELOCITY,
    LIMITED_KINDS,
    MOVABLE_KINDS,
    CommandKind,
    JointController,
    PositionTolerance,
)
from zensim.proto.names import InvalidName, check_name
from zensim.sim_server.description.model_geometry import list_joints_above
from zensim.sim_server.description.plugins.plugin_tags import PluginTags, WrittenTags
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from zensim.proto.messages.model_messages import Joint, Model
    from zensim.sim_server.description.plugins.controller_files import Controller
    from zensim.sim_server.description.report import ParseReport

DEFAULT_CONTROLLER = "joint_trajectory_controller"
TRAJECTORY_TYPE = "JointTrajectoryController"
"""Part of the type of controllers with trajectories, of ROS 2 and ROS 1."""
FORWARD_TYPES: dict[str, CommandKind | None] = {
    "ForwardCommandController": None,
    "JointGroupPositionController": "position",
    "JointGroupVelocityController": "velocity",
    "JointGroupEffortController": "effort",
}
"""Parts of the types of controllers that pass numbers on, and what they are; None = as given."""
INTERFACES: tuple[CommandKind, ...] = ("position", "velocity", "effort")
MAX_CONTROLLERS = 32
UNUSED_TAGS = {
    "command_interfaces": "trajectories move joints by their positions",
    "state_interfaces": "positions, velocities and efforts are published",
    "interface_name": "of forward controllers",
    "update_rate": "commands act at each state of the robot",
    "state_publish_rate": "there is no topic of its state",
    "action_monitor_rate": "feedback comes at 20 Hz of simulation time",
    "open_loop_control": "trajectories start where the joints are",
}


def is_joint_controller(controller: Controller) -> bool:
    """Whether a controller commands joints one by one, not a drive."""
    return TRAJECTORY_TYPE in controller.type or _find_forward_type(controller.type) is not None


def add_joint_controllers(
    model: Model, files: Sequence[str], report: ParseReport, *, has_free_wheels: bool = False
) -> Model:
    """Give a model the controllers of its joints.

    Args:
        model: With its drive.
        files: Texts of controllers' files.
        report: Gets what they command.
        has_free_wheels: Whether wheels are left to the default controller: a drive is not wanted.
    """
    free = _list_free_joints(model)
    found = list(_read_controllers(files, free, report))[:MAX_CONTROLLERS] if files else []
    if not found:
        found = list(_make_default(model, free, report, has_free_wheels=has_free_wheels))
    return msgspec.structs.replace(model, joint_controllers=tuple(found))


def _list_free_joints(model: Model) -> dict[str, Joint]:
    """List the joints that move, that no drive owns, and that follow no other joint."""
    owned = set(model.drive.joints) if model.drive else set()
    return {
        joint.name: joint
        for joint in model.joints
        if joint.kind in MOVABLE_KINDS and joint.name not in owned and joint.mimic is None
    }


def _read_controllers(
    files: Sequence[str], free: dict[str, Joint], report: ParseReport
) -> Iterator[JointController]:
    # Most robots have no such file, and yaml takes a while to import.
    from zensim.sim_server.description.plugins.controller_files import read_controllers

    for controller in filter(is_joint_controller, read_controllers(files)):
        subject = f"controller {quote(controller.name)}"
        named = [text for name, text in controller.texts if name == "joints"]
        joints = tuple(dict.fromkeys(name for name in named if name in free))
        missing = [name for name in named if name not in free]
        if missing:
            listed = ", ".join(map(quote, missing[:5]))
            report.suspicious(
                subject, f"joints of the drive, or that do not move, are left out: {listed}"
            )
        try:
            check_name(controller.name, "controller")
        except InvalidName as error:
            report.suspicious(subject, f"left out: {error}")
            continue
        if joints:
            yield _read_controller(controller, joints, subject, report)


def _read_controller(
    controller: Controller, joints: tuple[str, ...], subject: str, report: ParseReport
) -> JointController:
    # Motors hold positions within their effort limits, without gains.
    texts = [one for one in controller.texts if not one[0].startswith("gains.")]
    written = WrittenTags(subject, controller.type, texts)
    tags = PluginTags(written, slug="joint_controller", aliases={}, report=report)
    tags.texts("joints")
    follows = TRAJECTORY_TYPE in controller.type
    interface = "position" if follows else _read_interface(tags, controller.type)
    what = "follows trajectories of" if follows else f"commands the {interface} of"
    report.applied(subject, f"{what} {', '.join(joints)}")
    read = JointController(
        controller.name,
        joints,
        interface,
        follows_trajectories=follows,
        holds=follows or interface == "position",
        tolerances=tuple(
            PositionTolerance(
                joint,
                _read_limit(tags, f"constraints.{joint}.trajectory", 0.0),
                _read_limit(tags, f"constraints.{joint}.goal", 0.0),
            )
            for joint in joints
        ),
        goal_time_s=_read_limit(tags, "constraints.goal_time", 0.0),
        stopped_velocity=_read_limit(
            tags, "constraints.stopped_velocity_tolerance", DEFAULT_STOPPED_VELOCITY
        ),
        allows_partial_goals=tags.flag("allow_partial_joints_goal", default=False),
        allows_moving_end=tags.flag("allow_nonzero_velocity_at_trajectory_end", default=False),
    )
    tags.report_unread(UNUSED_TAGS)
    return read


def _read_limit(tags: PluginTags, tag: str, default: float) -> float:
    """Read a tolerance; a negative one is none."""
    given = tags.signed(tag)
    return default if given is None else max(given, 0.0)


def _read_interface(tags: PluginTags, kind: str) -> CommandKind:
    forward = _find_forward_type(kind)
    given = FORWARD_TYPES[forward] if forward else None
    named = tags.text("interface_name", "position")
    if given is not None:
        return given
    found: CommandKind | None = next((one for one in INTERFACES if one == named), None)
    return found or "position"


def _find_forward_type(kind: str) -> str | None:
    return next((one for one in FORWARD_TYPES if one in kind), None)


def _make_default(
    model: Model, free: dict[str, Joint], report: ParseReport, *, has_free_wheels: bool
) -> Iterator[JointController]:
    """Make a controller of the described joints, else of all that are no wheels or suspensions."""
    kinds: dict[str, set[CommandKind]] = {}
    for one in model.command_interfaces:
        if one.joint in free:
            kinds.setdefault(one.joint, set()).add(one.kind)
    joints = tuple(kinds) or tuple(_list_moved_joints(model, free, has_free_wheels=has_free_wheels))
    if not joints:
        return
    report.applied(
        f"controller {DEFAULT_CONTROLLER!r}", f"follows trajectories of {', '.join(joints)}"
    )
    holds = bool(kinds) and all("position" in found for found in kinds.values())
    yield JointController(DEFAULT_CONTROLLER, joints, holds=holds)


def _list_moved_joints(
    model: Model, free: dict[str, Joint], *, has_free_wheels: bool
) -> Iterator[str]:
    """List the joints that a motor may move: not springs, carriers of wheels, nor casters.

    A joint that turns without limits is that of a caster or rotor, unless it is part of an arm:
    above or below a joint with limits.
    """
    if has_free_wheels:
        yield from free
        return
    above = {joint.name: list(list_joints_above(model, joint)) for joint in model.joints}
    owned = set(model.drive.joints) if model.drive else set()
    carriers = {one for name in owned for one in above.get(name, ())}
    moved = {
        name: joint
        for name, joint in free.items()
        if joint.spring_stiffness <= 0.0 and name not in carriers
    }
    bounded = {
        name for name, one in moved.items() if one.kind in LIMITED_KINDS and one.lower < one.upper
    }
    arms = bounded | {one for name in bounded for one in above[name]}
    for name in moved:
        if name in arms or not bounded.isdisjoint(above[name]):
            yield name
