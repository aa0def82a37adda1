"""What Foxglove's 3D panel draws of the entities of a world, as messages. Pure."""

from collections.abc import Iterator, Mapping
from typing import Final

import msgspec

from zensim.foxglove.scene_messages import (
    Color,
    CubePrimitive,
    CylinderPrimitive,
    KeyValuePair,
    ModelPrimitive,
    SceneEntity,
    SceneEntityDeletion,
    SceneUpdate,
    SpherePrimitive,
)
from zensim.proto.messages.model_messages import MOVABLE_KINDS, Link, Model, Origin, Quat, Shape
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion, Vector3
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.rigid_transforms import compose
from zensim.proto.tf_joints import list_hidden_joints

WORLD_FRAME: Final = "world"
DEFAULT_RGBA: Final[Quat] = (0.72, 0.74, 0.77, 1.0)
"""Colour of shapes without a colour."""
MESH_URL: Final = "package://zensim/meshes/{}.stl"
"""URL of a mesh of the server, by its sha256."""
GROUND_M: Final = 100.0
GROUND_THICKNESS_M: Final = 0.01
GROUND_RGBA: Final[Quat] = (0.86, 0.87, 0.88, 1.0)


class FramedShapes(msgspec.Struct, frozen=True):
    """Shapes that move with a frame."""

    frame: str
    shapes: tuple[tuple[Origin, Shape], ...]


def make_scene(models: GetModelsResponse, poses: Mapping[str, Pose]) -> dict[str, SceneEntity]:
    """Make the entities of a world, by their ids.

    A robot with an agent has an entity for each frame in tf.

    Args:
        models: Of the server.
        poses: Of others, in the world, by name; those that are missing are where they began.
    """
    of_model = [_group_shapes(model) for model in models.models]
    fixed = [_place_all_shapes(model) for model in models.models]
    found: dict[str, SceneEntity] = {}
    for entity in models.entities:
        if entity.agent and entity.namespace:
            groups = of_model[entity.model]
        else:
            groups = (FramedShapes("", fixed[entity.model]),)
        root = _to_origin(poses.get(entity.entity, entity.initial_pose))
        for one in _make_entities(entity, groups, root):
            found[one.id] = one
    return found


def update_scene(before: Mapping[str, SceneEntity], now: Mapping[str, SceneEntity]) -> SceneUpdate:
    """Find what changed."""
    deletions = tuple(SceneEntityDeletion(id=name) for name in before if name not in now)
    entities = tuple(one for name, one in now.items() if before.get(name) != one)
    return SceneUpdate(deletions, entities)


def whole_scene(now: Mapping[str, SceneEntity]) -> SceneUpdate:
    """Make the message for a new subscriber, which may have drawn another world."""
    return SceneUpdate((SceneEntityDeletion(type=1),), tuple(now.values()))


def _make_entities(
    entity: EntityModel, groups: tuple[FramedShapes, ...], root: Origin
) -> Iterator[SceneEntity]:
    facts = (KeyValuePair("entity", entity.entity), KeyValuePair("namespace", entity.namespace))
    for group in groups:
        if not group.shapes:
            continue
        name = f"{entity.entity}/{group.frame}" if group.frame else entity.entity
        shapes = group.shapes
        frame = f"{entity.namespace}/{group.frame}"
        if not group.frame:
            frame = WORLD_FRAME
            shapes = tuple((compose(root, origin), shape) for origin, shape in shapes)
        yield _draw(SceneEntity(frame_id=frame, id=name, frame_locked=True, metadata=facts), shapes)


def _draw(entity: SceneEntity, shapes: tuple[tuple[Origin, Shape], ...]) -> SceneEntity:
    of_kind: dict[str, list[tuple[Origin, Shape]]] = {}
    for origin, shape in shapes:
        of_kind.setdefault(shape.kind, []).append((origin, shape))
    boxes = [_draw_box(*one) for one in of_kind.get("box", ())]
    grounds = [_draw_ground(*one) for one in of_kind.get("plane", ())]
    spheres = [_draw_sphere(*one) for one in of_kind.get("sphere", ())]
    capsules = of_kind.get("capsule", [])
    ends = [end for one in capsules for end in _draw_capsule_ends(*one)]
    cylinders = [_draw_cylinder(*one) for one in (*of_kind.get("cylinder", ()), *capsules)]
    meshes = [_draw_mesh(*one) for one in of_kind.get("mesh", ())]
    return msgspec.structs.replace(
        entity,
        cubes=(*boxes, *grounds),
        spheres=(*spheres, *ends),
        cylinders=tuple(cylinders),
        models=tuple(meshes),
    )


