"""Which meshes a description may name, and whether missing ones are allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

HasMesh = Callable[[str], bool]
"""Whether a mesh URI, as written in a description, can be served."""


def no_meshes(uri: str) -> bool:  # noqa: ARG001  every HasMesh takes a URI
    """Say that no mesh is here."""
    return False


@dataclass(frozen=True)
class MeshPolicy:
    """Which meshes are here, and whether a robot may do without those of collisions."""

    has_mesh: HasMesh
    allow_missing: bool = False
