"""Which meshes a description may name. Nothing is opened because a description names it."""

from collections.abc import Callable, Sequence
from pathlib import Path

HasMesh = Callable[[str], bool]
"""Whether a mesh URI, as written in a description, can be served."""

_SCHEMES = ("package://", "model://")


def no_meshes(uri: str) -> bool:  # noqa: ARG001  every HasMesh takes a URI
    """Say that no mesh is here."""
    return False


def meshes_in(package_paths: Sequence[Path]) -> HasMesh:
    """Look for meshes below these folders.

    `package://NAME/FILE` and `model://NAME/FILE` are NAME/FILE below one of the folders, or FILE
    below a folder called NAME; a relative path is below one of the folders. Nothing outside the
    folders is ever there.
    """
    roots = [path.resolve() for path in package_paths]

    def has_mesh(uri: str) -> bool:
        return any(_is_file_below(root, part) for root in roots for part in _places(root, uri))

    return has_mesh


def _places(root: Path, uri: str) -> list[str]:
    scheme = next((scheme for scheme in _SCHEMES if uri.startswith(scheme)), "")
    if not scheme:
        return [] if "://" in uri else [uri]
    inside = uri.removeprefix(scheme)
    package, _, file = inside.partition("/")
    return [inside, file] if package == root.name else [inside]


def _is_file_below(root: Path, part: str) -> bool:
    try:
        place = (root / part).resolve()
        return place.is_relative_to(root) and place.is_file()
    except (OSError, ValueError):  # a name too long, or one that no file can have
        return False
