"""Meshes that robots look like: fetched by content, each once, a piece at a time."""

from collections.abc import Callable, Iterable
from hashlib import sha256
from typing import Final, Protocol

import numpy as np

from zensim.proto.bus import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.service_catalog import GET_ASSET, Request, Response, Service
from zensim.proto.stl import read_corners, stl_size
from zensim.spawner.viewer.triangles import NO_MESHES, Mesh, Meshes, welded

CALL_TIMEOUT_S: Final = 0.8
ASK_AGAIN_S: Final = 1.0
MAX_MESH_BYTES: Final = stl_size(60_000)
"""What a server sends at most of one."""
MAX_BYTES: Final = 128 << 20
"""Of all that are drawn; beyond, robots look like their collisions."""


class Caller(Protocol):
    """Calls services."""

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float,
    ) -> Response:
        """Call a service."""


class MeshFetcher:
    """Keeps the meshes that models name; call `fetch` over and over.

    Attributes:
        meshes: By sha256; another mapping whenever all that can be had have come.
    """

    def __init__(
        self,
        network: Caller,
        world: str,
        clock: Callable[[], float],
        budget_bytes: int = MAX_BYTES,
    ) -> None:
        self._network, self._world, self._clock = network, world, clock
        self._budget_bytes = budget_bytes
        self._wanted: dict[str, bytearray] = {}
        self._sizes: dict[str, int] = {}
        self._ask_at = 0.0
        self._found: dict[str, Mesh] = {}
        self.meshes: Meshes = NO_MESHES

    def want(self, models: Iterable[Model]) -> None:
        """Say whose meshes are needed from now on; what could not be had is asked for again."""
        named = drawn_meshes(models)
        self._found = {name: mesh for name, mesh in self._found.items() if name in named}
        self._sizes = {name: size for name, size in self._sizes.items() if name in self._found}
        begun = self._wanted
        self._wanted = {
            name: begun.get(name, bytearray()) for name in named if name not in self._found
        }
        self._publish()

    def fetch(self) -> None:
        """Fetch one piece if any is wanted."""
        if not self._wanted or self._clock() < self._ask_at:
            return
        name, data = next(iter(self._wanted.items()))
        try:
            answer = self._network.call(
                GET_ASSET,
                GetAssetRequest(name, len(data)),
                world=self._world,
                timeout_s=CALL_TIMEOUT_S,
            )
        except ServiceError:
            self._end(name, None)
            return
        except (BusError, TimeoutError, MalformedPayload):
            self._ask_at = self._clock() + ASK_AGAIN_S
            return
        data += answer.data
        if not self._has_room(answer.total) or not answer.data:
            self._end(name, None)
        elif len(data) >= answer.total:
            self._end(name, _mesh(name, bytes(data)))

    def _has_room(self, total: int) -> bool:
        return total <= MAX_MESH_BYTES and sum(self._sizes.values()) + total <= self._budget_bytes

    def _end(self, name: str, mesh: Mesh | None) -> None:
        data = self._wanted.pop(name)
        if mesh is not None:
            self._found[name], self._sizes[name] = mesh, len(data)
        self._publish()

    def _publish(self) -> None:
        if not self._wanted and self._found.keys() != self.meshes.keys():
            self.meshes = dict(self._found)


def drawn_meshes(models: Iterable[Model]) -> dict[str, None]:
    """List the sha256 of all meshes that are drawn, in order."""
    links = (link for model in models for link in model.links)
    shapes = (shape for link in links for shape in link.visuals if shape.kind == "mesh")
    return dict.fromkeys(shape.mesh for shape in shapes)


def _mesh(name: str, data: bytes) -> Mesh | None:
    """Read what came; None when it is not what was asked for, or no mesh."""
    if sha256(data).hexdigest() != name:
        return None
    try:
        corners = read_corners(data)
    except ValueError:
        return None
    return welded(corners) if len(corners) and bool(np.isfinite(corners).all()) else None
