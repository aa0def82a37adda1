"""The files of a world for a recording: world file, models and descriptions of entities, meshes."""

import hashlib
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from zensim.proto.bus import Bus, BusError
from zensim.proto.cli_options import SHIPPED
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import GetModelsRequest
from zensim.proto.messages.world_messages import GetCurrentWorldRequest, WorldResource
from zensim.proto.service_catalog import GET_ASSET, GET_CURRENT_WORLD, GET_MODELS
from zensim.recording.mcap_records import AttachedFile

SHA256: Final = re.compile("[0-9a-f]{64}")
FAILURES: Final = (BusError, ServiceError, TimeoutError, MalformedPayload)
TIMEOUT_S: Final = 2.0
"""Messages wait in the subscriptions meanwhile; those beyond their depth are lost."""
MESHES_S: Final = 0.1
WORLD_FILE: Final = "world.sdf"
MODELS_FOLDER: Final = "models/"
"""Of models and their entities, by the roster of `Snapshot`; see `GetModelsResponse`."""
MESHES_FOLDER: Final = "meshes/"
"""Of meshes and textures, by their sha256."""


class EntityFiles:
    """Attaches each file once; after a failure, all but meshes are requested again later."""

    def __init__(self, bus: Bus, world: str, attach: Callable[[AttachedFile], None]) -> None:
        self._bus = bus
        self._world = world
        self._attach = attach
        self._known: set[str] = set()
        self._meshes: list[str] = []

    def attach_new(self, *, has_arrivals: bool) -> None:
        """Attach the files of new entities; meshes for a short while, and the rest at later calls.

        Args:
            has_arrivals: Whether entities were spawned, or a world was loaded.
        """
        if has_arrivals:
            with suppress(*FAILURES):
                self._attach_texts()
        deadline_s = time.monotonic() + MESHES_S
        while self._meshes and time.monotonic() < deadline_s:
            with suppress(*FAILURES):
                self._attach_mesh(self._meshes.pop())

    def _attach_texts(self) -> None:
        call, world = self._bus.call, self._world
        current = call(
            GET_CURRENT_WORLD, GetCurrentWorldRequest(), world=world, timeout_s=TIMEOUT_S
        )
        text = read_world_file(current.world)
        if text:
            self._attach_once(WORLD_FILE, "application/xml", text.encode())
        request = GetModelsRequest(wants_descriptions=True)
        found = call(GET_MODELS, request, world=world, timeout_s=TIMEOUT_S)
        for one in found.descriptions:
            content = one.encode()
            digest = hashlib.sha256(content).hexdigest()
            self._attach_once(f"descriptions/{digest[:16]}.xml", "application/xml", content)
        models = msgspec.structs.replace(found, descriptions=())
        name = f"{MODELS_FOLDER}{found.roster}.json"
        self._attach_once(name, "application/json", msgspec.json.encode(models))
        for mesh in list_meshes(found.models):
            if mesh not in self._known:
                self._known.add(mesh)
                self._meshes.append(mesh)

    def _attach_mesh(self, sha256: str) -> None:
        content = b""
        while True:
            request = GetAssetRequest(sha256, len(content))
            part = self._bus.call(GET_ASSET, request, world=self._world, timeout_s=TIMEOUT_S)
            content += part.data
            if not part.data or len(content) >= part.total:
                break
        self._attach_once(f"{MESHES_FOLDER}{sha256}", "application/octet-stream", content)

    def _attach_once(self, name: str, media_type: str, content: bytes) -> None:
        digest = f"{name} {hashlib.sha256(content).hexdigest()}"
        if digest not in self._known:
            self._known.add(digest)
            self._attach(AttachedFile(name, media_type, content))


def read_world_file(world: WorldResource) -> str:
    """Read the text of a world: as it was sent, a built-in one, or a file of this host."""
    resource = world.world_resource
    if resource.resource_string:
        return resource.resource_string
    candidates: Iterable[Path] = (
        SHIPPED / "worlds" / f"{resource.uri}.sdf",
        Path(resource.uri.removeprefix("file://")),
    )
    for path in candidates:
        with suppress(OSError, UnicodeDecodeError, ValueError):
            if resource.uri:
                return path.read_text(encoding="utf-8")
    return ""


def list_meshes(models: Iterable[Model]) -> Iterator[str]:
    """List the meshes and textures of models, by their sha256."""
    links = (link for model in models for link in model.links)
    for shape in (shape for link in links for shape in (*link.collisions, *link.visuals)):
        texture = shape.texture
        names = (shape.mesh, *((texture.image, texture.coordinates) if texture else ()))
        yield from (name for name in names if SHA256.fullmatch(name))
