"""Files that a mesh file names: images and materials beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from zensim.proto.messages.asset_messages import list_reference_uris

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zensim.sim_server.description.meshes.mesh_triangles import FindFile


class FileFinder(Mapping[str, bytes]):
    """Finds the files that a file names; `missing` lists those that were not found.

    It is a mapping because trimesh asks one for images.
    """

    def __init__(self, owner: str, find_file: FindFile) -> None:
        self.missing: dict[str, None] = {}
        self._owner, self._find_file = owner, find_file

    def find(self, reference: str, owner: str = "") -> tuple[str, bytes]:
        """Find URI and content of a file; empty content if it is missing."""
        for uri in list_reference_uris(owner or self._owner, reference):
            if (found := self._find_file(uri)) is not None:
                return uri, found[1]
        self.missing[reference] = None
        return "", b""

    def __getitem__(self, name: str) -> bytes:
        """Find the content of a file."""
        _, data = self.find(name)
        if not data:
            raise KeyError(name)
        return data

    def __iter__(self) -> Iterator[str]:
        """List nothing: files are found by name only."""
        return iter(())

    def __len__(self) -> int:
        """Return 0: files are found by name only."""
        return 0
