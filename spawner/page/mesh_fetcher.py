"""MeshFetcher: fetches the meshes and textures of models from the server, a chunk at a time."""

from collections.abc import Callable, Iterable, Mapping
from hashlib import sha256
from typing import Final

import msgspec
import numpy as np

from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.model_messages import Model, Shape
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.network_protocols import CallingNetwork
from zensim.proto.service_catalog import GET_ASSET
from zensim.proto.stl import read_corners, stl_size
from zensim.spawner.page.model_visuals import (
    NO_MESHES,
    TriangleMesh,
    TriangleMeshes,
    find_mesh_name,
    make_textured_mesh,
    weld_triangles,
)

MESH_CALL_TIMEOUT_S: Final = 0.8
MESH_RETRY_S: Final = 1.0
MAX_MESH_BYTES: Final = stl_size(60_000)
"""Limit of one mesh; servers send no larger ones."""
MESH_BUDGET_BYTES: Final = 128 << 20
"""Limit of all files; without its mesh a visual is drawn by the collision shapes of its link."""
FETCH_BUDGET_S: Final = 0.03
"""Time for files between two frames."""
IMAGE_STARTS: Final = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")
"""First bytes of PNG and JPEG."""


class MeshFetcher:
    """Fetches the meshes and textures of models in chunks; call `fetch` periodically.

    Attributes:
        meshes: By `find_mesh_name`; replaced when all available files of visuals have been fetched,
            and again with those of collisions.
    """

    def __init__(
        self,
        network: CallingNetwork,
        world: str,
        clock: Callable[[], float],
        budget_bytes: int = MESH_BUDGET_BYTES,
    ) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._budget_bytes = budget_bytes
        self._pending: dict[str, bytearray] = {}
        self._next_call_at = 0.0
        self._found: dict[str, bytes] = {}
        self._visuals: dict[str, Shape] = {}
        self._collisions: dict[str, Shape] = {}
        self.meshes: TriangleMeshes = NO_MESHES

    def set_models(self, models: Iterable[Model]) -> None:
        """Set the models whose files are fetched; failed ones are retried."""
        links = [link for model in models for link in model.links]
        self._visuals = _list_meshes(shape for link in links for shape in link.visuals)
        self._collisions = _list_meshes(shape for link in links for shape in link.collisions)
        shapes = (*self._visuals.values(), *self._collisions.values())
        named = dict.fromkeys(name for shape in shapes for name in _list_files(shape))
        self._found = {name: data for name, data in self._found.items() if name in named}
        self._pending = {
            name: self._pending.get(name, bytearray()) for name in named if name not in self._found
        }
        self._publish()

    def fetch(self) -> None:
        """Fetch pending files for a moment."""
        ends_at = self._clock() + FETCH_BUDGET_S
        while self._pending and self._next_call_at <= self._clock() < ends_at:
            self._fetch_chunk()

    def _fetch_chunk(self) -> None:
        name, data = next(iter(self._pending.items()))
        try:
            response = self._network.call(
                GET_ASSET,
                GetAssetRequest(name, len(data)),
                world=self._world,
                timeout_s=MESH_CALL_TIMEOUT_S,
            )
        except ServiceError:
            self._finish(name, None)
            return
        except (BusError, TimeoutError, MalformedPayload):
            self._next_call_at = self._clock() + MESH_RETRY_S
            return
        data += response.data
        if not self._has_room(response.total) or not response.data:
            self._finish(name, None)
        elif len(data) >= response.total:
            self._finish(name, bytes(data))

    def _has_room(self, total: int) -> bool:
        used = sum(map(len, self._found.values()))
        return total <= MAX_MESH_BYTES and used + total <= self._budget_bytes

    def _finish(self, name: str, data: bytes | None) -> None:
        del self._pending[name]
        if data is not None and sha256(data).hexdigest() == name:
            self._found[name] = data
        self._publish()

    def _publish(self) -> None:
        waited = {name for shape in self._visuals.values() for name in _list_files(shape)}
        if not waited.isdisjoint(self._pending):
            return
        shown = self._collisions.keys() & self.meshes.keys() if self._pending else self._collisions
        shapes = {name: self._collisions[name] for name in shown} | self._visuals
        meshes: dict[str, TriangleMesh] = {}
        for name, shape in shapes.items():
            mesh = self.meshes.get(name) or _make_mesh(shape, self._found)
            if mesh is not None:
                meshes[name] = mesh
            elif shape.texture is not None:
                plain = _make_mesh(msgspec.structs.replace(shape, texture=None), self._found)
                meshes |= {shape.mesh: plain} if plain is not None else {}
        if meshes.keys() != self.meshes.keys():
            self.meshes = meshes


def _list_meshes(shapes: Iterable[Shape]) -> dict[str, Shape]:
    """List one shape for each mesh and texture, by `find_mesh_name`, in order."""
    return {find_mesh_name(shape): shape for shape in shapes if shape.kind == "mesh"}


def _list_files(shape: Shape) -> list[str]:
    """List the sha256 of the files of a visual."""
    texture = shape.texture
    names = [shape.mesh, texture.image, texture.coordinates] if texture else [shape.mesh]
    return [name for name in names if name]


def _make_mesh(shape: Shape, files: Mapping[str, bytes]) -> TriangleMesh | None:
    """Make the mesh of a visual; None if a file is missing or malformed."""
    if not all(name in files for name in _list_files(shape)):
        return None
    try:
        corners = read_corners(files[shape.mesh])
    except ValueError:
        return None
    if not len(corners) or not np.isfinite(corners).all():
        return None
    if shape.texture is None:
        return weld_triangles(corners)
    image, written = files[shape.texture.image], files.get(shape.texture.coordinates, b"")
    if len(written) != 8 * len(corners) or not image.startswith(IMAGE_STARTS):
        return None
    coordinates = np.frombuffer(written, "<f4").reshape(-1, 2)
    return (
        make_textured_mesh(corners, coordinates, image) if np.isfinite(coordinates).all() else None
    )
