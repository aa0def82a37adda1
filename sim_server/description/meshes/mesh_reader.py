"""Mesh files of each format as triangles, checked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.meshes.lfs_pointer import LFS_FAULT, is_lfs_pointer
from zensim.sim_server.description.meshes.mesh_triangles import (
    MAX_TRIANGLES,
    FindFile,
    Triangles,
    find_no_file,
    mesh_error,
    too_many_error,
)
from zensim.sim_server.description.meshes.obj_mesh import read_obj_file
from zensim.sim_server.description.meshes.scene_reader import read_dae_file, read_glb_file
from zensim.sim_server.description.meshes.stl_reader import read_stl_file

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_EXTENT = 1e6
"""Largest coordinate, in the unit of the file."""


def read_mesh(name: str, data: bytes, find_file: FindFile = find_no_file) -> Triangles:
    """Read a mesh file by the extension of its name.

    Args:
        name: URI of the file.
        data: Its content.
        find_file: Finds the materials and images that it names.

    Raises:
        ModelError: The extension is unknown, or the file invalid or a pointer of Git LFS.
    """
    ending = name.rpartition(".")[2].lower()
    if ending not in MESH_READERS:
        raise mesh_error(
            name,
            f"has the extension {ending[:20]!r}; convert it to stl, obj, dae or glb",
            slug="mesh.format",
            code=SpawnCode.UNSUPPORTED_ASSETS,
        )
    if is_lfs_pointer(data):
        raise mesh_error(name, LFS_FAULT, slug="mesh.lfs", code=SpawnCode.MISSING_ASSETS)
    return _check_triangles(name, MESH_READERS[ending](name, data, find_file))


def _check_triangles(name: str, found: Triangles) -> Triangles:
    vertices, faces = found.vertices, found.faces
    if not len(faces):
        raise mesh_error(name, "has no triangles; export it again", slug="mesh.empty")
    if len(faces) > MAX_TRIANGLES:
        raise too_many_error(name, len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise mesh_error(
            name, f"has triangles outside its {len(vertices)} corners", slug="mesh.index"
        )
    if not np.isfinite(vertices).all():
        raise mesh_error(name, "has coordinates that are not finite numbers", slug="mesh.number")
    if np.abs(vertices).max() > MAX_EXTENT:
        raise mesh_error(
            name, f"has coordinates beyond {MAX_EXTENT:g}; check its unit", slug="mesh.extent"
        )
    return found


MESH_READERS: dict[str, Callable[[str, bytes, FindFile], Triangles]] = {
    "stl": read_stl_file,
    "stlb": read_stl_file,
    "obj": read_obj_file,
    "dae": read_dae_file,
    "glb": read_glb_file,
}
