"""Triangles of a mesh and their materials, as readers make them; refusals of mesh files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from zensim.proto.messages.model_messages import Quat

MAX_TRIANGLES = 2_000_000

FindFile = Callable[[str], tuple[str, bytes] | None]
"""Finds the sha256 and the bytes of a file by its URI; None if the server does not have it."""


def find_no_file(uri: str) -> None:  # noqa: ARG001  every FindFile takes a URI
    """Return None: there are no files."""
    return None


class MeshMaterial(NamedTuple):
    """A material of a mesh file; `image` is an encoded image, empty without."""

    rgba: Quat | None = None
    image: bytes = b""


PLAIN = MeshMaterial()


@dataclass(frozen=True, eq=False)
class Appearance:
    """Materials of the triangles of a mesh.

    Attributes:
        material_of: Index of each triangle's material (f,).
        coordinates: Of the image (f, 3, 2), u to the right and v upward.
        missing: Files that were not found, as named in the mesh file.
    """

    materials: tuple[MeshMaterial, ...]
    material_of: NDArray[np.int64]
    coordinates: NDArray[np.float32]
    missing: tuple[str, ...] = ()

    def select(self, faces: NDArray[Any]) -> Appearance:
        """Make the appearance of some of the triangles."""
        return Appearance(
            self.materials, self.material_of[faces], self.coordinates[faces], self.missing
        )


@dataclass(frozen=True, eq=False)
class Triangles:
    """Corners (v, 3) in the scale of the file, and corner indices of triangles (f, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    appearance: Appearance | None = None

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners (f, 3, 3) of each triangle."""
        return self.vertices[self.faces]


def too_many_error(name: str, count: int) -> ModelError:
    """Make the refusal of a mesh with more than `MAX_TRIANGLES` triangles."""
    return mesh_error(
        name, f"has {count} triangles; use at most {MAX_TRIANGLES}", slug="mesh.triangles"
    )


def mesh_error(
    name: str, fault: str, *, slug: str, code: int = SpawnCode.UNSUPPORTED_ASSETS
) -> ModelError:
    """Make the refusal of a mesh file, by its URI and what is wrong with it."""
    return ModelError(f"mesh {quote(name)} {fault}", code=code, slug=slug)
