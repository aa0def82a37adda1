"""Robots for tests, and their claims."""

import struct
from collections.abc import Sequence

import msgspec

from zensim.proto.messages.agent_messages import Claim, DriveState
from zensim.proto.messages.drive_messages import DiffDrive, Drive, WheelPair
from zensim.proto.messages.model_messages import (
    IDENTITY,
    CommandInterface,
    Frame,
    Joint,
    JointController,
    JointStatePublisher,
    Link,
    Model,
    Origin,
)

PAIR = WheelPair("left_joint", "right_joint", separation_m=0.4, diameter_m=0.2)
DRIVE = DiffDrive(
    pairs=(PAIR,),
    update_rate_hz=0.0,
    publish_odom=True,
    publish_odom_tf=True,
    publish_wheel_tf=True,
)
FOOTPRINT = Frame("base_footprint", "base_link", Origin((0.0, 0.0, -0.1)))
CAMERA = Frame("camera", "base_link", Origin((0.2, 0.0, 0.1)))
WHEELS = (
    Joint("left_joint", "continuous", "base_link", "left_wheel", axis=(0.0, 1.0, 0.0)),
    Joint("right_joint", "continuous", "base_link", "right_wheel", axis=(0.0, 1.0, 0.0)),
)
ARM = tuple(
    Joint(name, "revolute", parent, child, lower=-1.0, upper=1.0, effort=9.0, velocity=2.0)
    for name, parent, child in (("lift", "base_link", "upper"), ("wrist", "upper", "lower"))
)
AT_REST = (0.0, 0.0, 0.1, *IDENTITY, *(0.0,) * 6)


def two_wheeler(
    drive: Drive | None = DRIVE,
    *,
    joints: tuple[Joint, ...] = WHEELS,
    frames: tuple[Frame, ...] = (FOOTPRINT, CAMERA),
    joint_state: JointStatePublisher | None = None,
) -> Model:
    """Two wheels 0.4 m apart and 0.2 m across, base_link 0.1 m above base_footprint."""
    links = (Link("base_link"), *(Link(joint.child) for joint in joints))
    return Model("two_wheeler", links, joints, frames, drive, joint_state)


def a_claim(
    claim: int = 1, entity: str = "r1", model: Model | None = None, *, namespace: str = ""
) -> Claim:
    """A claim as a server grants it."""
    return Claim(claim, entity, namespace or entity, model or two_wheeler(), "<robot/>")


def a_state(
    step: int,
    claims: Sequence[int] = (1,),
    *,
    epoch: int = 0,
    base: Sequence[float] = AT_REST,
    positions: Sequence[float] = (0.0, 0.0),
    velocities: Sequence[float] = (0.0, 0.0),
) -> DriveState:
    """Two-wheelers that are all in the same state; 10 ms a step; told after all claims."""
    count = len(claims)
    return DriveState(
        epoch,
        step,
        step * 10_000_000,
        struct.pack(f"<{count}I", *claims),
        _packed(base) * count,
        _packed(positions) * count,
        _packed(velocities) * count,
        newest_claim=1000,
    )


def _packed(numbers: Sequence[float]) -> bytes:
    return struct.pack(f"<{len(numbers)}d", *numbers)


def an_arm_bot(
    *controllers: JointController, interfaces: tuple[CommandInterface, ...] = ()
) -> Model:
    """A two-wheeler with the joints `lift` and `wrist`, of the controller `arm` by default."""
    return msgspec.structs.replace(
        two_wheeler(joints=(*WHEELS, *ARM)),
        joint_controllers=controllers or (JointController("arm", ("lift", "wrist")),),
        command_interfaces=interfaces,
    )
