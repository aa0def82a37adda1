"""Volume, centre and moments of a mesh, by trimesh."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import trimesh

from zensim.proto.messages.model_messages import Inertial
from zensim.sim_server.description.body_moments import from_inertia_matrix
from zensim.sim_server.description.meshes.convex_hull import find_hull
from zensim.sim_server.description.meshes.mesh_conversion import read_mesh_or_generate

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Shape
    from zensim.sim_server.description.meshes.mesh_triangles import FindFile


def measure_mesh(shape: Shape, find_mesh: FindFile) -> tuple[Inertial, bool]:
    """Find the inertial of a mesh of density 1 kg/m^3 in the frame of its shape.

    Returns:
        The inertial, and whether the surface is closed; if it is not, the inertial is that of the
        convex hull.

    Raises:
        ModelError: The mesh is missing or invalid.
    """
    _, data = find_mesh(shape.mesh) or ("", b"")
    read = read_mesh_or_generate(shape.mesh, data, find_mesh)
    solid = trimesh.Trimesh(read.vertices * shape.size, read.faces)
    is_closed = bool(solid.is_watertight and solid.is_winding_consistent)
    if not is_closed:
        solid = trimesh.Trimesh(*find_hull(solid.vertices))
    found = solid.mass_properties
    # A mirrored mesh is wound inwards, and its volume is negative.
    side, volume = math.copysign(1.0, found.volume), float(found.volume)
    x, y, z = found.center_mass.tolist()
    return Inertial(side * volume, (x, y, z), from_inertia_matrix(side * found.inertia)), is_closed
