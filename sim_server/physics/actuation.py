"""Map the targets of a model to its motors or to the planar twist of its base."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zensim.proto.messages.drive_messages import Actuator
from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import FloatArray


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
class Actuation:
    """Which targets drive which actuators of a body.

    Attributes:
        width: Number of targets.
        twist: Column of vx, followed by vy and wz; None without a planar twist.
    """

    width: int
    speeds: MotorGroup
    angles: MotorGroup
    twist: int | None

    def renumbered(self, numbers: Sequence[int]) -> "Actuation":
        """Replace the index of each joint by its number in an engine."""
        return replace(
            self, speeds=self.speeds.renumbered(numbers), angles=self.angles.renumbered(numbers)
        )


def make_actuation(model: Model) -> Actuation:
    """Find the columns of the targets of each actuator."""
    columns: list[tuple[int, Actuator]] = []
    width = 0
    for actuator in model.actuators:
        columns.append((width, actuator))
        width += actuator.width
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    twists = [column for column, actuator in columns if actuator.mode == "twist"]
    return Actuation(
        width,
        _make_motor_group([one for one in columns if one[1].mode == "velocity"], index, model),
        _make_motor_group([one for one in columns if one[1].mode == "position"], index, model),
        twists[0] if twists else None,
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


def make_stop_targets(model: Model, positions: FloatArray) -> FloatArray:
    """Make targets that stop a body: zero speeds, current angles.

    Args:
        model: Of the body.
        positions: Of its joints, in the order of `Model.joints`.
    """
    actuation = make_actuation(model)
    targets = np.zeros(actuation.width)
    targets[actuation.angles.columns] = positions[actuation.angles.joints]
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
