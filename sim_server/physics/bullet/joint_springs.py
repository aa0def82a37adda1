"""Springs of joints in Bullet: motors whose greatest force is that of the spring and damper."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Joint, Model
from zensim.sim_server.physics.engine import FloatArray


@dataclass(frozen=True)
class JointSprings:
    """Springs of one body, whose joints have no motor.

    Attributes:
        joints: Bullet's numbers.
        stiffness: (k,) [N m/rad or N/m].
        references: (k,) positions without force [rad or m].
        damping: (k,) of the same joints [N m s/rad or N s/m].
    """

    joints: tuple[int, ...]
    stiffness: FloatArray
    references: FloatArray
    damping: FloatArray


def find_joint_springs(model: Model, moving: Iterable[tuple[int, Joint]]) -> JointSprings | None:
    """Find the springs of a body; None without any. A joint with an actuator has none.

    Args:
        model: Of the body.
        moving: Its moving joints by Bullet's numbers.
    """
    driven = {actuator.joint for actuator in model.actuators}
    found = [
        (number, joint)
        for number, joint in moving
        if joint.spring_stiffness > 0.0 and joint.name not in driven
    ]
    if not found:
        return None
    return JointSprings(
        tuple(number for number, _ in found),
        np.array([joint.spring_stiffness for _, joint in found]),
        np.array([joint.spring_reference for _, joint in found]),
        np.array([joint.damping for _, joint in found]),
    )


class SpringMotors(NamedTuple):
    """Target speeds and greatest forces of the motors of springs in a step, each (k,)."""

    speeds: FloatArray
    forces: FloatArray


class SpringTable:
    """Springs of several bodies, in arrays."""

    def __init__(self, springs: Iterable[JointSprings], dt_s: float) -> None:
        """Join the springs of one or more bodies, for steps of this length."""
        joined = tuple(springs)
        damping = np.concatenate([one.damping for one in joined])
        self._stiffness = np.concatenate([one.stiffness for one in joined])
        self._references = np.concatenate([one.references for one in joined])
        self._step_damping = self._stiffness * dt_s + damping

    def find_motors(self, positions: FloatArray, velocities: FloatArray) -> SpringMotors:
        """Find the motors that act as the springs and dampers do, at any mass.

        The force at the end of the step, -k (q + dt v - q0) - d v, is 0 at the target speed: a
        light link reaches it, and a heavy one gets the force of its speed before the step.

        Args:
            positions: (k,) of all joints with springs, body by body.
            velocities: (k,) likewise.
        """
        speeds = self._stiffness * (self._references - positions) / self._step_damping
        return SpringMotors(speeds, self._step_damping * np.abs(speeds - velocities))
