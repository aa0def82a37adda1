"""Shapes to triangles: what is drawn of a link, merged colour by colour. NumPy only."""

from collections.abc import Iterable, Sequence
from typing import Final

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Quat, Shape, Vec3
from zensim.proto.rotation import rotate
from zensim.spawner.viewer.form import Form
from zensim.spawner.viewer.kinematics import link_poses, unit
from zensim.spawner.viewer.triangles import NO_MESHES, Faces, Mesh, Meshes, Vertices

UNCOLOURED: Final[Quat] = (0.72, 0.74, 0.77, 1.0)
"""For a visual whose description names no colour."""
SMOOTH: Final = frozenset({"sphere", "capsule"})
AROUND: Final = 32
"""Corners of a round outline."""
RINGS: Final = 8
"""Rings from the equator to a pole."""


class Part(msgspec.Struct, frozen=True, eq=False):
    """Everything of one link that has one colour, in the link's frame."""

    mesh: Mesh
    rgba: Quat
    is_smooth: bool
    """Whether it has no edges."""
    has_file: bool
    """Whether some of it comes from a file, where any side may be outside."""


def link_parts(shapes: Sequence[Shape], meshes: Meshes = NO_MESHES) -> list[Part]:
    """Merge the shapes of a link by colour; `meshes` has those that are named."""
    by_colour: dict[Quat, list[Shape]] = {}
    for shape in shapes:
        by_colour.setdefault(shape.rgba or UNCOLOURED, []).append(shape)
    return [
        Part(
            merged(_placed(shape, meshes) for shape in alike),
            rgba,
            is_smooth=all(shape.kind in SMOOTH for shape in alike),
            has_file=any(shape.kind == "mesh" for shape in alike),
        )
        for rgba, alike in by_colour.items()
    ]


def shape_mesh(shape: Shape) -> Mesh:
    """Triangulate a box, sphere, cylinder or capsule about its own origin.

    Raises:
        ValueError: The kind has no triangles of its own.
    """
    first, second, third = shape.size
    if shape.kind == "box":
        return box(first, second, third)
    if shape.kind == "sphere":
        return capsule(first, 0.0)
    if shape.kind == "cylinder":
        return cylinder(first, second)
    if shape.kind == "capsule":
        return capsule(first, second)
    raise ValueError(f"shape {shape.kind!r} has no triangles; use box, sphere, cylinder or capsule")


def box(x: float, y: float, z: float) -> Mesh:
    """Triangulate a box of these extents [m]."""
    square = np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2.0
    sides = _tube([_at_height(square, -z / 2.0), _at_height(square, z / 2.0)])
    ends = _faces([(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)])
    return Mesh(sides.vertices, np.concatenate((sides.faces, ends)))


def cylinder(radius: float, length: float) -> Mesh:
    """Triangulate a cylinder along z [m]."""
    rim = _circle() * radius
    side = _tube([_at_height(rim, -length / 2.0), _at_height(rim, length / 2.0)])
    return _closed(side, length / 2.0)


def capsule(radius: float, length: float) -> Mesh:
    """Triangulate a cylinder [m] along z with half a sphere at each end; length 0 is a sphere."""
    angles = np.linspace(0.0, np.pi / 2.0, RINGS + 1)[:-1]
    upper = [
        _at_height(_circle() * radius * np.cos(angle), length / 2.0 + radius * np.sin(angle))
        for angle in angles
    ]
    lower = [ring * (1.0, 1.0, -1.0) for ring in reversed(upper)]
    tube = _tube([*(lower if length > 0.0 else lower[:-1]), *upper])
    return _closed(tube, length / 2.0 + radius)


def scaled(mesh: Mesh, scale: Vec3) -> Mesh:
    """Scale a mesh along its axes; one that is turned inside out by it is turned back."""
    is_mirrored = np.prod(scale) < 0.0
    faces = mesh.faces[:, ::-1] if is_mirrored else mesh.faces
    return Mesh(mesh.vertices * np.asarray(scale), faces)


def merged(meshes: Iterable[Mesh]) -> Mesh:
    """Put meshes into one."""
    vertices: list[Vertices] = []
    faces: list[Faces] = []
    count = 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + np.uint32(count))
        count += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def top_of(form: Form, meshes: Meshes = NO_MESHES) -> float:
    """Find how high a form reaches above its base [m], joints at zero."""
    base = np.array([(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)])
    links = link_poses(form.hinges, base, np.zeros((1, len(form.hinges))))
    heights = [
        float(np.max(rotate(pose.quaternions, part.mesh.vertices)[:, 2] + pose.positions[0, 2]))
        for shapes, pose in zip(form.links, links, strict=True)
        for part in link_parts(shapes, meshes)
    ]
    return max(heights, default=0.0)


def _placed(shape: Shape, meshes: Meshes) -> Mesh:
    mesh = scaled(meshes[shape.mesh], shape.size) if shape.kind == "mesh" else shape_mesh(shape)
    turned = rotate(unit(shape.origin.orientation), mesh.vertices)
    return Mesh(turned + np.asarray(shape.origin.position), mesh.faces)


def _circle() -> Vertices:
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


def _at_height(outline: Vertices, z: float) -> Vertices:
    return np.column_stack((outline, np.full(len(outline), z)))


def _tube(rings: list[Vertices]) -> Mesh:
    """Join rings of as many corners each, lowest first, into an open surface."""
    around, faces = len(rings[0]), []
    for start in range(0, around * (len(rings) - 1), around):
        for i in range(around):
            low, next_low = start + i, start + (i + 1) % around
            faces += [(low, next_low, next_low + around), (low, next_low + around, low + around)]
    return Mesh(np.concatenate(rings), _faces(faces))


def _closed(tube: Mesh, half: float) -> Mesh:
    """Close a round tube below and above by a point on the axis at -half and half."""
    south, north = len(tube.vertices), len(tube.vertices) + 1
    last = south - AROUND
    ends = [(south, (i + 1) % AROUND, i) for i in range(AROUND)]
    ends += [(north, last + i, last + (i + 1) % AROUND) for i in range(AROUND)]
    poles = np.array([(0.0, 0.0, -half), (0.0, 0.0, half)])
    return Mesh(np.concatenate((tube.vertices, poles)), np.concatenate((tube.faces, _faces(ends))))


def _faces(triples: Iterable[tuple[int, int, int]]) -> Faces:
    return np.array(list(triples), dtype=np.uint32)
