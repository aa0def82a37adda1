"""Resolves the frame, link and joint names of requests; finds their poses and states."""

from dataclasses import dataclass

import numpy as np

from zensim.proto.forward_kinematics import compute_link_poses, compute_link_states
from zensim.proto.messages.model_messages import Joint, Link
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.se3 import IDENTITY_POSE, FloatArray, compose, invert, rotate
from zensim.sim_server.errors import RequestRefused, SimError
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.pose_conversion import WORLD_FRAMES, rotate_twist
from zensim.sim_server.world.simulated_world import SimulatedWorld

SCOPE_SEPARATOR = "::"
MAX_SHOWN_CHARACTERS = 80


def _shorten(name: str) -> str:
    return name[:MAX_SHOWN_CHARACTERS]


class FrameNotFound(SimError):
    """No frame has this name."""

    code = ResultCode.NOT_FOUND
    slug = "frame.unknown"

    def __init__(self, frame_id: str) -> None:
        super().__init__(
            f"frame {_shorten(frame_id)!r} does not exist; use 'world', 'map', an entity, "
            "'entity::link' or 'namespace/link'"
        )


class FrameAmbiguous(SimError):
    """More than one frame has this name."""

    slug = "frame.ambiguous"

    def __init__(self, frame_id: str, entities: list[str]) -> None:
        super().__init__(
            f"frame {_shorten(frame_id)!r} is a link of each of {_shorten(', '.join(entities))}; "
            "use 'entity::link'"
        )


def find_frame_pose(world: SimulatedWorld, frame_id: str) -> FloatArray:
    """Find the pose (7,) of a frame in the world.

    Raises:
        FrameNotFound: There is none.
        FrameAmbiguous: There is more than one.
    """
    if frame_id in WORLD_FRAMES:
        return IDENTITY_POSE
    bare = frame_id.removeprefix("/")
    if bare in world.entities:
        return world.state_of(bare)[:7]
    found = [
        pose
        for entity, link in _list_candidates(world, bare)
        if (pose := _find_link_pose(world, entity, link)) is not None
    ]
    if not found:
        raise FrameNotFound(frame_id)
    if len(found) > 1:
        raise FrameAmbiguous(frame_id, [entity.name for entity, _ in _list_candidates(world, bare)])
    return found[0]


def pose_to_world(world: SimulatedWorld, frame_id: str, pose: FloatArray) -> FloatArray:
    """Express a pose (7,) given in a frame in the world; raises as `find_frame_pose` does."""
    if frame_id in WORLD_FRAMES:
        return pose
    return compose(find_frame_pose(world, frame_id), pose)


def twist_to_world(world: SimulatedWorld, frame_id: str, twist: FloatArray) -> FloatArray:
    """Rotate a twist (6,) from the axes of a frame to the world's; ignores motion of the frame."""
    if frame_id in WORLD_FRAMES:
        return twist
    return rotate_twist(find_frame_pose(world, frame_id), twist)


def states_to_frame(frame: FloatArray, rows: FloatArray) -> FloatArray:
    """Express state rows (n, 13) of the world in a frame (7,); ignores motion of the frame."""
    to_frame = invert(frame)
    linear, angular = (rotate(to_frame[3:], rows[:, at : at + 3]) for at in (7, 10))
    return np.concatenate([compose(to_frame, rows[:, :7]), linear, angular], axis=1)


def _list_candidates(world: SimulatedWorld, frame_id: str) -> list[tuple[Entity, str]]:
    """List entities whose name or namespace the frame starts with, and the rest of the frame."""
    found: list[tuple[Entity, str]] = []
    for entity in world.entities:
        heads = [entity.name + SCOPE_SEPARATOR]
        if entity.namespace:
            heads.append(entity.namespace + "/")
        found.extend(
            (entity, frame_id.removeprefix(head)) for head in heads if frame_id.startswith(head)
        )
    return found


def _find_link_pose(world: SimulatedWorld, entity: Entity, link: str) -> FloatArray | None:
    states, index = world.states(), world.entities.index
    base = states.base[index.row[entity.name], :7]
    positions = states.joint_positions[index.joints_of(entity.name)]
    pose = compute_link_poses(entity.model, base[None], positions[None]).get(link)
    return None if pose is None else pose[0]


