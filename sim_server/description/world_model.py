"""The parsed world: models, named poses, light and pace, before anything is spawned."""

import msgspec

from zensim.proto.messages.entity_messages import Bounds
from zensim.proto.messages.model_messages import Model, Origin, ReportEntry, Vec3
from zensim.proto.messages.sensing_messages import Environment, SphericalCoordinates
from zensim.proto.messages.spawn_messages import NamedPose
from zensim.proto.messages.world_messages import Scene


class BoundedPose(msgspec.Struct, frozen=True):
    """A named pose in the world and its bounds; empty bounds are unlimited."""

    pose: NamedPose
    bounds: Bounds = Bounds()


class PhysicsSettings(msgspec.Struct, frozen=True):
    """Settings of <physics>; None: not set."""

    step_s: float | None = None
    real_time_factor: float | None = None


EARTH_GRAVITY: Vec3 = (0.0, 0.0, -9.8)
"""SDF's default gravity [m/s^2]."""
EARTH_MAGNETIC_FIELD: Vec3 = Environment().magnetic_field
"""SDF's default [T]."""


class PlacedModel(msgspec.Struct, frozen=True):
    """A model of a world with a valid entity name and its pose."""

    name: str
    model: Model
    origin: Origin = Origin()


class WorldModel(msgspec.Struct, frozen=True):
    """A world before its models are spawned; journals keep the encoded names of its fields."""

    name: str
    gravity: Vec3 = EARTH_GRAVITY
    ground_plane: bool = False
    ground_friction: float = 1.0
    physics: PhysicsSettings = msgspec.field(default=PhysicsSettings(), name="pace")
    models: tuple[PlacedModel, ...] = ()
    scene: Scene = Scene()
    named_poses: tuple[BoundedPose, ...] = msgspec.field(default=(), name="places")
    report: tuple[ReportEntry, ...] = ()
    magnetic_field: Vec3 = EARTH_MAGNETIC_FIELD
    """[T], in the world."""
    spherical_coordinates: SphericalCoordinates | None = None
