"""Messages that Foxglove's 3D panel draws: the ROS 2 forms of foxglove.SceneUpdate.

Source: package foxglove_msgs; fields that are not used here have their type and no default of ours.
"""

from typing import ClassVar

import msgspec

from zensim.proto.messages.scalar_types import UInt8, UInt32
from zensim.proto.messages.standard_messages import Duration, Point, Pose, Time, Vector3


class Color(msgspec.Struct, frozen=True):
    """Red, green, blue and alpha, 0 to 1."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/Color"

    r: float = 0.0
    g: float = 0.0
    b: float = 0.0
    a: float = 1.0


class KeyValuePair(msgspec.Struct, frozen=True):
    """An entry of metadata."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/KeyValuePair"

    key: str = ""
    value: str = ""


class ArrowPrimitive(msgspec.Struct, frozen=True):
    """An arrow along x [m]."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/ArrowPrimitive"

    pose: Pose = Pose()
    shaft_length: float = 0.0
    shaft_diameter: float = 0.0
    head_length: float = 0.0
    head_diameter: float = 0.0
    color: Color = Color()


class CubePrimitive(msgspec.Struct, frozen=True):
    """A box; its size is full extents [m]."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/CubePrimitive"

    pose: Pose = Pose()
    size: Vector3 = Vector3()
    color: Color = Color()


class SpherePrimitive(msgspec.Struct, frozen=True):
    """An ellipsoid; its size is diameters [m]."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/SpherePrimitive"

    pose: Pose = Pose()
    size: Vector3 = Vector3()
    color: Color = Color()


class CylinderPrimitive(msgspec.Struct, frozen=True):
    """A cylinder along z; its size is diameters and length [m]."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/CylinderPrimitive"

    pose: Pose = Pose()
    size: Vector3 = Vector3()
    bottom_scale: float = 1.0
    top_scale: float = 1.0
    color: Color = Color()


class LinePrimitive(msgspec.Struct, frozen=True):
    """A chain of lines."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/LinePrimitive"

    type: UInt8 = 0
    pose: Pose = Pose()
    thickness: float = 0.0
    scale_invariant: bool = False
    points: tuple[Point, ...] = ()
    color: Color = Color()
    colors: tuple[Color, ...] = ()
    indices: tuple[UInt32, ...] = ()


class TriangleListPrimitive(msgspec.Struct, frozen=True):
    """Triangles."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/TriangleListPrimitive"

    pose: Pose = Pose()
    points: tuple[Point, ...] = ()
    color: Color = Color()
    colors: tuple[Color, ...] = ()
    indices: tuple[UInt32, ...] = ()


class TextPrimitive(msgspec.Struct, frozen=True):
    """A text."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/TextPrimitive"

    pose: Pose = Pose()
    billboard: bool = False
    font_size: float = 0.0
    scale_invariant: bool = False
    color: Color = Color()
    text: str = ""


class ModelPrimitive(msgspec.Struct, frozen=True):
    """A mesh by its URL."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/ModelPrimitive"

    pose: Pose = Pose()
    scale: Vector3 = Vector3()
    color: Color = Color()
    override_color: bool = False
    url: str = ""
    media_type: str = ""
    data: bytes = b""


class SceneEntityDeletion(msgspec.Struct, frozen=True):
    """Deletes the entity with this id (type 0), or all (type 1)."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/SceneEntityDeletion"

    timestamp: Time = Time()
    type: UInt8 = 0
    id: str = ""


class SceneEntity(msgspec.Struct, frozen=True):
    """Shapes that move with a frame; replaces the entity with the same id."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/SceneEntity"

    timestamp: Time = Time()
    frame_id: str = ""
    id: str = ""
    lifetime: Duration = Duration()
    frame_locked: bool = False
    metadata: tuple[KeyValuePair, ...] = ()
    arrows: tuple[ArrowPrimitive, ...] = ()
    cubes: tuple[CubePrimitive, ...] = ()
    spheres: tuple[SpherePrimitive, ...] = ()
    cylinders: tuple[CylinderPrimitive, ...] = ()
    lines: tuple[LinePrimitive, ...] = ()
    triangles: tuple[TriangleListPrimitive, ...] = ()
    texts: tuple[TextPrimitive, ...] = ()
    models: tuple[ModelPrimitive, ...] = ()


class SceneUpdate(msgspec.Struct, frozen=True):
    """Entities to delete, then entities to add or replace."""

    ros_type: ClassVar[str] = "foxglove_msgs/msg/SceneUpdate"

    deletions: tuple[SceneEntityDeletion, ...] = ()
    entities: tuple[SceneEntity, ...] = ()
