"""WorldLayout: where robots, joints and what never moves are in the arrays of a world."""

from dataclasses import dataclass

import numpy as np

from zensim.api.api_errors import Invalid, Unsupported
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.engine import BodyStates, FloatArray, IntArray, can_move
from zensim.sim_server.world.simulated_world import SimulatedWorld


@dataclass(frozen=True)
class WorldLayout:
    """Entities of a world, of which those that can move are read.

    Attributes:
        entities: Names of all.
        bodies: In the engine, of those that are read.
        read: (m,) their rows among all.
        read_joints: (k,) their joints among those of all.
        robots: (n,) rows of the robots among those that are read.
        robot_rows: (n,) likewise among all.
        names: Of the robots.
        models: Likewise.
        first_joints: (n,) first joint of each robot among those that are read.
        start: Of all entities, when the world was copied.
    """

    entities: tuple[str, ...]
    bodies: tuple[int, ...]
    read: IntArray
    read_joints: IntArray
    robots: IntArray
    robot_rows: IntArray
    names: tuple[str, ...]
    models: tuple[Model, ...]
    first_joints: IntArray
    start: BodyStates

    def fill_in(self, base: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Complete the states of what is read with what never moves.

        Args:
            base: (worlds, m, 13).
            positions: (worlds, k).

        Returns:
            The same of all entities: (worlds, e, 13), and joints (worlds, j).
        """
        worlds = len(base)
        all_base = np.tile(self.start.base, (worlds, 1, 1))
        all_positions = np.tile(self.start.joint_positions, (worlds, 1))
        all_base[:, self.read] = base
        all_positions[:, self.read_joints] = positions
        return all_base, all_positions


def make_world_layout(world: SimulatedWorld) -> WorldLayout:
    """Find the layout of a world.

    Raises:
        Invalid: It has no robot.
        Unsupported: Joints of an entity are controlled.
    """
    entities = tuple(world.entities)
    for entity in entities:
        if entity.model.joint_actuators:
            raise Unsupported(
                f"'{entity.name}' has controlled joints, which a batch does not drive",
                hint="use models without joint controllers",
            )
    counts = np.array([len(entity.model.joints) for entity in entities], np.intp)
    is_read = np.array([can_move(entity.model) for entity in entities], np.bool_)
    read = np.flatnonzero(is_read)
    is_robot = np.array([entity.model.drive is not None for entity in entities], np.bool_)
    robot_rows = np.flatnonzero(is_robot)
    if not len(robot_rows):
        raise Invalid("the world has no robot with a drive", hint="spawn one")
    first_joints = np.cumsum(counts[read]) - counts[read]
    robots = np.searchsorted(read, robot_rows)
    return WorldLayout(
        entities=tuple(entity.name for entity in entities),
        bodies=tuple(entities[row].body for row in read.tolist()),
        read=read,
        read_joints=np.flatnonzero(np.repeat(is_read, counts)),
        robots=robots,
        robot_rows=robot_rows,
        names=tuple(entities[row].name for row in robot_rows.tolist()),
        models=tuple(entities[row].model for row in robot_rows.tolist()),
        first_joints=first_joints[robots],
        start=world.states(),
    )
