"""Visual templates of models, triangle meshes and textures. NumPy only."""

from collections.abc import Container, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.proto.forward_kinematics import compute_chain_poses
from zensim.proto.messages.model_messages import (
    JointKind,
    Light,
    Link,
    Model,
    Origin,
    Quat,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import normalize
from zensim.proto.se3 import from_origin, transform_points

Vertices = NDArray[np.float64]
Faces = NDArray[np.uint32]
HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
Array = NDArray[np.float64]
DEFAULT_RGBA: Final[Quat] = (0.72, 0.74, 0.77, 1.0)
"""Colour of visuals without a colour."""
WHITE: Final[Quat] = (1.0, 1.0, 1.0, 1.0)
SMOOTH_KINDS: Final = frozenset({"sphere", "capsule"})
CIRCLE_SEGMENTS: Final = 32
"""Corners of a circle."""
HEMISPHERE_RINGS: Final = 8
"""Rings from the equator to a pole."""


class TriangleMesh(msgspec.Struct, frozen=True, eq=False):
    """Triangles, counter-clockwise seen from outside."""

    vertices: Vertices
    """(v, 3) [m]."""
    faces: Faces
    """(f, 3), indices of shared vertices."""
    coordinates: NDArray[np.float32] | None = None
    """(v, 2) of a texture, u to the right and v upward; None without a texture."""
    image: bytes = b""
    """PNG or JPEG; empty without a texture."""


TriangleMeshes = Mapping[str, TriangleMesh]
"""Meshes by `find_mesh_name`."""
NO_MESHES: Final[TriangleMeshes] = MappingProxyType({})


def find_mesh_name(shape: Shape) -> str:
    """Find the name of the mesh of a shape: its sha256, or those of mesh and texture."""
    texture = shape.texture
    return f"{shape.mesh}/{texture.image}/{texture.coordinates}" if texture else shape.mesh


def make_textured_mesh(
    corners: NDArray[np.float32], coordinates: NDArray[np.float32], image: bytes
) -> TriangleMesh:
    """Make a mesh of triangle corners (3 f, 3), their texture coordinates (3 f, 2) and an image."""
    faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    return TriangleMesh(corners.astype(np.float64), faces, coordinates, image)


def weld_triangles(corners: NDArray[np.float32]) -> TriangleMesh:
    """Make a mesh of triangle corners (3 f, 3); equal corners become one vertex."""
    # Adding 0.0 removes the sign of -0.0.
    bits = np.ascontiguousarray(corners + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    mixed = (bits[:, 0] * HASH_MULTIPLIER + bits[:, 1]) * HASH_MULTIPLIER + bits[:, 2]
    _, first, indices = np.unique(mixed, return_index=True, return_inverse=True)
    faces = indices.reshape(-1, 3).astype(np.uint32)
    return TriangleMesh(corners[first].astype(np.float64), faces)


class VisualJoint(msgspec.Struct, frozen=True):
    """Joint of a child link; the axis is a unit vector in the child frame."""

    kind: JointKind
    parent: int
    """Index of the parent link, lower than that of the child."""
    origin: Origin
    axis: Vec3


def find_link_poses(
    visual_joints: Sequence[VisualJoint], base: Array, joint_positions: Array
) -> list[Array]:
    """Compute the poses (k, 7) of every link of k entities in the world frame.

    Args:
        visual_joints: Parents before children.
        base: Poses (k, 7) of the root links.
        joint_positions: (k, joints) [rad or m].
    """
    joints = ((joint.parent, joint) for joint in visual_joints)
    return compute_chain_poses(joints, base, joint_positions)


class NotATree(Exception):
    """The links of a model are not in tree order, or not connected."""


class VisualTemplate(msgspec.Struct, frozen=True):
    """Shapes and joints of a model without names; equal for robots of equal appearance."""

    links: tuple[tuple[Shape, ...], ...]
    """Visible shapes of every link, the base first."""
    visual_joints: tuple[VisualJoint, ...]
    """`visual_joints[i]` moves `links[i + 1]`."""
    lights: tuple[tuple[Light, ...], ...] = ()
    """Lights of every link; empty if there are none."""


def make_template(model: Model, meshes: Container[str] = ()) -> VisualTemplate:
    """Make the template of a model.

    Args:
        model: Links in tree order.
        meshes: The names of the available meshes.

    Raises:
        NotATree: The links are not in tree order, or not connected.
    """
    index = {link.name: number for number, link in enumerate(model.links)}
    children = tuple(joint.child for joint in model.joints)
    if not model.links or children != tuple(link.name for link in model.links[1:]):
        raise NotATree(f"model '{model.name}': joints and links differ in order")
    joints = []
    for number, joint in enumerate(model.joints):
        parent = index.get(joint.parent, len(index))
        if parent > number:
            raise NotATree(
                f"model '{model.name}': joint '{joint.name}' has no parent before its child"
            )
        joints.append(VisualJoint(joint.kind, parent, joint.origin, normalize(joint.axis)))
    lights = tuple(link.lights for link in model.links)
    # An invisible wall is wanted; an invisible robot has only been described to this point.
    is_bare = not (model.is_static or any(link.visuals for link in model.links))
    return VisualTemplate(
        tuple(
            _keep_drawable(link.collisions, meshes) if is_bare else _visible_shapes(link, meshes)
            for link in model.links
        ),
        tuple(joints),
        lights if any(lights) else (),
    )


def _visible_shapes(link: Link, meshes: Container[str]) -> tuple[Shape, ...]:
    """Select the drawable visuals, or the collisions if no visual is drawable."""
    shapes = _keep_drawable(link.visuals, meshes)
    return shapes if shapes or not link.visuals else _keep_drawable(link.collisions, meshes)


def _keep_drawable(shapes: tuple[Shape, ...], meshes: Container[str]) -> tuple[Shape, ...]:
    """Select shapes other than planes; meshes and textures only if available."""
    drawn = (
        msgspec.structs.replace(shape, texture=None)
        if shape.texture is not None and find_mesh_name(shape) not in meshes
        else shape
        for shape in shapes
    )
    return tuple(
        shape
        for shape in drawn
        if shape.kind != "plane" and (shape.kind != "mesh" or find_mesh_name(shape) in meshes)
    )


class ColouredMesh(msgspec.Struct, frozen=True, eq=False):
    """All shapes of one link with one colour, in the link frame."""

    mesh: TriangleMesh
    rgba: Quat
    is_smooth: bool
    """Whether all shapes are round, without edges."""
    has_file: bool
    """Whether a shape comes from a file, whose faces may be inside out."""


def make_link_meshes(
    shapes: Sequence[Shape], meshes: TriangleMeshes = NO_MESHES
) -> list[ColouredMesh]:
    """Merge the shapes of a link by colour and image; `meshes` must have all named meshes."""
    by_look: dict[tuple[Quat, str], list[Shape]] = {}
    for shape in shapes:
        image = shape.texture.image if shape.texture else ""
        colour = shape.rgba or (WHITE if image else DEFAULT_RGBA)
        by_look.setdefault((colour, image), []).append(shape)
    return [
        ColouredMesh(
            merge_meshes(_transform_shape(shape, meshes) for shape in group),
            rgba,
            is_smooth=all(shape.kind in SMOOTH_KINDS for shape in group),
            has_file=any(shape.kind == "mesh" for shape in group),
        )
        for (rgba, _), group in by_look.items()
    ]


def make_shape_mesh(shape: Shape) -> TriangleMesh:
    """Triangulate a box, sphere, cylinder or capsule about its own origin.

    Raises:
        ValueError: The kind is mesh or plane.
    """
    first, second, third = shape.size
    if shape.kind == "box":
        return make_box(first, second, third)
    if shape.kind == "sphere":
        return make_capsule(first, 0.0)
    if shape.kind == "cylinder":
        return make_cylinder(first, second)
    if shape.kind == "capsule":
        return make_capsule(first, second)
    raise ValueError(f"kind must be box, sphere, cylinder or capsule; got {shape.kind!r}")


def make_box(x: float, y: float, z: float) -> TriangleMesh:
    """Triangulate a box of these extents [m]."""
    square = np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2.0
    sides = _make_tube([_raise_outline(square, -z / 2.0), _raise_outline(square, z / 2.0)])
    ends = _to_faces([(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)])
    return TriangleMesh(sides.vertices, np.concatenate((sides.faces, ends)))


def make_cylinder(radius: float, length: float) -> TriangleMesh:
    """Triangulate a cylinder along z [m]."""
    rim = _make_circle() * radius
    side = _make_tube([_raise_outline(rim, -length / 2.0), _raise_outline(rim, length / 2.0)])
    return _close_tube(side, length / 2.0)


def make_capsule(radius: float, length: float) -> TriangleMesh:
    """Triangulate a cylinder [m] along z with hemispheres at its ends; length 0 = sphere."""
    angles = np.linspace(0.0, np.pi / 2.0, HEMISPHERE_RINGS + 1)[:-1]
    upper = [
        _raise_outline(
            _make_circle() * radius * np.cos(angle), length / 2.0 + radius * np.sin(angle)
        )
        for angle in angles
    ]
    lower = [ring * (1.0, 1.0, -1.0) for ring in reversed(upper)]
    tube = _make_tube([*(lower if length > 0.0 else lower[:-1]), *upper])
    return _close_tube(tube, length / 2.0 + radius)


def scale_mesh(mesh: TriangleMesh, scale: Vec3) -> TriangleMesh:
    """Scale a mesh along its axes; faces are flipped if the scale mirrors the mesh."""
    is_mirrored = np.prod(scale) < 0.0
    faces = mesh.faces[:, ::-1] if is_mirrored else mesh.faces
    return TriangleMesh(mesh.vertices * np.asarray(scale), faces, mesh.coordinates, mesh.image)


def merge_meshes(meshes: Iterable[TriangleMesh]) -> TriangleMesh:
    """Merge meshes into one; all have the image of the first, or none has one."""
    vertices: list[Vertices] = []
    faces: list[Faces] = []
    coordinates: list[NDArray[np.float32]] = []
    image, count = b"", 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + np.uint32(count))
        count += len(mesh.vertices)
        image = image or mesh.image
        coordinates += [] if mesh.coordinates is None else [mesh.coordinates]
    return TriangleMesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        np.concatenate(coordinates) if image else None,
        image,
    )


