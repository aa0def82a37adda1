"""The files of a world for a recording: world file, models and descriptions of entities, meshes."""

import hashlib
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from zensim.proto.bounded_files import FileTooLarge, NotRegularFile, read_text_file
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.asset_messages import MAX_FILE_BYTES, GetAssetRequest
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.world_messages import WorldResource
from zensim.proto.network_protocols import CallingNetwork
from zensim.proto.service_catalog import GET_ASSET
from zensim.proto.settings.path_completion import SHIPPED
from zensim.recording.mcap_records import AttachedFile
from zensim.spawner.client.service_client import ServiceClient

SHA256: Final = re.compile("[0-9a-f]{64}")
FAILURES: Final = (BusError, ServiceError, TimeoutError, MalformedPayload)
TIMEOUT_S: Final = 2.0
"""Messages wait in the subscriptions meanwhile; those beyond their depth are lost."""
MESHES_S: Final = 0.1
WORLD_FILE: Final = "world.sdf"
MODELS_FOLDER: Final = "models/"
"""Folder of models and their entities, by roster of `Snapshot`; see `GetModelsResponse`."""
MESHES_FOLDER: Final = "meshes/"
"""Folder of meshes and textures, by their sha256."""
SHIPPED_NAME: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")
WORLD_SUFFIXES: Final = (".sdf", ".world")
WORLD_ROOT: Final = re.compile(r"<sdf\s")
ROOT_WITHIN: Final = 4096
"""Characters within which a world file names its root element."""
MAX_WORLD_BYTES: Final = 16 << 20
MAX_MESHES_BYTES: Final = 1 << 30
"""Most bytes of all meshes and textures of a recording."""


class FileRefused(Exception):
    """The server names a file that a recorder does not attach; the message says why."""


class EntityFiles:
    """Attaches each file once; after a failure, all but meshes are requested again later.

    A server may be a stranger's: of this host's files only worlds are read, and meshes are
    limited.
    """

    def __init__(
        self,
        bus: CallingNetwork,
        world: str,
        attach: Callable[[AttachedFile], None],
        on_refusal: Callable[[str], None],
    ) -> None:
        """Begin without files.

        Args:
            bus: Calls the server.
            world: Name of the world.
            attach: Takes each file.
            on_refusal: Takes the reason, once, why a file is left out.
        """
        self._bus = bus
        self._world = world
        self._attach = attach
        self._on_refusal = on_refusal
        self._known: set[str] = set()
        self._meshes: list[str] = []
        self._mesh = ""
        """The mesh that is read now, and what there is of it."""
        self._content = bytearray()
        self._meshes_bytes = 0

    def attach_new(self, *, has_arrivals: bool, most_s: float = MESHES_S) -> None:
        """Attach the files of new entities; meshes for a short while, and the rest at later calls.

        Args:
            has_arrivals: Whether entities were spawned, or a world was loaded.
            most_s: Wall time for meshes.
        """
        if has_arrivals:
            with suppress(*FAILURES):
                self._attach_texts()
        deadline_s = time.monotonic() + most_s
        while (self._mesh or self._meshes) and time.monotonic() < deadline_s:
            self._go_on_with_meshes()

    def _attach_texts(self) -> None:
        client = ServiceClient(self._bus, self._world, TIMEOUT_S)
        try:
            text = read_world_file(client.current_world())
        except FileRefused as refusal:
            text = ""
            self._note(str(refusal))
        if text:
            self._attach_once(WORLD_FILE, "application/xml", text.encode())
        found = client.models(wants_descriptions=True)
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

    def _go_on_with_meshes(self) -> None:
        """Read the next part of a mesh; leave out one that cannot be read."""
        try:
            self._read_mesh()
        except FAILURES:
            self._mesh = ""
        except FileRefused as refusal:
            self._mesh = ""
            self._note(str(refusal))

    def _read_mesh(self) -> None:
        """Read the next part of a mesh, and attach it with its last one.

        Raises:
            FileRefused: It is too large, or is not what its sha256 says.
        """
        if not self._mesh:
            self._mesh, self._content = self._meshes.pop(), bytearray()
        sha256, content = self._mesh, self._content
        request = GetAssetRequest(sha256, len(content))
        part = self._bus.call(GET_ASSET, request, world=self._world, timeout_s=TIMEOUT_S)
        content += part.data
        self._meshes_bytes += len(part.data)
        if len(content) > MAX_FILE_BYTES or self._meshes_bytes > MAX_MESHES_BYTES:
            self._meshes = [] if self._meshes_bytes > MAX_MESHES_BYTES else self._meshes
            raise FileRefused(
                f"mesh {sha256[:16]} is left out: a mesh has at most {MAX_FILE_BYTES >> 20} MiB, "
                f"and all of a recording {MAX_MESHES_BYTES >> 20} MiB"
            )
        if part.data and len(content) < part.total:
            return
        self._mesh = ""
        if hashlib.sha256(content).hexdigest() != sha256:
            raise FileRefused(f"mesh {sha256[:16]} is left out: the server sent other bytes")
        self._attach_once(f"{MESHES_FOLDER}{sha256}", "application/octet-stream", bytes(content))

    def _note(self, reason: str) -> None:
        if reason not in self._known:
            self._known.add(reason)
            self._on_refusal(reason)

    def _attach_once(self, name: str, media_type: str, content: bytes) -> None:
        digest = f"{name} {hashlib.sha256(content).hexdigest()}"
        if digest not in self._known:
            self._known.add(digest)
            self._attach(AttachedFile(name, media_type, content))


def read_world_file(world: WorldResource) -> str:
    """Read the text of a world: as it was sent, a built-in one, or a world file of this host.

    Returns:
        The text; empty if there is no such file here.

    Raises:
        FileRefused: It is a file of this host that is no world.
    """
    resource = world.world_resource
    if resource.resource_string or not resource.uri:
        return resource.resource_string
    if SHIPPED_NAME.fullmatch(resource.uri):
        path = SHIPPED / "worlds" / f"{resource.uri}.sdf"
    else:
        path = Path(resource.uri.removeprefix("file://"))
        if path.suffix not in WORLD_SUFFIXES:
            raise FileRefused(f"{resource.uri[:80]!r} is not attached: no world has this suffix")
    try:
        text = read_text_file(path, MAX_WORLD_BYTES)
    except (FileTooLarge, NotRegularFile, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise FileRefused(f"{resource.uri[:80]!r} is not attached: it {reason}") from error
    except OSError:
        return ""
    if WORLD_ROOT.search(text, 0, ROOT_WITHIN) is None:
        raise FileRefused(f"{resource.uri[:80]!r} is not attached: it is no SDF")
    return text


def list_meshes(models: Iterable[Model]) -> Iterator[str]:
    """List the meshes and textures of models, by their sha256."""
    links = (link for model in models for link in model.links)
    for shape in (shape for link in links for shape in (*link.collisions, *link.visuals)):
        texture = shape.texture
        names = (shape.mesh, *((texture.image, texture.coordinates) if texture else ()))
        yield from (name for name in names if SHA256.fullmatch(name))
