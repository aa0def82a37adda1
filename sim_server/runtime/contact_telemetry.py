"""Contacts of the collisions that contact sensors watch: their message, and events of touching."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.sensor_messages import ContactSensor
from zensim.proto.se3 import FloatArray, invert, transform_points
from zensim.sim_server.physics.engine import ContactPoints, IntArray
from zensim.sim_server.queries.frame_queries import SCOPE_SEPARATOR
from zensim.sim_server.scene.convex_shapes import MeshVertices
from zensim.sim_server.scene.touched_collisions import find_touched_collisions
from zensim.sim_server.world.entity import Entity, EntityIndex
from zensim.sim_server.world.simulated_world import SimulatedWorld

GROUND_COLLISION = SCOPE_SEPARATOR.join(("ground_plane", "link", "collision"))
"""Name of the ground in messages: that of Gazebo's model."""


MAX_LINKS = 1 << 20
"""Number above that of the links of any model."""
CollisionIndex = tuple[int, int, int]
"""Row of an entity, index of its link, and of the collision in that link."""


@dataclass(frozen=True)
class WatchedEntities:
    """What contact sensors watch, as long as the entities of the world are the same."""

    index: EntityIndex
    entities: tuple[Entity, ...]
    bodies: tuple[int, ...]
    """Bodies of entities with contact sensors."""
    rows: Mapping[int, int]
    """Rows of all entities, by body."""
    models: tuple[Model, ...]
    """Distinct models of the entities."""
    model_of: IntArray
    """Index of the model of each row."""
    sensors: Mapping[tuple[str, str], frozenset[CollisionIndex]]
    """Watched collisions by entity and sensor."""
    links: IntArray
    """Links with watched collisions; see `_number_links`."""
    collisions: frozenset[CollisionIndex]


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
        (entity.name, sensor.name): frozenset((row, *pair) for pair in settings.collisions)
        for row, entity in enumerate(entities)
        for sensor, settings in list_contact_sensors(entity.model)
    }
    watching = {name for name, _ in sensors}
    collisions = frozenset[CollisionIndex]().union(*sensors.values())
    # By identity: entities of one description share a model, and hashing models is slow.
    models = {id(entity.model): entity.model for entity in entities}
    numbers = {key: number for number, key in enumerate(models)}
    return WatchedEntities(
        index,
        tuple(entities),
        tuple(entity.body for entity in entities if entity.name in watching),
        {entity.body: row for row, entity in enumerate(entities)},
        tuple(models.values()),
        np.array([numbers[id(entity.model)] for entity in entities], dtype=np.intp),
        sensors,
        _number_links(
            np.array([(entities[row].body, link) for row, link, _ in collisions], dtype=np.intp)
        ),
        collisions,
    )


def _number_links(links: IntArray) -> IntArray:
    """Number links (n, 2), bodies and indices of their links, by one number each."""
    pairs = links.reshape(-1, 2)
    return pairs[:, 0] * MAX_LINKS + pairs[:, 1]


class TouchingSensors(NamedTuple):
    """Entities and sensors that touch something, in an epoch."""

    names: frozenset[tuple[str, str]]
    epoch: int


