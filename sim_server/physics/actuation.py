"""Map the targets of a model to its motors or to the planar twist of its base."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.drive_messages import Actuator
from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import FloatArray


@dataclass(frozen=True)
class MotorGroup:
    """Motors of one mode, and where their numbers stand among those of the body."""

    joints: list[int]
    efforts: list[float]
    columns: list[int]

    def select(self, numbers: list[float]) -> list[float]:
        """Pick the targets out of the numbers of a body."""
        return [numbers[place] for place in self.columns]


@dataclass(frozen=True)
class Actuation:
    """How a body takes its targets.

    Attributes:
        width: How many numbers it takes.
        twist: Where vx, vy and wz begin; None when the body has no twist of its own.
    """

    width: int
    speeds: MotorGroup
    angles: MotorGroup
    twist: int | None


def make_actuation(model: Model) -> Actuation:
    """Plan where each target goes."""
    placed: list[tuple[int, Actuator]] = []
    width = 0
    for actuator in model.actuators:
        placed.append((width, actuator))
        width += actuator.width
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    twists = [place for place, actuator in placed if actuator.mode == "twist"]
    return Actuation(
        width,
        _make_motor_group([one for one in placed if one[1].mode == "velocity"], index),
        _make_motor_group([one for one in placed if one[1].mode == "position"], index),
        twists[0] if twists else None,
    )


def _make_motor_group(placed: Iterable[tuple[int, Actuator]], index: dict[str, int]) -> MotorGroup:
    chosen = list(placed)
    return MotorGroup(
        [index[actuator.joint] for _, actuator in chosen],
        [actuator.effort for _, actuator in chosen],
        [place for place, _ in chosen],
    )


def make_stop_targets(model: Model, positions: FloatArray) -> FloatArray:
    """Find the targets that stop a body: speeds are 0, and angles stay as they are.

    Args:
        model: Of the body.
        positions: Of its joints, in the order of `Model.joints`.
    """
    plan = make_actuation(model)
    targets = np.zeros(plan.width)
    targets[plan.angles.columns] = positions[plan.angles.joints]
    return targets


def impose_planar_twists(
    velocities: FloatArray, turns: FloatArray, arms: FloatArray, twists: FloatArray
) -> FloatArray:
    """Find the velocities of bodies that go as they are told in the plane, and else as they did.

    Args:
        velocities: (n, 6) of the centres of mass in the world: linear, angular.
        turns: (n, 4) of the root links in the world.
        arms: (n, 3) from root link to centre of mass, in the world.
        twists: (n, 3) vx, vy, wz of the root links along their headings.
    """
    found: FloatArray = velocities.copy()
    yaw = to_yaw(turns)
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left, spin = twists.T
    found[:, 0] = cos * ahead - sin * left - spin * arms[:, 1]
    found[:, 1] = sin * ahead + cos * left + spin * arms[:, 0]
    found[:, 5] = spin
    return found
