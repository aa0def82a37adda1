"""Meshes of OBJ files with the materials that they name."""

from __future__ import annotations

import numpy as np

from zensim.proto.messages.asset_messages import list_references
from zensim.sim_server.description.meshes.mesh_triangles import (
    MAX_TRIANGLES,
    PLAIN,
    Appearance,
    FindFile,
    MeshMaterial,
    Triangles,
    mesh_error,
)
from zensim.sim_server.description.meshes.named_files import FileFinder
from zensim.sim_server.description.meshes.obj_reader import ObjContent, ObjSyntaxError, read_obj
from zensim.sim_server.description.meshes.textures import WHITE, ObjMaterial, read_obj_materials
from zensim.sim_server.description.strict_parsing import quote


def read_obj_file(name: str, data: bytes, find_file: FindFile) -> Triangles:
    """Read an OBJ file; `find_file` finds its materials and their images."""
    try:
        content = read_obj(data, MAX_TRIANGLES)
    except ObjSyntaxError as error:
        what = quote(error.line.decode(errors="replace"))
        raise mesh_error(name, f"has an invalid line: {what}", slug="mesh.unreadable") from error
    looks = _make_obj_appearance(name, data, content, find_file) if content.names else None
    return Triangles(content.corners, content.faces, looks)


def _make_obj_appearance(
    name: str, data: bytes, content: ObjContent, find_file: FindFile
) -> Appearance:
    finder = FileFinder(name, find_file)
    written: dict[str, tuple[str, ObjMaterial]] = {}
    for reference in list_references("a.obj", data):
        uri, text = finder.find(reference)
        written |= {key: (uri, one) for key, one in read_obj_materials(text).items()}
    materials = [PLAIN]
    for key in content.names:
        uri, material = written.get(key, ("", ObjMaterial(WHITE)))
        image = finder.find(material.image, uri)[1] if material.image else b""
        materials.append(MeshMaterial(material.rgba, image) if key in written else PLAIN)
    is_mapped = (content.images >= 0).all(axis=1) & (content.images < len(content.points)).all(
        axis=1
    )
    coordinates = np.zeros((len(content.faces), 3, 2), np.float32)
    coordinates[is_mapped] = content.points[content.images[is_mapped]]
    return Appearance(tuple(materials), content.materials + 1, coordinates, tuple(finder.missing))