MAX_SUGGESTED_NAMES = 5


@dataclass(frozen=True)
class ScopedLink:
    """A moving link of an entity, and its number among `Model.links`."""

    entity: Entity
    number: int

    @property
    def link(self) -> Link:
        """Description of the link in the model."""
        return self.entity.model.links[self.number]


@dataclass(frozen=True)
class ScopedJoint:
    """A joint of an entity, and its number among `Model.joints`."""

    entity: Entity
    number: int

    @property
    def joint(self) -> Joint:
        """Description of the joint in the model."""
        return self.entity.model.joints[self.number]


def find_link(world: SimulatedWorld, name: str) -> ScopedLink:
    """Find a link.

    Raises:
        EntityNotFound: There is no such entity.
        RequestRefused: There is no such link, or it was merged into its parent.
    """
    owner, _, inner = name.partition(SCOPE_SEPARATOR)
    entity = world.entities.find(owner)
    names = [link.name for link in entity.model.links]
    if inner in names:
        return ScopedLink(entity, names.index(inner))
    for frame in entity.model.frames:
        if frame.name == inner:
            raise RequestRefused(
                ResultCode.NOT_FOUND,
                f"link {_shorten(name)!r} is merged into its parent by a fixed joint; use "
                f"'{owner}{SCOPE_SEPARATOR}{_find_moving_parent(entity, frame.parent)}'",
            )
    raise RequestRefused(
        ResultCode.NOT_FOUND, f"link {_shorten(name)!r} {_suggest_names(owner, names)}"
    )


def find_joint(world: SimulatedWorld, name: str) -> ScopedJoint:
    """Find a joint by its scoped name, or by its plain name if only one entity has it.

    Raises:
        EntityNotFound: There is no such entity.
        RequestRefused: There is no such joint, or more than one.
    """
    owner, scope, inner = name.partition(SCOPE_SEPARATOR)
    entities = (world.entities.find(owner),) if scope else tuple(world.entities)
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
        owners = ", ".join(
            f"'{one.entity.name}{SCOPE_SEPARATOR}{wanted}'" for one in found[:MAX_SUGGESTED_NAMES]
        )
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{len(found)} entities have a joint {_shorten(name)!r}; use {owners}",
        )
    if scope:
        names = [joint.name for joint in entities[0].model.joints]
        raise RequestRefused(
            ResultCode.NOT_FOUND, f"joint {_shorten(name)!r} {_suggest_names(owner, names)}"
        )
    raise RequestRefused(
        ResultCode.NOT_FOUND,
        f"no entity has a joint {_shorten(name)!r}; use 'entity{SCOPE_SEPARATOR}joint'",
    )


def find_state(world: SimulatedWorld, name: str) -> FloatArray:
    """Find the state row (13,) of an entity, `entity`, or of any of its links, `entity::link`.

    Raises:
        EntityNotFound: There is no such entity.
        FrameNotFound: There is no such link.
    """
    owner, scope, inner = name.partition(SCOPE_SEPARATOR)
    entity = world.entities.find(owner)
    if not scope:
        return world.state_of(name)
    states, index = world.states(), world.entities.index
    joints = index.joints_of(owner)
    link_states = compute_link_states(
        entity.model,
        states.base[index.row[owner]][None],
        states.joint_positions[joints][None],
        states.joint_velocities[joints][None],
    )
    if inner not in link_states:
        find_frame_pose(world, name)  # raises
    return np.asarray(link_states[inner][0])


def _find_moving_parent(entity: Entity, name: str) -> str:
    parents = {frame.name: frame.parent for frame in entity.model.frames}
    while name in parents:
        name = parents[name]
    return name


def _suggest_names(owner: str, names: list[str]) -> str:
    if not names:
        return f"does not exist; entity '{owner}' has none"
    more = ", ..." if len(names) > MAX_SUGGESTED_NAMES else ""
    offered = ", ".join(f"'{owner}{SCOPE_SEPARATOR}{one}'" for one in names[:MAX_SUGGESTED_NAMES])
    return f"does not exist; use {offered}{more}"
