"""What Gazebo's topics tell: every entity, and every link of every entity, in the world frame."""

from collections.abc import Sequence

import msgspec
import numpy as np

from zensim.proto.messages.gazebo_messages import LinkStates, ModelStates
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion, Twist, Vector3
from zensim.proto.rotation import FloatArray
from zensim.sim_server.lookup.frames import SCOPE
from zensim.sim_server.scene.forward_kinematics import compute_link_states as motion_of
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.world import World


def model_states(world: World) -> ModelStates:
    """Tell of entities in the order of spawning."""
    return ModelStates(world.roster().names, *_written(world.reading().base))


def link_states(world: World) -> LinkStates:
    """Tell of links, entity by entity, in the order of `Model.links`."""
    names: list[str] = []
    rows = np.zeros((sum(len(one.model.links) for one in world.entities), 13))
    start = {}
    for entity in world.entities:
        start[entity.name] = len(names)
        names.extend(entity.name + SCOPE + link.name for link in entity.model.links)
    for alike in _by_model(world.entities):
        first = np.array([start[entity.name] for entity in alike])
        states = _motions(world, alike)
        for number, link in enumerate(alike[0].model.links):
            rows[first + number] = states[link.name]
    return LinkStates(tuple(names), *_written(rows))


def _by_model(entities: Sequence[Entity]) -> list[list[Entity]]:
    # By identity: entities that were spawned alike share one model, and hashing one is slow.
    groups: dict[int, list[Entity]] = {}
    for entity in entities:
        groups.setdefault(id(entity.model), []).append(entity)
    return list(groups.values())


def _motions(world: World, alike: Sequence[Entity]) -> dict[str, FloatArray]:
    reading, roster = world.reading(), world.roster()
    rows = [roster.row[entity.name] for entity in alike]
    first = roster.joint_start[rows]
    joints = first[:, None] + np.arange(len(alike[0].model.joints), dtype=np.intp)
    return motion_of(
        # Merged links are not told, and cost as much as the others.
        msgspec.structs.replace(alike[0].model, frames=()),
        reading.base[rows],
        reading.joint_positions[joints],
        reading.joint_velocities[joints],
    )


def _written(rows: FloatArray) -> tuple[tuple[Pose, ...], tuple[Twist, ...]]:
    poses, twists = [], []
    for x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz in rows.tolist():
        poses.append(Pose(Point(x, y, z), Quaternion(qx, qy, qz, qw)))
        twists.append(Twist(Vector3(vx, vy, vz), Vector3(wx, wy, wz)))
    return tuple(poses), tuple(twists)
