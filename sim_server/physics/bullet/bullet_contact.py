"""Contact, rolling friction, self-collision and solver parameters as Bullet's arguments."""

import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any

from zensim.proto.messages.model_messages import ZERO, Contact, Link, Model
from zensim.sim_server.physics.blueprint import (
    MIN_DAMPING_STEPS,
    Blueprint,
    RigidPart,
    find_nearest_principal_axis,
)
from zensim.sim_server.physics.engine import MAX_PENETRATION_RECOVERY_MPS

BulletArguments = dict[str, Any]
"""Keyword arguments of a function of pybullet."""

SOLVER_ITERATIONS = 20
"""Limit. 10 take 0.87 of the time, but a stopped box_bot rocks; 50 take 1.5."""

BEARING_ITERATIONS = 200
"""Limit of a step in which controlled joints or followers bear contacts.

The legs of a quadruped of 14 kg yield by 22 mrad with 20 at 240 Hz, by 1.4 with 200. An island that
has converged stops before; 50 box_bots take 1.4 times as long beside such a robot.
"""

STACK_ITERATIONS = 50
"""Limit of a step in which loose bodies lie on one another.

Five boxes creep by 0.6 mm in 30 s with 50 and friction anchors, by 2.1 with 20, by 7 and 9 mm
without anchors; a step of them takes 120 us instead of 75. With 100 it takes 200, for 0.4 mm.
"""

SOLVER_RESIDUAL_THRESHOLD = 3e-7
"""The solver stops when no speed [m/s] changes by more than the square root of this.

Bullet's default 1e-7 takes 1.1 of the time; 1e-5 takes 0.85, with ten times the sideways drift.
"""


SOLVER_ARGUMENTS: BulletArguments = {
    "numSolverIterations": SOLVER_ITERATIONS,
    "solverResidualThreshold": SOLVER_RESIDUAL_THRESHOLD,
    # Islands are solved separately, so that each stops when it has converged.
    "minimumSolverIslandSize": 1,
    # Without, friction is a square along the world's axes: what slides in x still sticks in y.
    "enableConeFriction": 1,
    # Two surfaces collide if each is in the other's mask; pybullet's default is one of both.
    "collisionFilterMode": 0,
    # The cache ignores that a file has changed.
    "enableFileCaching": 0,
}


ROLLING_RESISTANCE = 0.003
"""Rolling friction over radius: a wheel on a hard floor.

With 0.01 a standing box_bot needs up to 20 iterations a step, with 0.003 about 13.
"""
ROLLING_SHAPE_KINDS = ("sphere", "cylinder", "capsule")

RollingFrictions = tuple[tuple[int, float], ...]
"""Parts, numbered from -1, and the rolling friction [m] of each while the robot stands."""


def find_rolling_frictions(model: Model, blueprint: Blueprint) -> RollingFrictions:
    """List the wheels of a model: round parts on joints with a velocity actuator."""
    driven = {actuator.joint for actuator in model.actuators if actuator.mode == "velocity"}
    links = {i for i, joint in enumerate(model.joints, start=1) if joint.name in driven}
    return tuple(
        (number, ROLLING_RESISTANCE * max(shape.size[0] for shape in part.shapes))
        for number, part in enumerate(blueprint.parts, start=-1)
        if part.link in links
        and part.shapes
        and all(shape.kind in ROLLING_SHAPE_KINDS for shape in part.shapes)
    )


CONTACT_PROCESSING_M = 1e-4
"""Distance below which contacts are solved.

Bullet's default of 2 cm includes casters that hang in the air: a quarter more time for a box_bot.
In exchange, fast bodies penetrate by what they move in a step.
"""


FIRMNESS_SHARE = 0.01
"""Compliance of contacts of a robot, times its mass: they share its load.

With rigid contacts the order of rows decides which of many wheels and casters carries it. A robot
on one contact sinks by 0.02 mm at 240 Hz.
"""
MAX_FIRM_WHEELS = 4
SOFT_SHARE = 1.0
"""The same with more driven wheels, or wheels that slide, whose loads decide how it turns.

The solver's tolerance decides otherwise: it is as large as the speeds that correct a firm contact.
"""
MIN_FRICTION_SHARE = 0.01
"""Least friction in one direction, of that across it.

With 0.0001 a robot with four driven wheels goes at 0.07 to 0.55 of their speed, with 0.01 at 0.996.
"""
RIGID_ERP = 0.08
"""Share of a penetration that a step corrects, where rigid; pybullet's default."""
BOUNCING_ERP = 0.005
"""Share of a penetration that a step corrects of parts that rebound."""
RIGID_STEP_DAMPING = 1e9
"""Step damping [N s/m] of rigid contacts that have one."""
MAX_BOUNCE_THRESHOLD_MPS = 1.0
"""Bullet has one threshold for all, 0.2 m/s: parts with one above this do not rebound."""


def find_firmness(blueprint: Blueprint, dt_s: float) -> float:
    """Find the largest step damping [N s/m] of contacts of a robot; infinite without wheels."""
    driven = sum(part.reflected_inertia > 0.0 for part in blueprint.parts)
    if not driven:
        return math.inf
    if driven > MAX_FIRM_WHEELS:
        share = SOFT_SHARE
    elif blueprint.drags:
        # Few wheels sink no deeper than four.
        share = SOFT_SHARE * driven / MAX_FIRM_WHEELS
    else:
        share = FIRMNESS_SHARE
    return blueprint.mass_kg / (share * dt_s)


