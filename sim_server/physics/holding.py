"""Wheels that are told to stand resist rolling, as tyres and bearings do.

Without it a braked robot on two wheels goes on rocking between its casters: nothing in rigid
contacts takes that motion away. Wheels that are driven roll freely, and cost no more than before.
"""

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.blueprint import Blueprint, Part

RESISTANCE = 0.01
"""Rolling friction over radius, as of rubber on a hard floor."""
ROUND = ("sphere", "cylinder", "capsule")

Holds = tuple[tuple[int, float], ...]
"""Parts, numbered from -1, and the rolling friction [m] that each has while it stands."""


def holds_of(model: Model, blueprint: Blueprint) -> Holds:
    """List the wheels of a model: what is round, on a joint with a motor for speed."""
    driven = {actuator.joint for actuator in model.actuators if actuator.mode == "velocity"}
    links = {i for i, joint in enumerate(model.joints, start=1) if joint.name in driven}
    return tuple(
        (number, RESISTANCE * _radius_m(part))
        for number, part in enumerate(blueprint.parts, start=-1)
        if part.link in links and part.shapes and _is_round(part)
    )


def _is_round(part: Part) -> bool:
    return all(shape.kind in ROUND for shape in part.shapes)


def _radius_m(part: Part) -> float:
    return max(shape.size[0] for shape in part.shapes)
