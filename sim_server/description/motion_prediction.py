"""Prediction of how a robot drives on level ground, and notes where it is not as commanded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.drives.differential_drive import find_base_step
from zensim.proto.drives.drive_kinematics import make_drive_kinematics
from zensim.proto.drives.measured_joints import MeasuredJoints, PlanarTwist
from zensim.proto.drives.rate_steering import find_roll_signs
from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.rigid_transforms import transform_point
from zensim.sim_server.description.ground_friction import GroundFriction, GroundMotion, JointTargets
from zensim.sim_server.description.model_geometry import (
    NO_MESHES,
    find_link_poses,
    find_start_positions,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.proto.messages.drive_messages import Drive
    from zensim.proto.messages.model_messages import Joint, Model
    from zensim.sim_server.description.model_geometry import FindCorners

STRAIGHT: PlanarTwist[float] = (0.2, 0.0, 0.0)
TURN: PlanarTwist[float] = (0.0, 0.0, 0.5)
"""Nominal commands [m/s, m/s, rad/s]."""
STEERING_RAD = 0.3
"""Angle of steered wheels in a nominal turn, at the speed of `STRAIGHT`."""
SETTLED_S = 1e3
"""Time after which limits of acceleration have no effect."""


@dataclass(frozen=True)
class PredictedMotion:
    """What a robot does under one command.

    Attributes:
        command: As given to the drive.
        nominal: Twist of the root link that the drive's own sizes give.
        twist: Twist of the root link that friction and geometry give.
        ground: Contacts and pose.
    """

    command: PlanarTwist[float]
    nominal: PlanarTwist[float]
    twist: PlanarTwist[float]
    ground: GroundMotion


def turn_command(drive: Drive) -> PlanarTwist[float]:
    """Choose the nominal command that turns a robot: on the spot, or an arc if its wheels steer."""
    speed = STRAIGHT[0]
    match drive:
        case AckermannDrive() | TricycleDrive():
            return speed, 0.0, STEERING_RAD
        case SteeringDrive():
            return speed, 0.0, speed * math.tan(STEERING_RAD) / abs(drive.wheelbase_m)
        case _:
            return TURN


def predict_motion(
    model: Model, command: PlanarTwist[float], friction: GroundFriction
) -> PredictedMotion:
    """Predict the steady motion of a model with a drive, on level ground of friction 1."""
    numbers = find_drive_targets(model, command)
    if is_moved_by_twist(model):
        at_rest = friction.move(JointTargets(np.zeros(len(model.joints)), {}, {}))
        return PredictedMotion(command, command, command, at_rest)
    found = friction.move(make_joint_targets(model, numbers))
    return PredictedMotion(command, find_nominal_twist(model, numbers), found.twist, found)


def is_moved_by_twist(model: Model) -> bool:
    """Whether the twist is applied to the body, whatever its wheels do."""
    return any(actuator.mode == "twist" for actuator in model.drive_actuators)


def find_drive_targets(model: Model, command: PlanarTwist[float]) -> tuple[float, ...]:
    """Find the targets that the drive of a model sends after a while.

    Raises:
        ValueError: The model has no drive.
    """
    if model.drive is None:
        raise ValueError(f"model '{model.name}' has no drive; use a model with a drive")
    drive = make_drive_kinematics(model.drive, FLOAT_MATH)
    zeros = [0.0 for actuator in model.drive_actuators if actuator.joint]
    targets, _ = drive.find_targets(
        command,
        measured=MeasuredJoints(zeros, zeros),
        state=(0.0,) * drive.state_size,
        dt_s=SETTLED_S,
    )
    return targets


def make_joint_targets(model: Model, numbers: tuple[float, ...]) -> JointTargets:
    """Assign the targets of velocity and position actuators to joints."""
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    steering = model.drive.steering_joints if model.drive else ()
    start = find_start_positions(model)
    positions = np.array([start[joint.name] for joint in model.joints])
    speeds, efforts = {}, {}
    for actuator, number in zip(model.drive_actuators, numbers, strict=True):
        joint = index[actuator.joint]
        if actuator.mode == "position":
            positions[joint] = limit_position(model.joints[joint], number)
        elif actuator.joint in steering:
            positions[joint] = number * SETTLED_S
        else:
            speeds[joint], efforts[joint] = number, actuator.effort
    return JointTargets(positions, speeds, efforts)


def limit_position(joint: Joint, position: float) -> float:
    """Keep a position within the limits of its joint."""
    if joint.kind == "continuous" or joint.lower > joint.upper:
        return position
    return min(max(position, joint.lower), joint.upper)


def find_nominal_twist(model: Model, numbers: tuple[float, ...]) -> PlanarTwist[float]:
    """Find the twist of the root link by the drive's own sizes; 0 without wheels."""
    match model.drive:
        case DiffDrive() as drive:
            ahead, turn = find_base_step(drive.pairs[0], *numbers[:2])
            axle = find_middle(model, drive.wheel_joints)
        case AckermannDrive() as drive:
            ahead = (numbers[0] + numbers[1]) / 2.0 * drive.wheel_radius_m
            turn = ahead * _find_slope(numbers[2:4]) / drive.wheelbase_m
            axle = find_middle(model, drive.wheel_joints[:2])
        case TricycleDrive() as drive:
            ahead, turn, axle = _find_tricycle_motion(model, drive, numbers)
        case SteeringDrive() as drive:
            ahead, turn, axle = _find_steered_motion(model, drive, numbers)
        case _:
            return (0.0, 0.0, 0.0)
    x, y = axle
    return ahead + turn * y, -turn * x, turn


