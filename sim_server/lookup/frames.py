"""Frames that a request may name: the world's, an entity's, a link's; where each is now.

`r1` is the base link of entity r1, `r1::lidar` its link lidar as Gazebo writes it, and `r1/lidar`
the same as tf writes it under namespace r1. Links that were merged into others are frames too.
"""

import numpy as np

from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.rotation import FloatArray, conjugate, multiply, rotate
from zensim.sim_server.errors import SimError
from zensim.sim_server.scene.forward_kinematics import compute_link_poses
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.poses import WORLD_FRAMES, compose, turned
from zensim.sim_server.world.world import World

SCOPE = "::"
SHOWN = 80
IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class FrameNotFound(SimError):
    """No frame has this name."""

    code = ResultCode.NOT_FOUND
    slug = "frame.unknown"

    def __init__(self, frame_id: str) -> None:
        super().__init__(
            f"frame {frame_id[:SHOWN]!r} does not exist; use 'world', 'map', an entity, "
            "'entity::link' or 'namespace/link'"
        )


class FrameAmbiguous(SimError):
    """A name means more than one frame."""

    slug = "frame.ambiguous"

    def __init__(self, frame_id: str, entities: list[str]) -> None:
        super().__init__(
            f"frame {frame_id[:SHOWN]!r} is one of each of {', '.join(entities)[:SHOWN]}; "
            "write it as 'entity::link'"
        )


def frame_pose(world: World, frame_id: str) -> FloatArray:
    """Find where a frame is in the world (7,).

    Raises:
        FrameNotFound: There is none.
        FrameAmbiguous: There is more than one.
    """
    if frame_id in WORLD_FRAMES:
        return IDENTITY
    bare = frame_id.removeprefix("/")
    if any(entity.name == bare for entity in world.entities):
        return world.state_of(bare)[:7]
    found = [
        pose
        for entity, link in _candidates(world, bare)
        if (pose := _link_pose(world, entity, link)) is not None
    ]
    if not found:
        raise FrameNotFound(frame_id)
    if len(found) > 1:
        raise FrameAmbiguous(frame_id, [entity.name for entity, _ in _candidates(world, bare)])
    return found[0]


def in_world(world: World, frame_id: str, pose: FloatArray) -> FloatArray:
    """Turn a pose (7,) given in a frame into the world's; raises as `frame_pose` does."""
    if frame_id in WORLD_FRAMES:
        return pose
    return compose(frame_pose(world, frame_id), pose)


def twist_in_world(world: World, frame_id: str, twist: FloatArray) -> FloatArray:
    """Turn a twist (6,) with the axes of a frame; how the frame moves itself is left out."""
    if frame_id in WORLD_FRAMES:
        return twist
    return turned(frame_pose(world, frame_id), twist)


def seen_from(frame: FloatArray, rows: FloatArray) -> FloatArray:
    """Express state rows (n, 13) of the world in a frame (7,); its own motion is left out."""
    back = conjugate(frame[3:])
    return np.concatenate(
        [
            rotate(back, rows[:, :3] - frame[:3]),
            multiply(np.broadcast_to(back, (len(rows), 4)), rows[:, 3:7]),
            rotate(back, rows[:, 7:10]),
            rotate(back, rows[:, 10:13]),
        ],
        axis=1,
    )


def _candidates(world: World, frame_id: str) -> list[tuple[Entity, str]]:
    """List the entities whose name, or whose namespace, the frame begins with."""
    found: list[tuple[Entity, str]] = []
    for entity in world.entities:
        heads = [entity.name + SCOPE]
        if entity.namespace:
            heads.append(entity.namespace + "/")
        found.extend(
            (entity, frame_id.removeprefix(head)) for head in heads if frame_id.startswith(head)
        )
    return found


def _link_pose(world: World, entity: Entity, link: str) -> FloatArray | None:
    reading, roster = world.reading(), world.roster()
    base = reading.base[roster.row[entity.name], :7]
    positions = reading.joint_positions[roster.joints_of(entity.name)]
    pose = compute_link_poses(entity.model, base[None], positions[None]).get(link)
    return None if pose is None else pose[0]
