"""Contacts of the collisions that contact sensors watch: their message, and events of touching."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensor_messages import Contacts, ContactSensor
from zensim.proto.se3 import FloatArray, invert, transform_points
from zensim.sim_server.physics.engine import ContactPoints, IntArray
from zensim.sim_server.queries.frame_queries import SCOPE_SEPARATOR
from zensim.sim_server.scene.convex_shapes import MeshVertices
from zensim.sim_server.scene.touched_collisions import find_touched_collisions
from zensim.sim_server.world.entity import Entity, EntityIndex
from zensim.sim_server.world.simulated_world import World

GROUND_COLLISION = SCOPE_SEPARATOR.join(("ground_plane", "link", "collision"))
"""Name of the ground in messages: that of Gazebo's model."""


@dataclass(frozen=True)
class WatchedCollision:
    """A collision of an entity, by the indices of its link and in that link."""

    entity: str
    link: int
    collision: int


@dataclass(frozen=True)
class WatchedEntities:
    """What contact sensors watch, as long as the entities of the world are the same."""

    index: EntityIndex
    bodies: tuple[int, ...]
    names: Mapping[int, str]
    """Of all entities, by body."""
    sensors: Mapping[tuple[str, str], frozenset[WatchedCollision]]
    """By entity and sensor."""
    collisions: frozenset[WatchedCollision]


def list_contact_sensors(model: Model) -> list[tuple[Sensor, ContactSensor]]:
    """List the contact sensors of a model, with their settings."""
    return [
        (sensor, sensor.settings)
        for sensor in model.sensors
        if isinstance(sensor.settings, ContactSensor)
    ]


def find_watched_entities(entities: Sequence[Entity], index: EntityIndex) -> WatchedEntities:
    """Find what the contact sensors of entities watch."""
    sensors = {
        (entity.name, sensor.name): frozenset(
            WatchedCollision(entity.name, *pair) for pair in settings.collisions
        )
        for entity in entities
        for sensor, settings in list_contact_sensors(entity.model)
    }
    watching = {name for name, _ in sensors}
    return WatchedEntities(
        index,
        tuple(entity.body for entity in entities if entity.name in watching),
        {entity.body: entity.name for entity in entities},
        sensors,
        frozenset().union(*sensors.values()),
    )


class ContactTelemetry:
    """Reads what contact sensors feel; nothing without such sensors."""

    def __init__(self, world: World, meshes: MeshVertices) -> None:
        self._world = world
        self._meshes = meshes
        self._watched: WatchedEntities | None = None
        self._touching: frozenset[tuple[str, str]] = frozenset()
        """Entity and sensor, as of the last reading."""
        self._epoch = -1

    @property
    def has_sensors(self) -> bool:
        """Whether any entity has a contact sensor."""
        return bool(self._find_watched().bodies)

    def read(self) -> Contacts:
        """Read the contacts of the last step; add an event for each sensor that begins to touch."""
        clock, watched = self._world.clock, self._find_watched()
        found = self._world.engine.read_contacts(watched.bodies)
        own = self._find_collisions(found, found.bodies[:, :2])
        is_watched = np.array([one in watched.collisions for one in own], dtype=np.bool_)
        rows = np.flatnonzero(is_watched)
        found, own = found.select(rows), [own[row] for row in rows.tolist()]
        others = self._name_others(found)
        self._add_events(own, others)
        entities = list(dict.fromkeys(one.entity for one in own))
        collisions = list(dict.fromkeys(others))
        bodies = [
            (entities.index(one.entity), one.link, one.collision, collisions.index(other))
            for one, other in zip(own, others, strict=True)
        ]
        return Contacts(
            *(clock.epoch, clock.steps, clock.time_ns, tuple(entities), tuple(collisions)),
            np.array(bodies, dtype="<u4").tobytes(),
            found.points.astype("<f8").tobytes(),
        )

    def _find_watched(self) -> WatchedEntities:
        index = self._world.entities.index
        if self._watched is None or self._watched.index is not index:
            self._watched = find_watched_entities(list(self._world.entities), index)
        return self._watched

    def _name_others(self, found: ContactPoints) -> list[str]:
        """Name what is on the other side of each point."""
        names = [GROUND_COLLISION] * len(found)
        rows = np.flatnonzero(np.isin(found.bodies[:, 2], list(self._find_watched().names)))
        others = self._find_collisions(found.select(rows), found.bodies[rows, 2:])
        for row, one in zip(rows.tolist(), others, strict=True):
            names[row] = self._name_collision(one)
        return names

    def _name_collision(self, one: WatchedCollision) -> str:
        link = self._world.entities.find(one.entity).model.links[one.link]
        shapes = link.collisions[one.collision : one.collision + 1]
        name = next((shape.name for shape in shapes if shape.name), "collision")
        return SCOPE_SEPARATOR.join((one.entity, link.name, name))

    def _find_collisions(self, found: ContactPoints, sides: IntArray) -> list[WatchedCollision]:
        """Find the collision of each point on one side of it.

        Args:
            found: The points.
            sides: (n, 2) body and link.
        """
        names = self._find_watched().names
        touched = np.zeros(len(found), dtype=np.intp)
        groups: dict[tuple[int, int], list[int]] = {}
        for row, (body, link) in enumerate(sides.tolist()):
            groups.setdefault((body, link), []).append(row)
        for (body, link), rows in groups.items():
            touched[rows] = self._find_touched(names[body], link, found.points[rows, :3])
        return [
            WatchedCollision(names[body], link, collision)
            for (body, link), collision in zip(sides.tolist(), touched.tolist(), strict=True)
        ]

    def _find_touched(self, name: str, link: int, points: FloatArray) -> IntArray:
        world = self._world
        model = world.entities.find(name).model
        if len(model.links[link].collisions) <= 1:
            return np.zeros(len(points), dtype=np.intp)
        index, states = world.entities.index, world.states()
        base = states.base[index.row[name], :7][None]
        positions = states.joint_positions[index.joints_of(name)][None]
        pose = compute_link_poses(model, base, positions)[model.links[link].name][0]
        local = transform_points(invert(pose), points)
        return find_touched_collisions(model.links[link], local, self._meshes)

    def _add_events(self, own: Sequence[WatchedCollision], others: Sequence[str]) -> None:
        """Add an event for each sensor that touches something and did not before."""
        clock = self._world.clock
        touched = dict(zip(reversed(own), reversed(others), strict=True))
        before = self._touching if clock.epoch == self._epoch else frozenset()
        touching = set()
        for key, collisions in self._find_watched().sensors.items() if touched else ():
            other = next((touched[one] for one in touched if one in collisions), None)
            if other is None:
                continue
            touching.add(key)
            if key not in before:
                entity, sensor = key
                clock.add_event(
                    "touched", entity=entity, message=f"sensor '{sensor}' touches '{other}'"
                )
        self._touching, self._epoch = frozenset(touching), clock.epoch
