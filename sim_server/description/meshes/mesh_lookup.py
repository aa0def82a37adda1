"""Which meshes a description may name, and whether missing ones are allowed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.meshes.generated_solids import is_generated
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model, Shape
    from zensim.sim_server.description.meshes.mesh_triangles import FindFile
    from zensim.sim_server.description.report import ParseReport


@dataclass(frozen=True)
class MeshPolicy:
    """Which meshes exist, and whether collisions may lack theirs.

    Attributes:
        find_mesh: Finds a mesh by its URI, as written in the description.
        missing: Faults of collisions without their mesh, if these are allowed.
    """

    find_mesh: FindFile
    allow_missing: bool = False
    missing: list[str] = field(default_factory=list)

    def can_use(self, shape: Shape, where: str, *, collides: bool, report: ParseReport) -> bool:
        """Whether a shape is not a mesh, or its mesh exists; if not, the report has the reason.

        Raises:
            ModelError: The mesh of a collision is missing and must not be.
        """
        if shape.kind != "mesh" or is_generated(shape.mesh):
            return True
        if self.find_mesh(shape.mesh) is not None:
            return True
        fault = f"mesh {quote(shape.mesh)} is not on the server"
        if not collides:
            report.suspicious(where, f"visual {fault}; not drawn")
        elif self.allow_missing:
            report.suspicious(where, f"collision {fault}; left out")
            self.missing.append(f"{where}: {fault}")
        else:
            raise ModelError(
                f"{where}: collision {fault}; send the mesh, use a box, sphere or cylinder, "
                "or allow missing meshes",
                code=SpawnCode.MISSING_ASSETS,
                slug="mesh.missing",
            )
        return False


def list_meshes(model: Model) -> tuple[str, ...]:
    """List the URIs of a model's meshes, each once; those of generated solids too."""
    shapes = (shape for link in model.links for shape in (*link.collisions, *link.visuals))
    return tuple(dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"))


def has_assets(model: Model) -> bool:
    """Whether a model has meshes or images."""
    textured = (shape.texture for link in model.links for shape in link.visuals)
    return bool(list_meshes(model)) or any(texture is not None for texture in textured)
