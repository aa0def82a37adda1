"""Scenes of COLLADA and GLB files, read by trimesh: geometries placed, joined and in metres."""

from __future__ import annotations

import logging
from io import BytesIO
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from lxml import etree

from zensim.sim_server.description.meshes.collada_check import (
    MAX_GEOMETRY_INSTANCES,
    TooManyInstances,
    check_collada_instances,
)
from zensim.sim_server.description.meshes.glb_check import GltfError, check_glb_header
from zensim.sim_server.description.meshes.mesh_triangles import (
    PLAIN,
    Appearance,
    FindFile,
    MeshMaterial,
    Triangles,
    mesh_error,
)
from zensim.sim_server.description.meshes.named_files import FileFinder
from zensim.sim_server.description.meshes.textures import OPAQUE, WHITE

if TYPE_CHECKING:
    from collections.abc import Sequence

    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from zensim.proto.messages.model_messages import Quat


def read_dae_file(name: str, data: bytes, find_file: FindFile) -> Triangles:
    """Read a COLLADA file; `find_file` finds the images that it names."""
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or b"\0" in data[:200]:
        raise mesh_error(name, "declares a document type or is not UTF-8", slug="mesh.doctype")
    try:
        check_collada_instances(data)
    except etree.XMLSyntaxError as error:
        raise mesh_error(name, "is not well-formed XML", slug="mesh.unreadable") from error
    except TooManyInstances as error:
        fault = (
            f"has more than {MAX_GEOMETRY_INSTANCES} geometries or contains itself; "
            "export it without instances"
        )
        raise mesh_error(name, fault, slug="mesh.triangles") from error
    return _load_with_trimesh(name, data, "dae", find_file)


def read_glb_file(name: str, data: bytes, find_file: FindFile) -> Triangles:
    """Read a GLB file; `find_file` finds the images that it names."""
    try:
        check_glb_header(data)
    except GltfError as error:
        raise mesh_error(name, f"cannot be read: {error}", slug="mesh.unreadable") from error
    return _load_with_trimesh(name, data, "glb", find_file)


def _load_with_trimesh(name: str, data: bytes, kind: str, find_file: FindFile) -> Triangles:
    import trimesh

    # It logs tracebacks for textures that are not here.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    finder = FileFinder(name, find_file)
    try:
        scene = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=finder)
        parts = [_place_geometry(scene, node) for node in scene.graph.nodes_geometry]
    except MemoryError:
        raise
    # Parsers of trimesh raise any exception for invalid files.
    except Exception as error:
        fault = f"cannot be read: {type(error).__name__} {str(error)[:120]}"
        raise mesh_error(name, fault, slug="mesh.unreadable") from error
    return _join_geometries(
        [part for part in parts if part is not None], _find_unit_m(scene), tuple(finder.missing)
    )


class _PlacedGeometry(NamedTuple):
    """A geometry of a scene in the frame of the scene."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: MeshMaterial
    coordinates: NDArray[np.float32]


def _place_geometry(scene: trimesh.Scene, node: str) -> _PlacedGeometry | None:
    import trimesh

    matrix, name = scene.graph[node]
    part = scene.geometry[name]
    if not isinstance(part, trimesh.Trimesh):
        return None
    faces = np.asarray(part.faces, dtype=np.int64)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    vertices = np.asarray(part.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    material, points = _read_visual(part.visual)
    coordinates = (
        np.zeros((len(faces), 3, 2), np.float32)
        if points is None or len(points) != len(vertices)
        else points[faces].astype(np.float32)
    )
    if points is None or not np.isfinite(coordinates).all():
        return _PlacedGeometry(
            vertices, faces, material._replace(image=b""), np.zeros((len(faces), 3, 2), np.float32)
        )
    return _PlacedGeometry(vertices, faces, material, coordinates)


def _read_visual(
    visual: trimesh.visual.ColorVisuals | trimesh.visual.TextureVisuals | None,
) -> tuple[MeshMaterial, NDArray[Any] | None]:
    """Read material and texture coordinates; colours of vertices become their mean."""
    import trimesh

    if not isinstance(visual, trimesh.visual.TextureVisuals):
        if visual is None or not visual.defined:
            return PLAIN, None
        return MeshMaterial(_to_rgba(visual.main_color)), None
    material = visual.material
    colour = getattr(material, "baseColorFactor", None)
    image = getattr(material, "baseColorTexture", None)
    # The image is not decoded here.
    data = image.fp.getvalue() if image is not None else b""
    points = visual.uv[:, :2] if data and visual.uv is not None else None
    return MeshMaterial(WHITE if colour is None else _to_rgba(colour), data), points


def _to_rgba(colour: ArrayLike) -> Quat:
    """Convert a colour of trimesh, in bytes or from 0 to 1; an invisible one becomes opaque."""
    values = np.asarray(colour).reshape(-1)[:4]
    scaled = values / OPAQUE if values.dtype.kind in "iu" else values.astype(float)
    red, green, blue, alpha = np.clip(np.append(scaled, 1.0)[:4], 0.0, 1.0).tolist()
    return (red, green, blue, alpha or 1.0)


def _join_geometries(
    parts: Sequence[_PlacedGeometry], unit_m: float, missing: tuple[str, ...]
) -> Triangles:
    if not parts:
        return Triangles(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + at for part, at in zip(parts, starts, strict=False)]
    number: dict[MeshMaterial, int] = {}
    material_of = [
        np.full(len(part.faces), number.setdefault(part.material, len(number))) for part in parts
    ]
    looks = Appearance(
        tuple(number),
        np.concatenate(material_of),
        np.concatenate([part.coordinates for part in parts]),
        missing,
    )
    vertices = np.concatenate([part.vertices for part in parts]) * unit_m
    return Triangles(vertices, np.concatenate(faces), looks if set(number) != {PLAIN} else None)


def _find_unit_m(scene: trimesh.Scene) -> float:
    written = str(scene.units).partition(" * meters")
    try:
        return float(written[0]) if written[1] else 1.0
    except ValueError:
        return 1.0