def find_recovery_share(depth_m: float, dt_s: float) -> float:
    """Find the share of a penetration that a step may correct, so that bodies part slowly."""
    slow = MAX_PENETRATION_RECOVERY_MPS * dt_s
    return RIGID_ERP if depth_m * RIGID_ERP <= slow else slow / depth_m


def make_recovery_arguments(mass_kg: float, share: float, dt_s: float) -> BulletArguments:
    """Make the compliance of a body whose penetrations a step corrects by a share."""
    firmness = mass_kg / (FIRMNESS_SHARE * dt_s)
    return BulletArguments(
        contactStiffness=share * firmness / dt_s, contactDamping=(1.0 - share) * firmness
    )


def make_contact_arguments(
    part: RigidPart, dt_s: float, *, is_static: bool, moves: bool, firmness: float = math.inf
) -> BulletArguments:
    """Make the contact arguments of changeDynamics of a part.

    Args:
        part: Of a body.
        dt_s: Length of a step.
        is_static: Whether the body is.
        moves: Whether the part can move.
        firmness: See `find_firmness`.
    """
    friction = limit_static_body_friction(part.friction) if is_static else part.friction
    arguments = BulletArguments(
        lateralFriction=friction,
        spinningFriction=0.0,
        rollingFriction=0.0,
        restitution=_find_restitution(part.contact, moves=moves),
        contactProcessingThreshold=CONTACT_PROCESSING_M,
    )
    arguments.update(_make_compliance(part.contact, firmness, dt_s))
    if part.contact.direction != ZERO:
        arguments.update(_make_anisotropic_friction(part))
    return arguments


def _find_restitution(contact: Contact, *, moves: bool) -> float:
    """Find the coefficient of restitution, which Bullet multiplies with that of the other."""
    if contact.restitution is None:
        return float(not moves)
    return contact.restitution if contact.bounce_threshold <= MAX_BOUNCE_THRESHOLD_MPS else 0.0


def _make_compliance(contact: Contact, firmness: float, dt_s: float) -> BulletArguments:
    """Make kp and kd: a step yields by force / (kp dt + kd), and corrects kp dt of that sum."""
    stiffness = contact.stiffness
    damping = max(contact.damping, MIN_DAMPING_STEPS * stiffness * dt_s)
    if stiffness == 0.0:
        if firmness == math.inf:
            return _make_bouncing_compliance(dt_s) if contact.restitution else BulletArguments()
        stiffness, damping = RIGID_ERP / dt_s, 1.0 - RIGID_ERP
        scale = firmness
    else:
        scale = min(1.0, firmness / (stiffness * dt_s + damping))
    return BulletArguments(contactStiffness=scale * stiffness, contactDamping=scale * damping)


def _make_bouncing_compliance(dt_s: float) -> BulletArguments:
    """Correct little of the penetration of a rigid contact, which adds to the rebound."""
    return BulletArguments(
        contactStiffness=BOUNCING_ERP * RIGID_STEP_DAMPING / dt_s,
        contactDamping=(1.0 - BOUNCING_ERP) * RIGID_STEP_DAMPING,
    )


def _make_anisotropic_friction(part: RigidPart) -> BulletArguments:
    """Make the friction of a part whose direction is one of its principal axes."""
    most = max(part.friction, part.contact.friction_across)
    shares = [_find_friction_share(part.contact.friction_across, most)] * 3
    axis, _ = find_nearest_principal_axis(part, part.contact.direction)
    shares[axis] = _find_friction_share(part.friction, most)
    return BulletArguments(lateralFriction=most, anisotropicFriction=shares)


def _find_friction_share(friction: float, most: float) -> float:
    return max(friction / most, MIN_FRICTION_SHARE) if most else 1.0


def limit_static_body_friction(friction: float) -> float:
    """Limit the friction of a static body to 1, so that the other body's friction counts.

    Bullet multiplies the frictions of a pair; Gazebo takes the lesser, and its worlds give the
    ground 100.
    """
    return min(friction, 1.0)


def list_self_collision_pairs(blueprint: Blueprint) -> Iterator[tuple[int, int, bool]]:
    """List each pair of parts of a body, and whether they collide.

    They do if either link has self-collision enabled and no joint joins the links. Parts are
    numbered from -1, the root.
    """
    parts, links = blueprint.parts, blueprint.links
    joined = {(part.link, parts[part.parent].link) for part in parts if part.joint is not None}
    for (i, one), (j, other) in combinations(enumerate(parts, start=-1), 2):
        pair = (one.link, other.link)
        are_joined = pair in joined or pair[::-1] in joined
        is_enabled = links[one.link].self_collides or links[other.link].self_collides
        yield i, j, is_enabled and one.link != other.link and not are_joined


def has_self_collision(links: tuple[Link, ...]) -> bool:
    """Whether any link has self-collision enabled."""
    return any(link.self_collides for link in links)
