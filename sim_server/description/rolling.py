"""How the parts of a drive touch the ground: wheels at one point, a body that is moved not at all.

A cylinder touches along a line, and an engine that solves a few points of it in turn lets the robot
wander as it turns on the spot. A sphere of the same radius about the same centre rolls the same way
and touches at one point. Where a twist moves the body itself, friction could only hold it back.
"""

from collections.abc import Iterable

import msgspec
import numpy as np

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import ZERO, Joint, Link, Model, Origin, Shape
from zensim.sim_server.description.transforms import matrix_of

MAX_OFFSET = 0.01
"""Share of its radius by which a tyre may be off its axle."""
MAX_TILT_COS = 0.9999
MAX_WIDTH = 2.0
"""In radii: what is wider is a roller."""


def touching_links(model: Model) -> tuple[Link, ...]:
    """List the links of a model with the collisions that its drive rolls or slides on."""
    drive = model.drive
    if drive is None:
        return model.links
    if _moves_the_body(drive):
        return tuple(_without_friction(link) for link in model.links)
    axles = _axles(drive, model.joints)
    return tuple(
        _rolling(link, axles[link.name]) if link.name in axles else link for link in model.links
    )


def contact_notes(drive: Drive, links: Iterable[Link], joints: Iterable[Joint]) -> list[str]:
    """Say what `touching_links` does to the links of a robot with this drive."""
    if _moves_the_body(drive):
        return ["friction of its collisions is not used: the twist moves the body"]
    axles = _axles(drive, joints)
    rolling = [
        repr(link.name)
        for link in links
        if link.name in axles and any(is_tyre(one, axles[link.name]) for one in link.collisions)
    ]
    if not rolling:
        return []
    return [f"cylinders of {', '.join(rolling)} touch the ground as spheres of their radius"]


def is_tyre(shape: Shape, axle: Joint) -> bool:
    """Whether a collision is a cylinder about the axle that moves its link."""
    radius, length, _ = shape.size
    if shape.kind != "cylinder" or not 0.0 < length <= MAX_WIDTH * radius:
        return False
    axis = np.array(axle.axis) / np.linalg.norm(axle.axis)
    if abs(float(matrix_of(shape.origin)[:, 2] @ axis)) < MAX_TILT_COS:
        return False
    centre = np.array(shape.origin.position)
    return float(np.linalg.norm(centre - axis * (centre @ axis))) <= MAX_OFFSET * radius


def _moves_the_body(drive: Drive) -> bool:
    return any(actuator.mode == "twist" for actuator in drive.actuators)


def _axles(drive: Drive, joints: Iterable[Joint]) -> dict[str, Joint]:
    return {joint.child: joint for joint in joints if joint.name in drive.wheel_joints}


def _rolling(link: Link, axle: Joint) -> Link:
    if not any(is_tyre(shape, axle) for shape in link.collisions):
        return link
    return msgspec.structs.replace(link, collisions=tuple(_rolled(link.collisions, axle)))


def _rolled(shapes: Iterable[Shape], axle: Joint) -> Iterable[Shape]:
    for shape in shapes:
        if is_tyre(shape, axle):
            place = Origin(shape.origin.position)
            yield msgspec.structs.replace(
                shape, kind="sphere", size=(shape.size[0], 0.0, 0.0), origin=place
            )
        else:
            yield shape


def _without_friction(link: Link) -> Link:
    smooth = tuple(_smoothed(shape) for shape in link.collisions)
    return msgspec.structs.replace(link, collisions=smooth)


def _smoothed(shape: Shape) -> Shape:
    contact = msgspec.structs.replace(shape.contact, direction=ZERO, friction_across=0.0)
    return msgspec.structs.replace(shape, friction=0.0, contact=contact)
