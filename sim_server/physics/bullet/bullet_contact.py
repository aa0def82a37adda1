"""Contact, rolling friction, self-collision and solver parameters in the form that Bullet takes."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Final, TypedDict

from zensim.proto.messages.model_messages import ZERO, Link, Model
from zensim.sim_server.physics.blueprint import MIN_DAMPING_STEPS, Blueprint, RigidPart

SOLVER_ITERATIONS = 20
"""At most. 10 cost 0.87 of this, and a box_bot that has stopped goes on rocking; 50 cost 1.5."""

SOLVER_RESIDUAL_THRESHOLD = 3e-7
"""Square of the greatest change of a speed [m/s] in an iteration after which the solver stops.

The usual 1e-7 costs 1.1 of this; 1e-5 would cost 0.85, and ten times the sideways drift.
"""


class SolverArguments(TypedDict):
    """Arguments of setPhysicsEngineParameter."""

    numSolverIterations: int
    solverResidualThreshold: float
    minimumSolverIslandSize: int
    enableConeFriction: int
    enableFileCaching: int


SOLVER_ARGUMENTS: Final[SolverArguments] = {
    "numSolverIterations": SOLVER_ITERATIONS,
    "solverResidualThreshold": SOLVER_RESIDUAL_THRESHOLD,
    # One that is solved need not go on with others that are not.
    "minimumSolverIslandSize": 1,
    "enableConeFriction": 0,
    # Of another mesh at the same path it would go on with the first.
    "enableFileCaching": 0,
}


ROLLING_RESISTANCE = 0.01
"""Rolling friction over radius, as of rubber on a hard floor."""
ROLLING_SHAPE_KINDS = ("sphere", "cylinder", "capsule")

RollingFrictions = tuple[tuple[int, float], ...]
"""Parts, numbered from -1, and the rolling friction [m] that each has while it stands."""


def find_rolling_frictions(model: Model, blueprint: Blueprint) -> RollingFrictions:
    """List the wheels of a model: what is round, on a joint with a motor for speed."""
    driven = {actuator.joint for actuator in model.actuators if actuator.mode == "velocity"}
    links = {i for i, joint in enumerate(model.joints, start=1) if joint.name in driven}
    return tuple(
        (number, ROLLING_RESISTANCE * _radius_m(part))
        for number, part in enumerate(blueprint.parts, start=-1)
        if part.link in links and part.shapes and _is_round(part)
    )


def _is_round(part: RigidPart) -> bool:
    return all(shape.kind in ROLLING_SHAPE_KINDS for shape in part.shapes)


def _radius_m(part: RigidPart) -> float:
    return max(shape.size[0] for shape in part.shapes)


CONTACT_PROCESSING_M = 1e-4
"""Parts farther apart than this do not push each other yet.

Bullet would solve for all that are within 2 cm, such as a caster that hangs in the air: for a
box_bot that costs a quarter more. What comes fast goes in by as much as it moves in a step, instead
of by less.
"""


class DynamicsArguments(TypedDict, total=False):
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


def make_contact_arguments(part: RigidPart, dt_s: float, *, is_static: bool) -> DynamicsArguments:
    """Find how a part touches."""
    contact = part.contact
    friction = limit_static_body_friction(part.friction) if is_static else part.friction
    touch = DynamicsArguments(
        lateralFriction=friction,
        spinningFriction=0.0,
        rollingFriction=0.0,
        restitution=0.0,
        contactProcessingThreshold=CONTACT_PROCESSING_M,
    )
    if contact.stiffness > 0.0:
        touch["contactStiffness"] = contact.stiffness
        touch["contactDamping"] = max(contact.damping, MIN_DAMPING_STEPS * contact.stiffness * dt_s)
    if contact.direction != ZERO:
        most = max(part.friction, contact.friction_across)
        across = contact.friction_across / most if most else 1.0
        touch["lateralFriction"] = most
        touch["anisotropicFriction"] = (part.friction / most if most else 1.0, across, across)
    return touch


def limit_static_body_friction(friction: float) -> float:
    """Find the friction of what stands still.

    Bullet multiplies the frictions of a pair, where Gazebo takes the lesser: up to 1 leaves what
    touches it its own. Worlds give their ground 100.
    """
    return min(friction, 1.0)


def list_self_collision_pairs(blueprint: Blueprint) -> Iterator[tuple[int, int, bool]]:
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


def has_self_collision(links: tuple[Link, ...]) -> bool:
    """Whether any link asks to touch others of its model."""
    return any(link.self_collides for link in links)
