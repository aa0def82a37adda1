"""Parameters of a robot's ROS 2 node: its description, and the settings of its drive."""

from collections.abc import Iterator
from typing import Final

import msgspec

from zensim.proto.messages.agent_messages import Claim
from zensim.proto.ros2.node_services import NodeParameter, ParameterContent
from zensim.robot_agent.robot_frames import get_drive

OF_DESCRIPTION: Final = "it is read from the robot's description; spawn the robot again"


def list_robot_parameters(claim: Claim) -> tuple[NodeParameter, ...]:
    """List the parameters: `entity`, `robot_description`, and `drive.*` with units in the names."""
    drive = msgspec.to_builtins(get_drive(claim.model)) if claim.model.drive else {}
    return (
        NodeParameter("entity", claim.entity, "Name in the simulation.", OF_DESCRIPTION),
        NodeParameter(
            "robot_description", claim.robot_description, "URDF of the robot.", OF_DESCRIPTION
        ),
        *(
            NodeParameter(name, value, reason=OF_DESCRIPTION)
            for name, value in _flatten(drive, "drive")
        ),
    )


def _flatten(value: object, name: str) -> Iterator[tuple[str, ParameterContent]]:
    """List the leaves of settings by dotted names; empty ones are left out."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _flatten(part, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        yield from _flatten_items(value, name)
    elif isinstance(value, bool | int | float | str) and value != "":
        yield name, value


def _flatten_items(
    items: list[object] | tuple[object, ...], name: str
) -> Iterator[tuple[str, ParameterContent]]:
    texts = tuple(one for one in items if isinstance(one, str))
    numbers = tuple(float(one) for one in items if isinstance(one, int | float))
    if not items:
        return
    if len(texts) == len(items):
        yield name, texts
    elif len(numbers) == len(items):
        yield name, numbers
    else:
        for number, part in enumerate(items):
            yield from _flatten(part, f"{name}.{number}")
