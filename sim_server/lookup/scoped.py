"""Links and joints by the names that Gazebo gives them: `entity::link`, `entity::joint`."""

from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Joint, Link
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.rotation import FloatArray
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.lookup.frames import SCOPE, frame_pose
from zensim.sim_server.scene.forward_kinematics import compute_link_states
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.world import World

SHOWN = 80
NAMED = 5


@dataclass(frozen=True)
class ScopedLink:
    """A link that moves by itself.

    Attributes:
        number: Index among `Model.links`.
    """

    entity: Entity
    number: int

    @property
    def link(self) -> Link:
        """What the model says of it."""
        return self.entity.model.links[self.number]


@dataclass(frozen=True)
class ScopedJoint:
    """A joint.

    Attributes:
        number: Index among `Model.joints`.
    """

    entity: Entity
    number: int

    @property
    def joint(self) -> Joint:
        """What the model says of it."""
        return self.entity.model.joints[self.number]


def link_of(world: World, name: str) -> ScopedLink:
    """Find a link.

    Raises:
        EntityNotFound: There is no such entity.
        Refused: There is no such link, or it was merged into another.
    """
    owner, _, inner = name.partition(SCOPE)
    entity = world.entity(owner)
    names = [link.name for link in entity.model.links]
    if inner in names:
        return ScopedLink(entity, names.index(inner))
    for frame in entity.model.frames:
        if frame.name == inner:
            raise RequestRefused(
                ResultCode.NOT_FOUND,
                f"link {name[:SHOWN]!r} does not move by itself: it is merged into its parent, as "
                f"fixed joints are; use '{owner}{SCOPE}{_moving(entity, frame.parent)}'",
            )
    raise RequestRefused(ResultCode.NOT_FOUND, f"link {name[:SHOWN]!r} {_instead(owner, names)}")


def joint_of(world: World, name: str) -> ScopedJoint:
    """Find a joint by its scoped name, or by its own where one entity only has it.

    Raises:
        EntityNotFound: There is no such entity.
        Refused: There is no such joint, or more than one.
    """
    owner, scope, inner = name.partition(SCOPE)
    entities = (world.entity(owner),) if scope else world.entities
    wanted = inner if scope else name
    found = [
        ScopedJoint(entity, number)
        for entity in entities
        for number, joint in enumerate(entity.model.joints)
        if joint.name == wanted
    ]
    if len(found) == 1:
        return found[0]
    if found:
        owners = ", ".join(f"'{one.entity.name}{SCOPE}{wanted}'" for one in found[:NAMED])
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{len(found)} entities have a joint {name[:SHOWN]!r}; use {owners}",
        )
    if scope:
        names = [joint.name for joint in entities[0].model.joints]
        raise RequestRefused(
            ResultCode.NOT_FOUND, f"joint {name[:SHOWN]!r} {_instead(owner, names)}"
        )
    raise RequestRefused(
        ResultCode.NOT_FOUND,
        f"no entity has a joint {name[:SHOWN]!r}; name it as 'entity{SCOPE}joint'",
    )


def state_of(world: World, name: str) -> FloatArray:
    """Find the state row (13,) of an entity, `entity`, or of any of its links, `entity::link`.

    Raises:
        EntityNotFound: There is no such entity.
        FrameNotFound: There is no such link.
    """
    owner, scope, inner = name.partition(SCOPE)
    entity = world.entity(owner)
    if not scope:
        return world.state_of(name)
    reading, roster = world.reading(), world.roster()
    joints = roster.joints_of(owner)
    states = compute_link_states(
        entity.model,
        reading.base[roster.row[owner]][None],
        reading.joint_positions[joints][None],
        reading.joint_velocities[joints][None],
    )
    if inner not in states:
        frame_pose(world, name)  # says what is wrong with it
    return np.asarray(states[inner][0])


def _moving(entity: Entity, name: str) -> str:
    parents = {frame.name: frame.parent for frame in entity.model.frames}
    while name in parents:
        name = parents[name]
    return name


def _instead(owner: str, names: list[str]) -> str:
    if not names:
        return f"does not exist; entity '{owner}' has none"
    more = ", ..." if len(names) > NAMED else ""
    offered = ", ".join(f"'{owner}{SCOPE}{one}'" for one in names[:NAMED])
    return f"does not exist; use {offered}{more}"
