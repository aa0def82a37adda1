"""Which meshes a description may name. Nothing is opened because a description names it."""

from collections.abc import Callable

HasMesh = Callable[[str], bool]
"""Whether a mesh URI, as written in a description, can be served."""


def no_meshes(uri: str) -> bool:  # noqa: ARG001  every HasMesh takes a URI
    """Say that no mesh is here."""
    return False
