"""CollisionWatch: the first collision of each robot of a world in process."""

import numpy as np

from zensim.api.entity_values import Collision
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.physics.engine import GROUND, SUPPORT_NORMAL_Z
from zensim.sim_server.world.simulated_world import SimulatedWorld


class CollisionWatch:
    """Reads the contacts of all robots after each step.

    What carries a robot is no collision: the ground, and whatever is fixed and below it.
    """

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self._found: dict[str, tuple[int, Collision]] = {}
        """Body and its first collision, by name of the entity."""

    def find(self, name: str) -> Collision | None:
        """Find the first collision of an entity since it was spawned."""
        found = self._found.get(name)
        is_same = found is not None and found[0] == self._world.entities.find(name).body
        return found[1] if found is not None and is_same else None

    def update(self) -> None:
        """Read the contacts of the last step."""
        entities = self._world.entities
        bodies = [one.body for one in entities if one.model.drive is not None]
        contacts = self._world.engine.read_contacts(bodies)
        rows = np.flatnonzero(
            (contacts.bodies[:, 2] != GROUND) & (contacts.bodies[:, 0] != contacts.bodies[:, 2])
        )
        for row in rows.tolist():
            self._note(contacts.bodies[row].tolist(), contacts.points[row].tolist())

    def _note(self, bodies: list[int], point: list[float]) -> None:
        names = self._world.entities.find_owners([bodies[0], bodies[2]])
        if len(names) < 2:  # noqa: PLR2004  two sides
            return
        name, other = names
        is_carried = (
            self._world.entities.find(other).model.is_static and point[5] > SUPPORT_NORMAL_Z
        )
        if is_carried or self.find(name) is not None:
            return
        time = self._world.clock.time_ns / NANOSECONDS
        self._found[name] = bodies[0], Collision(time, other, (point[0], point[1], point[2]))
