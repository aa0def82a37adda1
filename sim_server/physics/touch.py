"""How parts touch, in the numbers that Bullet takes; which of them touch each other."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TypedDict

from zensim.proto.messages.model_messages import ZERO, Link
from zensim.sim_server.physics.blueprint import Blueprint, Part

SOFTEST_STEPS = 4.0
"""Damping in units of stiffness times step that pushes out a fifth of a depth in each step.

It is Bullet's own share for rigid contacts. With less damping a body that was put 2 cm into the
ground would jump out of it, by 1.2 m where stiff.
"""

REACH_M = 1e-4
"""Parts farther apart than this do not push each other yet.

Bullet would solve for all that are within 2 cm, such as a caster that hangs in the air: for a
box_bot that costs a quarter more. What comes fast goes in by as much as it moves in a step, instead
of by less.
"""


class Dynamics(TypedDict, total=False):
    """Arguments of changeDynamics."""

    lateralFriction: float
    spinningFriction: float
    rollingFriction: float
    restitution: float
    contactProcessingThreshold: float
    contactStiffness: float
    contactDamping: float
    anisotropicFriction: tuple[float, float, float]
    linearDamping: float
    angularDamping: float
    localInertiaDiagonal: Sequence[float]
    jointLowerLimit: float
    jointUpperLimit: float


def touch_of(part: Part, dt_s: float, *, is_static: bool) -> Dynamics:
    """Find how a part touches."""
    contact = part.contact
    friction = standing_friction(part.friction) if is_static else part.friction
    touch = Dynamics(
        lateralFriction=friction,
        spinningFriction=0.0,
        rollingFriction=0.0,
        restitution=0.0,
        contactProcessingThreshold=REACH_M,
    )
    if contact.stiffness > 0.0:
        touch["contactStiffness"] = contact.stiffness
        touch["contactDamping"] = max(contact.damping, SOFTEST_STEPS * contact.stiffness * dt_s)
    if contact.direction != ZERO:
        most = max(part.friction, contact.friction_across)
        across = contact.friction_across / most if most else 1.0
        touch["lateralFriction"] = most
        touch["anisotropicFriction"] = (part.friction / most if most else 1.0, across, across)
    return touch


def standing_friction(friction: float) -> float:
    """Find the friction of what stands still.

    Bullet multiplies the frictions of a pair, where Gazebo takes the lesser: up to 1 leaves what
    touches it its own. Worlds give their ground 100.
    """
    return min(friction, 1.0)


def self_touching(blueprint: Blueprint) -> Iterator[tuple[int, int, bool]]:
    """List each pair of parts of a body, and whether they touch each other.

    Two do when either of their links asks for it, unless a joint joins the links. Parts are
    numbered from -1, the root.
    """
    parts, links = blueprint.parts, blueprint.links
    joined = {(part.link, part.parent) for part in parts if part.joint is not None}
    for (i, one), (j, other) in combinations(enumerate(parts, start=-1), 2):
        ends = (one.link, other.link)
        are_joined = ends in joined or ends[::-1] in joined
        asks = links[one.link].self_collides or links[other.link].self_collides
        yield i, j, asks and one.link != other.link and not are_joined


def touches_itself(links: tuple[Link, ...]) -> bool:
    """Whether any link asks to touch others of its model."""
    return any(link.self_collides for link in links)