def _find_slope(angles: Sequence[float]) -> float:
    """Find the slope of the middle of steered wheels, which turn about one point."""
    return len(angles) / sum(1.0 / math.tan(angle) for angle in angles) if all(angles) else 0.0


AxleMotion = tuple[float, float, tuple[float, float]]
"""Speed [m/s], turn [rad/s], and the place (x, y) [m] of the axle that has them."""


def _find_tricycle_motion(
    model: Model, drive: TricycleDrive, numbers: tuple[float, ...]
) -> AxleMotion:
    speed, angle = numbers[0] * drive.actuated_wheel_diameter_m / 2.0, numbers[1]
    if drive.max_steering_speed > 0.0:
        angle *= SETTLED_S
    axle = find_middle(model, drive.wheel_joints[1:])
    reach = find_middle(model, drive.wheel_joints[:1])[0] - axle[0]
    return speed * math.cos(angle), speed * math.sin(angle) / reach, axle


def _find_steered_motion(
    model: Model, drive: SteeringDrive, numbers: tuple[float, ...]
) -> AxleMotion:
    count = len(drive.traction)
    slope = _find_slope(numbers[count : count + len(drive.steering)])
    signs = find_roll_signs(drive)
    rims = [number * sign for number, sign in zip(numbers[:count], signs, strict=True)]
    ahead = sum(rims) / count * drive.wheel_radius_m
    if drive.counter_steering:
        aside = slope / drive.wheelbase_m * drive.steering_track_m / 2.0
        ahead /= (math.hypot(1.0 - aside, slope) + math.hypot(1.0 + aside, slope)) / 2.0
    if drive.is_traction_steered:
        ahead /= math.hypot(1.0, slope)
        x, y = find_middle(model, drive.steering)
        axle = x - drive.wheelbase_m, y
    else:
        axle = find_middle(model, drive.traction)
    return ahead, ahead * slope / drive.wheelbase_m, axle


def find_middle(model: Model, joints: tuple[str, ...]) -> tuple[float, float]:
    """Find the middle (x, y) [m] of the links of joints, in the root link."""
    poses = find_link_poses(model.links[0].name, model.joints)
    children = {joint.name: joint.child for joint in model.joints}
    places = [transform_point(poses[children[name]], (0.0, 0.0, 0.0)) for name in joints]
    x, y, _ = np.mean(places, axis=0).tolist()
    return x, y


def predict_nominal_motions(
    model: Model, corners: FindCorners = NO_MESHES
) -> tuple[PredictedMotion, PredictedMotion]:
    """Predict driving straight and turning at the nominal commands."""
    friction = GroundFriction(model, corners)
    turn = turn_command(model.drive) if model.drive else TURN
    return predict_motion(model, STRAIGHT, friction), predict_motion(model, turn, friction)