def _transform_shape(shape: Shape, meshes: TriangleMeshes) -> TriangleMesh:
    mesh = (
        scale_mesh(meshes[find_mesh_name(shape)], shape.size)
        if shape.kind == "mesh"
        else make_shape_mesh(shape)
    )
    vertices = transform_points(from_origin(shape.origin), mesh.vertices)
    return TriangleMesh(vertices, mesh.faces, mesh.coordinates, mesh.image)


def _make_circle() -> Vertices:
    angles = np.linspace(0.0, 2.0 * np.pi, CIRCLE_SEGMENTS, endpoint=False)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


def _raise_outline(outline: Vertices, z: float) -> Vertices:
    return np.column_stack((outline, np.full(len(outline), z)))


def _make_tube(rings: list[Vertices]) -> TriangleMesh:
    """Join rings with equal numbers of corners, lowest first, to an open surface."""
    around, faces = len(rings[0]), []
    for start in range(0, around * (len(rings) - 1), around):
        for i in range(around):
            low, next_low = start + i, start + (i + 1) % around
            faces += [(low, next_low, next_low + around), (low, next_low + around, low + around)]
    return TriangleMesh(np.concatenate(rings), _to_faces(faces))


def _close_tube(tube: TriangleMesh, half: float) -> TriangleMesh:
    """Close both ends of a round tube with fans around the axis points at -half and half."""
    south, north = len(tube.vertices), len(tube.vertices) + 1
    last = south - CIRCLE_SEGMENTS
    ends = [(south, (i + 1) % CIRCLE_SEGMENTS, i) for i in range(CIRCLE_SEGMENTS)]
    ends += [(north, last + i, last + (i + 1) % CIRCLE_SEGMENTS) for i in range(CIRCLE_SEGMENTS)]
    poles = np.array([(0.0, 0.0, -half), (0.0, 0.0, half)])
    return TriangleMesh(
        np.concatenate((tube.vertices, poles)), np.concatenate((tube.faces, _to_faces(ends)))
    )


def _to_faces(triples: Iterable[tuple[int, int, int]]) -> Faces:
    return np.array(list(triples), dtype=np.uint32)
