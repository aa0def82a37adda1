"""Driven wheels of a model: rolling radius, and the inertia that a geared motor reflects."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import TURNING_KINDS, Joint, Link, Model, Shape
from zensim.proto.se3 import from_origin
from zensim.sim_server.description.model_geometry import NO_MESHES, FindCorners
from zensim.sim_server.scene.convex_shapes import to_convex_shape

REFLECTED_INERTIA_SHARE = 0.2
"""Least moment of a driven wheel about its axle, over the mass of its robot times radius squared.

The rotor of a geared motor adds its moment times the gear ratio squared: as much, and more. Without
it, the speed of a light wheel changes so easily that the solver's friction is off its direction.
With more, a wheel that stops at once tilts the robot (ADR 44).
"""


class DrivenWheel(NamedTuple):
    """A link on a joint with a velocity actuator.

    Attributes:
        link: Index in `Model.links`.
        radius_m: Largest distance of its collisions from the axle.
        reflected_inertia: Least moment about the axle [kg m^2].
    """

    link: int
    radius_m: float
    reflected_inertia: float


def find_driven_wheels(
    model: Model, links: Sequence[Link], corners: FindCorners = NO_MESHES
) -> Iterator[DrivenWheel]:
    """List the driven wheels of a model; links without a collision on the wheel are left out.

    Args:
        model: The robot.
        links: `links_in_contact` of it.
        corners: Needed for meshes.
    """
    driven = {actuator.joint for actuator in model.actuators if actuator.mode == "velocity"}
    mass_kg = model.mass_kg
    for number, joint in enumerate(model.joints, start=1):
        if joint.name in driven and joint.kind in TURNING_KINDS:
            radius = measure_rolling_radius(links[number], joint, corners)
            if radius > 0.0:
                least = REFLECTED_INERTIA_SHARE * mass_kg * radius * radius
                yield DrivenWheel(number, radius, least)


def measure_rolling_radius(link: Link, axle: Joint, corners: FindCorners = NO_MESHES) -> float:
    """Find the largest distance [m] of a link's collisions from its axle; planes are left out."""
    solids = (shape for shape in link.collisions if shape.kind != "plane")
    return max((_reach_across(shape, axle, corners) for shape in solids), default=0.0)


def _reach_across(shape: Shape, axle: Joint, corners: FindCorners) -> float:
    axis = np.array(axle.axis) / np.linalg.norm(axle.axis)
    solid = to_convex_shape(shape, corners).transformed_by(from_origin(shape.origin))
    across = solid.points - np.outer(solid.points @ axis, axis)
    return (
        float(np.linalg.norm(across, axis=1).max(initial=0.0))
        + solid.sphere_radius_m
        + solid.disc_radius_m
    )
