"""Links that fixed joints hold together become one: mass, centre and inertia exactly."""

from collections.abc import Iterable, Sequence
from math import fsum

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import (
    ZERO,
    Decay,
    Frame,
    Inertial,
    Joint,
    Link,
    Origin,
    Shape,
)
from zensim.sim_server.description.transforms import compose, matrix_of, placed, turned


class Lumped(msgspec.Struct, frozen=True):
    """Links that move by themselves, the joints that move them, and the links merged into them."""

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    frames: tuple[Frame, ...]


def lump(links: Sequence[Link], joints: Sequence[Joint], kept: frozenset[str]) -> Lumped:
    """Merge every link that a fixed joint holds into the nearest link above that moves.

    Args:
        links: In tree order: `joints[i]` moves `links[i + 1]`.
        joints: In tree order.
        kept: Names of fixed joints to leave as they are.

    Returns:
        The same tree order; every frame's parent is one of its links.
    """
    places = {links[0].name: (links[0].name, Origin())}
    groups: dict[str, list[tuple[Link, Origin]]] = {links[0].name: [(links[0], Origin())]}
    moving: list[Joint] = []
    frames: list[Frame] = []
    for joint, link in zip(joints, links[1:], strict=True):
        holder, above = places[joint.parent]
        origin = compose(above, joint.origin)
        if joint.kind == "fixed" and joint.name not in kept:
            places[link.name] = (holder, origin)
            groups[holder].append((link, origin))
            frames.append(Frame(link.name, holder, origin))
        else:
            places[link.name] = (link.name, Origin())
            groups[link.name] = [(link, Origin())]
            moving.append(msgspec.structs.replace(joint, parent=holder, origin=origin))
    merged = tuple(_merged(name, group) for name, group in groups.items())
    return Lumped(merged, tuple(moving), tuple(frames))


def combine(parts: Iterable[tuple[Inertial, Origin]]) -> Inertial:
    """Find the inertial of parts held rigidly together, each placed in one common frame.

    Source: parallel axis theorem, I = sum of R I R' + m (d.d E - d d').
    """
    heavy = [(part, origin) for part, origin in parts if part != Inertial()]
    if not heavy:
        return Inertial()
    if len(heavy) == 1 and heavy[0][1] == Origin():
        return heavy[0][0]
    mass = fsum(part.mass_kg for part, _ in heavy)
    centres = np.array([placed(origin, part.com_in_link) for part, origin in heavy])
    weights = np.array([part.mass_kg for part, _ in heavy])
    com = weights @ centres / mass if mass > 0.0 else np.zeros(3)
    total = np.zeros((3, 3))
    for (part, origin), centre in zip(heavy, centres, strict=True):
        turn, offset = matrix_of(origin), centre - com
        total += turn @ _matrix(part) @ turn.T
        total += part.mass_kg * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    x, y, z = com.tolist()
    ixx, ixy, ixz, _, iyy, iyz, _, _, izz = total.ravel().tolist()
    return Inertial(mass, (x, y, z), (ixx, ixy, ixz, iyy, iyz, izz))


def _matrix(part: Inertial) -> list[list[float]]:
    ixx, ixy, ixz, iyy, iyz, izz = part.inertia
    return [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]


def _merged(name: str, group: list[tuple[Link, Origin]]) -> Link:
    return Link(
        name=name,
        inertial=combine((link.inertial, origin) for link, origin in group),
        collisions=tuple(s for link, origin in group for s in _moved(link.collisions, origin)),
        visuals=tuple(s for link, origin in group for s in _moved(link.visuals, origin)),
        weightless=combine((link.weightless, origin) for link, origin in group),
        decay=_mean_decay([link for link, _ in group]),
        self_collides=any(link.self_collides for link, _ in group),
    )


def _mean_decay(links: Sequence[Link]) -> Decay:
    """Let each part lose its share of what all move with: the mean by mass."""
    mass = fsum(link.inertial.mass_kg for link in links)
    if len(links) == 1 or mass == 0.0 or all(link.decay == Decay() for link in links):
        return links[0].decay
    return Decay(
        fsum(link.inertial.mass_kg * link.decay.linear for link in links) / mass,
        fsum(link.inertial.mass_kg * link.decay.angular for link in links) / mass,
    )


def _moved(shapes: Iterable[Shape], origin: Origin) -> Iterable[Shape]:
    for shape in shapes:
        contact = shape.contact
        if contact.direction != ZERO:
            along = turned(origin, contact.direction)
            contact = msgspec.structs.replace(contact, direction=along)
        yield msgspec.structs.replace(shape, origin=compose(origin, shape.origin), contact=contact)
