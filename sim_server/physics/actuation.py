"""Map the targets of a model to its motors or to the planar twist of its base."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zensim.proto.messages.drive_messages import Actuator, ActuatorMode, JointTargetKind
from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import FloatArray

STOPPED_KINDS = (JointTargetKind.VELOCITY, JointTargetKind.EFFORT)
"""Kinds of joint targets that become 0 when a body is stopped; a position holds."""


@dataclass(frozen=True)
class MotorGroup:
    """Motors of one mode, and the columns of their targets among those of the body."""

    joints: list[int]
    efforts: list[float]
    columns: list[int]

    def select(self, targets: list[float]) -> list[float]:
        """Select these motors' targets from those of a body."""
        return [targets[column] for column in self.columns]

    def renumbered(self, numbers: Sequence[int]) -> "MotorGroup":
        """Replace the index of each joint by its number in an engine."""
        return replace(self, joints=[numbers[joint] for joint in self.joints])


@dataclass(frozen=True)
class JointMotor:
    """A motor whose mode is a target.

    Attributes:
        joint: Index of the joint.
        column: Of the `JointTargetKind` among the targets; its number follows.
        effort: Greatest one [N m or N].
        velocity: Greatest one towards a position [rad/s or m/s].
        friction: Of the joint while the motor is off [N m or N].
    """

    joint: int
    column: int
    effort: float
    velocity: float
    friction: float

    def find_target(self, targets: list[float]) -> tuple[int, float]:
        """Select the kind and number of this motor from the targets of a body."""
        return int(targets[self.column]), targets[self.column + 1]


MAX_EFFORT = 1e12
"""Effort of motors without a limit [N m or N]."""
MAX_VELOCITY = 1e12
"""Velocity of motors without a limit [rad/s or m/s]."""


@dataclass(frozen=True)
class Actuation:
    """Which targets drive which actuators of a body.

    Attributes:
        width: Number of targets.
        twist: Column of vx, followed by vy and wz; None without a planar twist.
        joint_motors: Of the joints of controllers.
    """

    width: int
    speeds: MotorGroup
    angles: MotorGroup
    twist: int | None
    joint_motors: tuple[JointMotor, ...] = ()

    def renumbered(self, numbers: Sequence[int]) -> "Actuation":
        """Replace the index of each joint by its number in an engine."""
        return replace(
            self,
            speeds=self.speeds.renumbered(numbers),
            angles=self.angles.renumbered(numbers),
            joint_motors=tuple(
                replace(motor, joint=numbers[motor.joint]) for motor in self.joint_motors
            ),
        )

    def is_driven(self, targets: list[float]) -> bool:
        """Whether targets keep a body moving; a position is reached after a while."""
        at = self.twist
        twist = [] if at is None else targets[at : at + 3]
        pushing = (motor.find_target(targets) for motor in self.joint_motors)
        return (
            any(self.speeds.select(targets))
            or any(twist)
            or any(number and kind in STOPPED_KINDS for kind, number in pushing)
        )


def make_actuation(model: Model) -> Actuation:
    """Find the columns of the targets of each actuator."""
    columns: list[tuple[int, Actuator]] = []
    width = 0
    for actuator in model.actuators:
        columns.append((width, actuator))
        width += actuator.width
    index = {joint.name: i for i, joint in enumerate(model.joints)}

    def select(mode: ActuatorMode) -> list[tuple[int, Actuator]]:
        return [one for one in columns if one[1].mode == mode]

    twists = select("twist")
    return Actuation(
        width,
        _make_motor_group(select("velocity"), index, model),
        _make_motor_group(select("position"), index, model),
        twists[0][0] if twists else None,
        tuple(_list_joint_motors(select("joint"), index, model)),
    )


def _make_motor_group(
    motors: Sequence[tuple[int, Actuator]], index: dict[str, int], model: Model
) -> MotorGroup:
    joints = [index[actuator.joint] for _, actuator in motors]
    return MotorGroup(
        joints,
        [
            actuator.effort * model.joints[joint].motor_factor
            for (_, actuator), joint in zip(motors, joints, strict=True)
        ],
        [column for column, _ in motors],
    )


def _list_joint_motors(
    motors: Sequence[tuple[int, Actuator]], index: dict[str, int], model: Model
) -> Iterator[JointMotor]:
    for column, actuator in motors:
        number = index[actuator.joint]
        joint = model.joints[number]
        effort = (actuator.effort or MAX_EFFORT) * joint.motor_factor
        yield JointMotor(number, column, effort, joint.velocity or MAX_VELOCITY, joint.friction)


def make_stop_targets(
    model: Model, positions: FloatArray, last: FloatArray | None = None
) -> FloatArray:
    """Make targets that stop a body, or several of one model: zero speeds and efforts, angles kept.

    Args:
        model: Of the bodies.
        positions: Of its joints, in the order of `Model.joints`; (joints,), or a row per body.
        last: Last targets of one body; joints that hold a position go on. None = joints become
            free.

    Returns:
        Targets of the body, or a row of them per body.
    """
    actuation = make_actuation(model)
    targets = np.zeros((*positions.shape[:-1], actuation.width))
    targets[..., actuation.angles.columns] = positions[..., actuation.angles.joints]
    if last is None:
        return targets
    for motor in actuation.joint_motors:
        kind, number = motor.find_target(last.tolist())
        targets[motor.column] = kind
        targets[motor.column + 1] = 0.0 if kind in STOPPED_KINDS else number
    return targets


def impose_planar_twists(
    velocities: FloatArray, orientations: FloatArray, arms: FloatArray, twists: FloatArray
) -> FloatArray:
    """Replace the planar part (vx, vy, wz) of velocities by commanded twists.

    Args:
        velocities: (n, 6) of the centres of mass in the world: linear, angular.
        orientations: (n, 4) of the root links in the world.
        arms: (n, 3) from root link to centre of mass, in the world.
        twists: (n, 3) vx, vy, wz of the root links along their headings.
    """
    found: FloatArray = velocities.copy()
    yaw = to_yaw(orientations)
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left, spin = twists.T
    found[:, 0] = cos * ahead - sin * left - spin * arms[:, 1]
    found[:, 1] = sin * ahead + cos * left + spin * arms[:, 0]
    found[:, 5] = spin
    return found
