"""Command interfaces of joints: `<ros2_control>` of ROS 2 and `<transmission>` of ROS 1."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, get_args

from zensim.proto.messages.model_messages import CommandInterface, CommandKind
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.report import ParseReport

COMMAND_KINDS: tuple[CommandKind, ...] = get_args(CommandKind)
MAX_INTERFACES = 400
READ_PARAMS = {"command_interface": ("min", "max"), "state_interface": ("initial_value",)}
"""Names of <param> that are read, by element."""


def read_command_interfaces(
    robot: Element, joints: Iterable[Joint], report: ParseReport
) -> tuple[CommandInterface, ...]:
    """Read the command interfaces of moving joints, and report them in one entry."""
    found: dict[tuple[str, str], CommandInterface] = {}
    for block in robot.iter("ros2_control", "transmission"):
        read = _read_control if block.tag == "ros2_control" else _read_transmission
        for joint in block.findall("joint"):
            for interface in read(joint, report):
                found.setdefault((interface.joint, interface.kind), interface)
    names = {joint.name for joint in joints}
    known = [one for one in found.values() if one.joint in names][:MAX_INTERFACES]
    missing = sorted({one.joint for one in found.values()} - names)
    if known:
        report.applied("command interfaces", ", ".join(map(_describe_interface, known)))
    if missing:
        listed = ", ".join(map(quote, missing[:5]))
        report.ignored("command interfaces", f"of joints that are fixed or do not exist: {listed}")
    return tuple(known)


def _describe_interface(interface: CommandInterface) -> str:
    if interface.lower is None and interface.upper is None:
        return f"{interface.joint} {interface.kind}"
    return f"{interface.joint} {interface.kind} {interface.lower} to {interface.upper}"


def _report_unread_params(joint: Element, report: ParseReport) -> None:
    for tag, known in READ_PARAMS.items():
        for param in joint.findall(f"{tag}/param"):
            if (name := param.get("name") or "") not in known:
                subject = f"ros2_control, joint {quote(_name(joint))}: <param name={quote(name)}>"
                report.ignored(subject, f"of a <{tag}> only {' and '.join(known)} are read")


def _read_control(joint: Element, report: ParseReport) -> Iterable[CommandInterface]:
    _report_unread_params(joint, report)
    for command in joint.findall("command_interface"):
        kind = _find_kind(command.get("name") or "")
        if kind is not None:
            yield CommandInterface(
                _name(joint),
                kind,
                _read_bound(joint, command, "min", report),
                _read_bound(joint, command, "max", report),
                _read_initial(joint, report),
            )


def _read_transmission(joint: Element, _: ParseReport) -> Iterable[CommandInterface]:
    for tag in joint.findall("hardwareInterface"):
        # Such as hardware_interface/VelocityJointInterface.
        kind = _find_kind((tag.text or "").strip().rpartition("/")[2].lower())
        if kind is not None:
            yield CommandInterface(_name(joint), kind)


def _name(joint: Element) -> str:
    return (joint.get("name") or "").strip()


def _find_kind(word: str) -> CommandKind | None:
    return next((kind for kind in COMMAND_KINDS if word.startswith(kind)), None)


def _read_initial(joint: Element, report: ParseReport) -> float | None:
    """Read the position at spawn, of the state interface."""
    states = (tag for tag in joint.findall("state_interface") if tag.get("name") == "position")
    found = (_read_bound(joint, state, "initial_value", report) for state in states)
    return next((number for number in found if number is not None), None)


def _read_bound(joint: Element, command: Element, name: str, report: ParseReport) -> float | None:
    texts = [tag.text or "" for tag in command.findall("param") if tag.get("name") == name]
    if not texts:
        return None
    try:
        number = float(texts[0])
    except ValueError:
        number = math.nan
    if math.isfinite(number):
        return number
    where = f"ros2_control, joint {quote(_name(joint))}, {name}"
    report.suspicious(where, f"{quote(texts[0])} is not a number; not used")
    return None