def _draw_box(origin: Origin, shape: Shape) -> CubePrimitive:
    return CubePrimitive(_to_pose(origin), Vector3(*shape.size), _to_color(shape.rgba))


def _draw_ground(origin: Origin, shape: Shape) -> CubePrimitive:
    """Draw a plane as a flat box below it."""
    below = compose(origin, Origin((0.0, 0.0, -GROUND_THICKNESS_M / 2.0)))
    size = Vector3(GROUND_M, GROUND_M, GROUND_THICKNESS_M)
    return CubePrimitive(_to_pose(below), size, _to_color(shape.rgba or GROUND_RGBA))


def _draw_sphere(origin: Origin, shape: Shape) -> SpherePrimitive:
    diameter = 2.0 * shape.size[0]
    size = Vector3(diameter, diameter, diameter)
    return SpherePrimitive(_to_pose(origin), size, _to_color(shape.rgba))


def _draw_cylinder(origin: Origin, shape: Shape) -> CylinderPrimitive:
    radius, length, _ = shape.size
    size = Vector3(2.0 * radius, 2.0 * radius, length)
    return CylinderPrimitive(_to_pose(origin), size, 1.0, 1.0, _to_color(shape.rgba))


def _draw_capsule_ends(origin: Origin, shape: Shape) -> Iterator[SpherePrimitive]:
    for z in (-shape.size[1] / 2.0, shape.size[1] / 2.0):
        yield _draw_sphere(compose(origin, Origin((0.0, 0.0, z))), shape)


def _draw_mesh(origin: Origin, shape: Shape) -> ModelPrimitive:
    return ModelPrimitive(
        pose=_to_pose(origin),
        scale=Vector3(*shape.size),
        color=_to_color(shape.rgba),
        override_color=True,
        url=MESH_URL.format(shape.mesh),
        media_type="model/stl",
    )


def _group_shapes(model: Model) -> tuple[FramedShapes, ...]:
    """Group the visuals of a model by the frames that they move with in tf."""
    hidden = list_hidden_joints(model)
    frames: dict[str, tuple[str, Origin]] = {}
    shapes: dict[str, list[tuple[Origin, Shape]]] = {}
    joint_of = {joint.child: joint for joint in model.joints}
    for link in model.links:
        joint = joint_of.get(link.name)
        frame, place = link.name, Origin()
        if joint is not None and (joint.name in hidden or joint.kind not in MOVABLE_KINDS):
            frame, outer = frames.get(joint.parent, (joint.parent, Origin()))
            place = compose(outer, joint.origin)
        frames[link.name] = frame, place
        shapes.setdefault(frame, []).extend(_place_shapes(link, place))
    return tuple(FramedShapes(frame, tuple(found)) for frame, found in shapes.items())


def _place_all_shapes(model: Model) -> tuple[tuple[Origin, Shape], ...]:
    """Place the visuals of a model in its root link, with joints at zero."""
    joint_of = {joint.child: joint for joint in model.joints}
    places: dict[str, Origin] = {}
    found: list[tuple[Origin, Shape]] = []
    for link in model.links:
        joint = joint_of.get(link.name)
        outer = Origin() if joint is None else places.get(joint.parent, Origin())
        places[link.name] = outer if joint is None else compose(outer, joint.origin)
        found += _place_shapes(link, places[link.name])
    return tuple(found)


def _place_shapes(link: Link, place: Origin) -> Iterator[tuple[Origin, Shape]]:
    for shape in link.visuals or link.collisions:
        yield compose(place, shape.origin), shape


def _to_pose(origin: Origin) -> Pose:
    return Pose(Point(*origin.position), Quaternion(*origin.orientation))


def _to_origin(pose: Pose) -> Origin:
    at, turn = pose.position, pose.orientation
    return Origin((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))


def _to_color(rgba: Quat | None) -> Color:
    return Color(*(rgba or DEFAULT_RGBA))