class ContactTelemetry:
    """Reads what contact sensors feel; nothing without such sensors."""

    def __init__(self, world: SimulatedWorld, meshes: MeshVertices) -> None:
        self._world = world
        self._meshes = meshes
        self._watched: WatchedEntities | None = None
        self._touching: frozenset[tuple[str, str]] = frozenset()
        """Entity and sensor, as of the last reading."""
        self._epoch = -1

    def save(self) -> TouchingSensors:
        """Take what touches as of the last reading."""
        return TouchingSensors(self._touching, self._epoch)

    def load(self, saved: TouchingSensors) -> None:
        """Replace what touches."""
        self._touching, self._epoch = saved.names, saved.epoch

    @property
    def has_sensors(self) -> bool:
        """Whether any entity has a contact sensor."""
        return bool(self._find_watched().bodies)

    def read(self) -> Contacts:
        """Read the contacts of the last step; add an event for each sensor that begins to touch."""
        clock, watched = self._world.clock, self._find_watched()
        found, own = self._select_watched(self._world.engine.read_contacts(watched.bodies))
        others = self._name_others(found)
        self._add_events(own, others)
        entities = {row: place for place, row in enumerate(dict.fromkeys(row for row, _, _ in own))}
        collisions = {name: place for place, name in enumerate(dict.fromkeys(others))}
        bodies = [
            (entities[row], link, collision, collisions[other])
            for (row, link, collision), other in zip(own, others, strict=True)
        ]
        names = tuple(watched.index.names[row] for row in entities)
        return Contacts(
            *(clock.epoch, clock.steps, clock.time_ns, names, tuple(collisions)),
            np.array(bodies, dtype="<u4").tobytes(),
            found.points.astype("<f8").tobytes(),
        )

    def _find_watched(self) -> WatchedEntities:
        index = self._world.entities.index
        if self._watched is None or self._watched.index is not index:
            self._watched = find_watched_entities(list(self._world.entities), index)
        return self._watched

    def _select_watched(self, found: ContactPoints) -> tuple[ContactPoints, list[CollisionIndex]]:
        """Select the points on watched collisions."""
        watched = self._find_watched()
        # Most points are those of wheels on the ground.
        is_watched = np.isin(_number_links(found.bodies[:, :2]), watched.links)
        found = found.select(np.flatnonzero(is_watched))
        sides = [(watched.rows[body], link) for body, link in found.bodies[:, :2].tolist()]
        own = self._find_collisions(sides, found.points[:, :3])
        rows = [at for at, one in enumerate(own) if one in watched.collisions]
        return found.select(np.array(rows, dtype=np.intp)), [own[at] for at in rows]

    def _name_others(self, found: ContactPoints) -> list[str]:
        """Name what is on the other side of each point."""
        watched = self._find_watched()
        names = [GROUND_COLLISION] * len(found)
        others = found.bodies[:, 2:].tolist()
        rows = [at for at, (body, _) in enumerate(others) if body in watched.rows]
        sides = [(watched.rows[others[at][0]], others[at][1]) for at in rows]
        for at, one in zip(rows, self._find_collisions(sides, found.points[rows, :3]), strict=True):
            names[at] = self._name_collision(one)
        return names

    def _name_collision(self, one: CollisionIndex) -> str:
        row, link_number, collision = one
        entity = self._find_watched().entities[row]
        link = entity.model.links[link_number]
        shapes = link.collisions[collision : collision + 1]
        name = next((shape.name for shape in shapes if shape.name), "collision")
        return SCOPE_SEPARATOR.join((entity.name, link.name, name))

    def _find_collisions(
        self, sides: Sequence[tuple[int, int]], points: FloatArray
    ) -> list[CollisionIndex]:
        """Find the collision of each point (n, 3) in the world, by row of the entity and link."""
        watched = self._find_watched()
        touched = [0] * len(sides)
        groups: dict[tuple[int, int], list[int]] = {}
        models = watched.model_of.tolist()
        for at, (row, link) in enumerate(sides):
            groups.setdefault((models[row], link), []).append(at)
        for (number, link), places in groups.items():
            model = watched.models[number]
            if len(model.links[link].collisions) > 1:
                rows = np.array([sides[at][0] for at in places], dtype=np.intp)
                local = self._to_link(model, link, rows, points[places])
                found = find_touched_collisions(model.links[link], local, self._meshes)
                for at, collision in zip(places, found.tolist(), strict=True):
                    touched[at] = collision
        return [(*side, collision) for side, collision in zip(sides, touched, strict=True)]

    def _to_link(self, model: Model, link: int, rows: IntArray, points: FloatArray) -> FloatArray:
        """Express points (n, 3) of the world in a link of the entities of some rows (n,)."""
        index, states = self._world.entities.index, self._world.states()
        poses = states.base[rows, :7]
        if link:
            joints = index.joint_start[rows][:, None] + np.arange(len(model.joints), dtype=np.intp)
            # Merged links cost as much as others.
            bare = msgspec.structs.replace(model, frames=())
            found = compute_link_poses(bare, poses, states.joint_positions[joints])
            poses = found[model.links[link].name]
        return transform_points(invert(poses), points)

    def _add_events(self, own: Sequence[CollisionIndex], others: Sequence[str]) -> None:
        """Add an event for each sensor that touches something and did not before."""
        clock = self._world.clock
        touched = dict(zip(reversed(own), reversed(others), strict=True))
        before = self._touching if clock.epoch == self._epoch else frozenset()
        touching = {
            key
            for key, collisions in self._find_watched().sensors.items()
            if not collisions.isdisjoint(touched)
        }
        for entity, sensor in sorted(touching - before):
            collisions = self._find_watched().sensors[entity, sensor]
            other = next(touched[one] for one in touched if one in collisions)
            clock.add_event(
                "touched", entity=entity, message=f"sensor '{sensor}' touches '{other}'"
            )
        self._touching, self._epoch = frozenset(touching), clock.epoch
