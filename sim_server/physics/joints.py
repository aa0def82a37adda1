"""What joints ask of an engine beside motors: damping that a step can bear, and gears."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Joint, Model, Vec3
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.engine import FloatArray


class Gear(NamedTuple):
    """A joint that follows another, by their places in `Model.joints`."""

    follower: int
    leader: int
    axis: Vec3
    ratio: float
    offset: float
    force: float = 1e4
    """Most that the follower is pushed with [N or N m]."""
    mended: float = 0.2
    """Share of its error that one step mends."""

    @property
    def hold(self) -> dict[str, float]:
        """Arguments of changeConstraint."""
        return {
            "gearRatio": self.ratio,
            "relativePositionTarget": self.offset,
            "erp": self.mended,
            "maxForce": self.force,
        }


def gears_of(model: Model) -> Iterator[Gear]:
    """List the joints of a model that follow others."""
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    for follower, joint in enumerate(model.joints):
        if (mimic := joint.mimic) is not None:
            leader = index[mimic.joint]
            yield Gear(follower, leader, joint.axis, -mimic.multiplier, mimic.offset)


def moving_joints(blueprint: Blueprint) -> list[tuple[int, Joint]]:
    """List the joints that move, by the number of their part; the root is -1."""
    return [
        (number, part.joint)
        for number, part in enumerate(blueprint.parts, start=-1)
        if part.joint is not None and part.joint.kind != "fixed"
    ]


def bearable_dampings(
    joints: Sequence[tuple[int, Joint]], masses: FloatArray, dt_s: float
) -> Iterator[tuple[int, float]]:
    """Damp joints as an implicit step would: an explicit one blows up when d dt > I.

    Args:
        joints: By the number of their part.
        masses: Mass matrix of the body, joints last.
        dt_s: Length of a step.

    Yields:
        Number of the part, and its damping [N m s/rad or N s/m].
    """
    yielding = np.diag(np.linalg.pinv(masses))[-len(joints) :].tolist()
    for (number, joint), lightness in zip(joints, yielding, strict=True):
        yield number, joint.damping / (1.0 + joint.damping * dt_s * max(lightness, 0.0))
