"""Extra forces on links: compensation of gravity, and velocity decay."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Decay, Inertial, Link, Vec3
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, FloatArray


@dataclass(frozen=True)
class LinkForce:
    """What acts on one part of a body.

    Attributes:
        part: Numbered from -1, the root.
        lift: Force [N] in the world that makes up for gravity.
        arm: From the centre of mass to where the lift acts, along the principal axes.
        drag: Force [N] against each m/s of the centre of mass.
        brake: Torque [N m] against each rad/s, about each principal axis.
    """

    part: int
    lift: FloatArray
    arm: FloatArray
    linear_damping: float
    angular_damping: FloatArray

    def wrench(self, turn: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find force and torque about the centre of mass, in the world.

        Args:
            turn: Orientation (4,) of the principal axes in the world.
            velocity: (6,) of the centre of mass: linear, angular.
        """
        torque = np.cross(rotate(turn, self.arm), self.lift)
        spin = rotate(conjugate(turn), velocity[3:])
        return self.lift - self.linear_damping * velocity[:3], torque - rotate(
            turn, self.angular_damping * spin
        )


def make_link_forces(blueprint: Blueprint, gravity: Vec3, dt_s: float) -> list[LinkForce]:
    """Plan what acts on the parts of a body in each step."""
    loads = []
    for number, link in enumerate(blueprint.links):
        is_nailed = number == 0 and blueprint.is_static
        if not is_nailed and (link.weightless != Inertial() or link.decay != Decay()):
            loads.append(
                _make_link_force(link, blueprint.parts[number].principal, number - 1, gravity, dt_s)
            )
    return loads


def _make_link_force(
    link: Link, principal: Sequence[float], part: int, gravity: Vec3, dt_s: float
) -> LinkForce:
    inertial, weightless = link.inertial, link.weightless
    arm = np.array(weightless.com_in_link) - np.array(inertial.com_in_link)
    mass = max(inertial.mass_kg, MIN_MASS_KG)
    lifted = mass if weightless == inertial else weightless.mass_kg
    turn = np.array(principal)
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    axes = rotate(turn, np.eye(3))
    moments = np.maximum(np.einsum("ij,jk,ik->i", axes, matrix, axes), MIN_INERTIA)
    return LinkForce(
        part,
        lift=-lifted * np.array(gravity),
        arm=rotate(conjugate(turn), arm) if weightless != Inertial() else np.zeros(3),
        linear_damping=mass * explicit_decay_rate(link.decay.linear, dt_s),
        angular_damping=moments * explicit_decay_rate(link.decay.angular, dt_s),
    )


def explicit_decay_rate(rate: float, dt_s: float) -> float:
    """Find the rate that an explicit step needs to lose what a decay of `rate` [1/s] loses."""
    return -math.expm1(-rate * dt_s) / dt_s
