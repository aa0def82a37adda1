"""Extra forces on links: gravity compensation and velocity damping."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import ZERO, Decay, Inertial, Link, Vec3
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, FloatArray


@dataclass(frozen=True)
class LinkForce:
    """Extra forces on one part of a body.

    Attributes:
        part: Index; the root is -1.
        gravity_force: Force [N] in the world that compensates gravity.
        arm: From the centre of mass to where that force acts, along the principal axes.
        linear_damping: Of the centre of mass [N s/m].
        angular_damping: About each principal axis [N m s/rad].
    """

    part: int
    gravity_force: FloatArray
    arm: FloatArray
    linear_damping: float
    angular_damping: FloatArray

    def wrench(
        self, orientation: FloatArray, velocity: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Find force and torque about the centre of mass, in the world.

        Args:
            orientation: (4,) of the principal axes in the world.
            velocity: (6,) of the centre of mass: linear, angular.
        """
        torque = np.cross(rotate(orientation, self.arm), self.gravity_force)
        spin = rotate(conjugate(orientation), velocity[3:])
        return self.gravity_force - self.linear_damping * velocity[:3], torque - rotate(
            orientation, self.angular_damping * spin
        )


def make_link_forces(blueprint: Blueprint, gravity: Vec3, dt_s: float) -> list[LinkForce]:
    """List the extra forces on the parts of a body in each step."""
    forces = []
    for number, link in enumerate(blueprint.links):
        is_fixed = number == 0 and blueprint.is_static
        if not is_fixed and (link.weightless != Inertial() or link.decay != Decay()):
            part = blueprint.link_parts[number]
            principal = blueprint.parts[part].principal
            forces.append(_make_link_force(link, principal, part - 1, gravity, dt_s))
    return forces


def find_common_gravity(links: Sequence[Link], gravity: Vec3) -> Vec3 | None:
    """Find the gravity that acts on all of some links, or on none; None if it differs."""
    heavy = [link for link in links if link.weightless == Inertial()]
    if len(heavy) == len(links):
        return gravity
    is_none = not heavy and all(link.weightless == link.inertial for link in links)
    return ZERO if is_none else None


def _make_link_force(
    link: Link, principal: Sequence[float], part: int, gravity: Vec3, dt_s: float
) -> LinkForce:
    inertial, weightless = link.inertial, link.weightless
    arm = np.array(weightless.com_in_link) - np.array(inertial.com_in_link)
    mass = max(inertial.mass_kg, MIN_MASS_KG)
    compensated_kg = mass if weightless == inertial else weightless.mass_kg
    orientation = np.array(principal)
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    axes = rotate(orientation, np.eye(3))
    moments = np.maximum(np.einsum("ij,jk,ik->i", axes, matrix, axes), MIN_INERTIA)
    return LinkForce(
        part,
        gravity_force=-compensated_kg * np.array(gravity),
        arm=rotate(conjugate(orientation), arm) if weightless != Inertial() else np.zeros(3),
        linear_damping=mass * explicit_decay_rate(link.decay.linear, dt_s),
        angular_damping=moments * explicit_decay_rate(link.decay.angular, dt_s),
    )


def explicit_decay_rate(rate: float, dt_s: float) -> float:
    """Find the rate [1/s] at which an explicit Euler step decays as much as exp(-rate * dt_s)."""
    return -math.expm1(-rate * dt_s) / dt_s
