"""Commands of joints: JointState and Float64MultiArray, checked and limited. No network."""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    detect_format,
    parse_schema_name,
)
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import CommandKind, Model
from zensim.proto.messages.standard_messages import Float64MultiArray, JointState, MultiArrayLayout

KIND_OF_INTERFACE: Final[dict[CommandKind, JointTargetKind]] = {
    "position": JointTargetKind.POSITION,
    "velocity": JointTargetKind.VELOCITY,
    "effort": JointTargetKind.EFFORT,
}
INTERFACE_OF_KIND: Final = {kind: name for name, kind in KIND_OF_INTERFACE.items()}


class JointTarget(NamedTuple):
    """What the motor of a joint shall do: a position, velocity or effort."""

    kind: JointTargetKind = JointTargetKind.FREE
    number: float = 0.0


FREE: Final = JointTarget()


class JointCommand(NamedTuple):
    """A target for one joint, by name."""

    joint: str
    target: JointTarget


class RefusedCommand(ValueError):
    """A command that a joint cannot follow."""


class JointLimits(NamedTuple):
    """Bounds of the targets of a joint, and why targets of a kind are refused.

    Attributes:
        bounds: Least and greatest number of each kind; a kind without them is refused.
    """

    joint: str
    bounds: dict[JointTargetKind, tuple[float, float]]

    def limit(self, target: JointTarget) -> JointTarget:
        """Keep a target within its bounds.

        Raises:
            RefusedCommand: The joint has no command interface of this kind.
        """
        if (bounds := self.bounds.get(target.kind)) is None:
            offered = " and ".join(INTERFACE_OF_KIND[kind] for kind in self.bounds)
            raise RefusedCommand(
                f"joint '{self.joint}' has no {INTERFACE_OF_KIND[target.kind]} command interface; "
                f"command its {offered}"
            )
        return JointTarget(target.kind, min(max(target.number, bounds[0]), bounds[1]))


def list_joint_limits(model: Model) -> dict[str, JointLimits]:
    """Find the limits of each controlled joint, by name: of the joint and of its interfaces.

    A joint without described command interfaces has all.
    """
    names = {actuator.joint for actuator in model.joint_actuators}
    found = {}
    for joint in model.joints:
        if joint.name not in names:
            continue
        has_stops = joint.kind != "continuous" and joint.lower <= joint.upper
        whole = {
            JointTargetKind.POSITION: (joint.lower, joint.upper) if has_stops else _around(0.0),
            JointTargetKind.VELOCITY: _around(joint.velocity),
            JointTargetKind.EFFORT: _around(joint.effort),
        }
        described = [one for one in model.command_interfaces if one.joint == joint.name]
        narrowed = {
            (kind := KIND_OF_INTERFACE[one.kind]): _narrow(whole[kind], one.lower, one.upper)
            for one in described
        }
        found[joint.name] = JointLimits(joint.name, narrowed or whole)
    return found


def _around(most: float) -> tuple[float, float]:
    """Make bounds on either side of 0; 0 = unlimited."""
    return (-most, most) if most > 0.0 else (-math.inf, math.inf)


def _narrow(
    bounds: tuple[float, float], lower: float | None, upper: float | None
) -> tuple[float, float]:
    least, most = bounds
    return (
        least if lower is None else max(least, lower),
        most if upper is None else min(most, upper),
    )


class _EitherCommand(JointState, frozen=True):
    """Union of the fields of both types."""

    layout: MultiArrayLayout = MultiArrayLayout()
    data: tuple[float, ...] | None = None


def decode_joint_command(payload: bytes, encoding: str = "") -> JointState | Float64MultiArray:
    """Read a command of joints.

    CDR without a type in its Encoding is a JointState; MessagePack and JSON are distinguished by
    the key `data`.

    Raises:
        MalformedPayload: It is neither type, or a list has another length than the names.
    """
    if detect_format(payload, encoding) is Format.CDR:
        if parse_schema_name(encoding) == Float64MultiArray.ros_type:
            return decode(Float64MultiArray, payload, encoding)
        command = decode(JointState, payload, encoding)
    else:
        either = decode(_EitherCommand, payload, encoding)
        if either.data is not None:
            return decode(Float64MultiArray, payload, encoding)
        command = either
    _check_lengths(command)
    return command


def _check_lengths(command: JointState) -> None:
    for name in ("position", "velocity", "effort"):
        count = len(getattr(command, name))
        if count not in (0, len(command.name)):
            raise MalformedPayload(
                f"{count} numbers of {name} for {len(command.name)} joints; write as many, or none"
            )


def list_commands(
    message: JointState | Float64MultiArray, joints: Sequence[str], interface: CommandKind
) -> Iterator[JointCommand]:
    """List the commands of a message; NaN stands for none.

    Of a JointState, the position of a joint counts before its velocity, and that before its effort.

    Args:
        message: Any.
        joints: Of the numbers of a Float64MultiArray.
        interface: What these numbers are, unless the label of its first dimension says it.

    Raises:
        MalformedPayload: A number is infinite, or there are more or fewer than joints.
    """
    if isinstance(message, JointState):
        yield from _list_by_name(message)
        return
    labels = [one.label for one in message.layout.dim[:1]]
    named = next((kind for name, kind in KIND_OF_INTERFACE.items() if name in labels), None)
    if len(message.data) != len(joints):
        raise MalformedPayload(
            f"{len(message.data)} numbers for {len(joints)} joints: {', '.join(joints)}"
        )
    kind = named or KIND_OF_INTERFACE[interface]
    for joint, number in zip(joints, message.data, strict=True):
        if not math.isnan(_check_finite(number)):
            yield JointCommand(joint, JointTarget(kind, number))


def _list_by_name(message: JointState) -> Iterator[JointCommand]:
    numbers = (message.position, message.velocity, message.effort)
    for place, joint in enumerate(message.name):
        for kind, listed in zip(KIND_OF_INTERFACE.values(), numbers, strict=True):
            if listed and not math.isnan(_check_finite(listed[place])):
                yield JointCommand(joint, JointTarget(kind, listed[place]))
                break


def _check_finite(number: float) -> float:
    if math.isinf(number):
        raise MalformedPayload("not a command of joints: a number is infinite")
    return number
