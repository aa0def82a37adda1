"""What a model looks like: visual templates, and triangle meshes. NumPy only."""

from collections.abc import Container, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.proto.forward_kinematics import compute_chain_poses
from zensim.proto.messages.model_messages import JointKind, Link, Model, Origin, Quat, Shape, Vec3
from zensim.proto.rigid_transforms import normalize
from zensim.proto.se3 import from_origin, transform_points

Vertices = NDArray[np.float64]
Faces = NDArray[np.uint32]
HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


class TriangleMesh(msgspec.Struct, frozen=True, eq=False):
    """Triangles, counter-clockwise seen from outside."""

    vertices: Vertices
    """(v, 3) [m]."""
    faces: Faces
    """(f, 3), indices of vertices; neighbours share theirs."""


TriangleMeshes = Mapping[str, TriangleMesh]
"""By sha256."""
NO_MESHES: Final[TriangleMeshes] = MappingProxyType({})


def weld_triangles(corners: NDArray[np.float32]) -> TriangleMesh:
    """Make a mesh of loose triangles (3 f, 3) by taking equal corners for one."""
    # Zero has two signs, and one place.
    bits = np.ascontiguousarray(corners + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    mixed = (bits[:, 0] * HASH_MULTIPLIER + bits[:, 1]) * HASH_MULTIPLIER + bits[:, 2]
    _, first, places = np.unique(mixed, return_index=True, return_inverse=True)
    faces = places.reshape(-1, 3).astype(np.uint32)
    return TriangleMesh(corners[first].astype(np.float64), faces)


Array = NDArray[np.float64]


class VisualJoint(msgspec.Struct, frozen=True):
    """How one link moves in another; the axis is a unit vector in the child's frame."""

    kind: JointKind
    parent: int
    """Index of a link that comes before the child."""
    origin: Origin
    axis: Vec3


def find_link_poses(
    visual_joints: Sequence[VisualJoint], base: Array, joint_positions: Array
) -> list[Array]:
    """Find the poses (k, 7) of every link of k entities in the world frame.

    Args:
        visual_joints: Parents before children.
        base: (k, 7) of the root links.
        joint_positions: (k, joints) [rad or m].
    """
    joints = ((joint.parent, joint) for joint in visual_joints)
    return compute_chain_poses(joints, base, joint_positions)


class NotATree(Exception):
    """A model's joints do not put every link under one that comes before it."""


class VisualTemplate(msgspec.Struct, frozen=True):
    """Equal for all robots that look and move alike, whatever their links are called."""

    links: tuple[tuple[Shape, ...], ...]
    """What is drawn of every link, the base first."""
    visual_joints: tuple[VisualJoint, ...]
    """`hinges[i]` moves `links[i + 1]`."""


def make_template(model: Model, meshes: Container[str] = ()) -> VisualTemplate:
    """Strip a model of everything that cannot be seen.

    Args:
        model: What to strip.
        meshes: The sha256 of those that are here.

    Raises:
        NotATree: A joint names a parent that does not come before its child.
    """
    index = {link.name: number for number, link in enumerate(model.links)}
    children = tuple(joint.child for joint in model.joints)
    if not model.links or children != tuple(link.name for link in model.links[1:]):
        raise NotATree(f"model '{model.name}' is no tree: its joints do not move its links in turn")
    hinges = []
    for number, joint in enumerate(model.joints):
        parent = index.get(joint.parent, len(index))
        if parent > number:
            raise NotATree(f"joint '{joint.name}' of '{model.name}' has no parent before it")
        hinges.append(VisualJoint(joint.kind, parent, joint.origin, normalize(joint.axis)))
    return VisualTemplate(
        tuple(_visible_shapes(link, meshes) for link in model.links), tuple(hinges)
    )


def _visible_shapes(link: Link, meshes: Container[str]) -> tuple[Shape, ...]:
    """Visuals that have triangles; collisions stand in for those whose mesh is not here."""
    shapes = _keep_drawable(link.visuals, meshes)
    return shapes if shapes or not link.visuals else _keep_drawable(link.collisions, ())


def _keep_drawable(shapes: tuple[Shape, ...], meshes: Container[str]) -> tuple[Shape, ...]:
    """The page draws the ground itself."""
    return tuple(
        shape
        for shape in shapes
        if shape.kind != "plane" and (shape.kind != "mesh" or shape.mesh in meshes)
    )


DEFAULT_RGBA: Final[Quat] = (0.72, 0.74, 0.77, 1.0)
"""For a visual whose description names no colour."""
SMOOTH_KINDS: Final = frozenset({"sphere", "capsule"})
CIRCLE_SEGMENTS: Final = 32
"""Corners of a round outline."""
HEMISPHERE_RINGS: Final = 8
"""Rings from the equator to a pole."""


class ColouredMesh(msgspec.Struct, frozen=True, eq=False):
    """Everything of one link that has one colour, in the link's frame."""

    mesh: TriangleMesh
    rgba: Quat
    is_smooth: bool
    """Whether it has no edges."""
    has_file: bool
    """Whether some of it comes from a file, where any side may be outside."""


def make_link_meshes(
    shapes: Sequence[Shape], meshes: TriangleMeshes = NO_MESHES
) -> list[ColouredMesh]:
    """Merge the shapes of a link by colour; `meshes` has those that are named."""
    by_colour: dict[Quat, list[Shape]] = {}
    for shape in shapes:
        by_colour.setdefault(shape.rgba or DEFAULT_RGBA, []).append(shape)
    return [
        ColouredMesh(
            merge_meshes(_transform_shape(shape, meshes) for shape in alike),
            rgba,
            is_smooth=all(shape.kind in SMOOTH_KINDS for shape in alike),
            has_file=any(shape.kind == "mesh" for shape in alike),
        )
        for rgba, alike in by_colour.items()
    ]


def make_shape_mesh(shape: Shape) -> TriangleMesh:
    """Triangulate a box, sphere, cylinder or capsule about its own origin.

    Raises:
        ValueError: The kind has no triangles of its own.
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
    raise ValueError(f"shape {shape.kind!r} has no triangles; use box, sphere, cylinder or capsule")


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
    """Triangulate a cylinder [m] along z with half a sphere at each end; length 0 is a sphere."""
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
    """Scale a mesh along its axes; one that is turned inside out by it is turned back."""
    is_mirrored = np.prod(scale) < 0.0
    faces = mesh.faces[:, ::-1] if is_mirrored else mesh.faces
    return TriangleMesh(mesh.vertices * np.asarray(scale), faces)


def merge_meshes(meshes: Iterable[TriangleMesh]) -> TriangleMesh:
    """Put meshes into one."""
    vertices: list[Vertices] = []
    faces: list[Faces] = []
    count = 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + np.uint32(count))
        count += len(mesh.vertices)
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def find_top(form: VisualTemplate, meshes: TriangleMeshes = NO_MESHES) -> float:
    """Find how high a form reaches above its base [m], joints at zero."""
    base = np.array([(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)])
    links = find_link_poses(form.visual_joints, base, np.zeros((1, len(form.visual_joints))))
    heights = [
        float(np.max(transform_points(pose, part.mesh.vertices)[:, 2]))
        for shapes, pose in zip(form.links, links, strict=True)
        for part in make_link_meshes(shapes, meshes)
    ]
    return max(heights, default=0.0)


def _transform_shape(shape: Shape, meshes: TriangleMeshes) -> TriangleMesh:
    mesh = (
        scale_mesh(meshes[shape.mesh], shape.size)
        if shape.kind == "mesh"
        else make_shape_mesh(shape)
    )
    return TriangleMesh(transform_points(from_origin(shape.origin), mesh.vertices), mesh.faces)


def _make_circle() -> Vertices:
    angles = np.linspace(0.0, 2.0 * np.pi, CIRCLE_SEGMENTS, endpoint=False)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


def _raise_outline(outline: Vertices, z: float) -> Vertices:
    return np.column_stack((outline, np.full(len(outline), z)))


def _make_tube(rings: list[Vertices]) -> TriangleMesh:
    """Join rings of as many corners each, lowest first, into an open surface."""
    around, faces = len(rings[0]), []
    for start in range(0, around * (len(rings) - 1), around):
        for i in range(around):
            low, next_low = start + i, start + (i + 1) % around
            faces += [(low, next_low, next_low + around), (low, next_low + around, low + around)]
    return TriangleMesh(np.concatenate(rings), _to_faces(faces))


def _close_tube(tube: TriangleMesh, half: float) -> TriangleMesh:
    """Close a round tube below and above by a point on the axis at -half and half."""
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
