"""The files that a description names: found on this host, named by content, uploaded where missing."""

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from zensim.proto.messages.asset_messages import (
    MAX_BUNDLE_BYTES,
    MAX_BUNDLE_FILES,
    MAX_CHUNK_BYTES,
    MAX_FILE_BYTES,
    AssetRef,
    resolve_include_uri,
)
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import SpawnCode
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.description_xml import (
    MAX_TEXT_BYTES,
    DescriptionError,
    make_refusal,
    parse_description,
)
from zensim.spawner.spawn.search_paths import FileLocation, SearchPaths

MESH_ENDINGS = (".stl", ".dae", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Nothing else is sent, so that a stranger's description cannot ask for what is no mesh."""
UNSENT_REFERENCES = {".dae": b"<init_from>", ".obj": b"mtllib"}
"""Marks of further files that a mesh names: textures and materials."""
BLOCK_BYTES = 1 << 20
MIB = 1 << 20


class MeshReference(msgspec.Struct, frozen=True):
    """A mesh as a description names it."""

    uri: str
    is_collision: bool


class AssetFile(msgspec.Struct, frozen=True):
    """A file to send."""

    path: Path
    sha256: str
    size: int


class MissingMesh(msgspec.Struct, frozen=True):
    """A mesh that is not on this host."""

    mesh: MeshReference
    reason: str


class AssetBundle(msgspec.Struct, frozen=True):
    """What goes with a description."""

    refs: tuple[AssetRef, ...] = ()
    files: tuple[AssetFile, ...] = ()
    """Each content once."""
    missing: tuple[MissingMesh, ...] = ()
    notes: tuple[ReportEntry, ...] = ()


def list_meshes(text: str) -> tuple[MeshReference, ...]:
    """List the meshes of a URDF or SDF, each uri once.

    Raises:
        DescriptionError: It is neither.
    """
    return _find_meshes(parse_description(text))


def _find_meshes(root: ET.Element) -> tuple[MeshReference, ...]:
    solid = {uri for part in root.iter("collision") for uri in _find_mesh_uris(part)}
    return tuple(MeshReference(uri, uri in solid) for uri in dict.fromkeys(_find_mesh_uris(root)))


def _find_mesh_uris(element: ET.Element) -> Iterable[str]:
    for mesh in element.iter("mesh"):
        uri = (mesh.get("filename") or mesh.findtext("uri") or "").strip()
        if uri:
            yield uri


class _FileCollector:
    """All that a description names, and what the models that it includes name."""

    def __init__(self) -> None:
        self.meshes: dict[MeshReference, FileLocation] = {}
        self.models: dict[str, Path] = {}
        self._waiting: list[tuple[Path, SearchPaths, str]] = []

    def read(self, text: str, paths: SearchPaths) -> None:
        self._add(parse_description(text), paths, include="")
        while self._waiting and len(self.models) <= MAX_BUNDLE_FILES:
            file, around, uri = self._waiting.pop()
            # What is wrong with an included model is for the server to say.
            with suppress(DescriptionError, UnicodeDecodeError):
                self._add(parse_description(file.read_text(encoding="utf-8")), around, include=uri)

    def _add(self, root: ET.Element, paths: SearchPaths, *, include: str) -> None:
        for mesh in _find_meshes(root):
            whole = MeshReference(resolve_include_uri(include, mesh.uri), mesh.is_collision)
            self.meshes.setdefault(whole, _locate_mesh(mesh, paths))
        for tag in root.iter("include"):
            uri = (tag.findtext("uri") or "").strip()
            whole_uri = resolve_include_uri(include, uri)
            if whole_uri in self.models or (file := paths.find_model(uri)) is None:
                continue
            self.models[whole_uri] = file
            if file.stat().st_size <= MAX_TEXT_BYTES:
                self._waiting.append((file, paths.beside(file), whole_uri))


def make_bundle(text: str, paths: SearchPaths) -> AssetBundle:
    """Find the files of a description and name each by its content.

    Raises:
        DescriptionError: The text is neither URDF nor SDF.
        ServiceError: The files are too many or too large.
    """
    named = _FileCollector()
    named.read(text, paths)
    meshes = {mesh: place.path for mesh, place in named.meshes.items() if place.path}
    by_uri = {**named.models, **{mesh.uri: path for mesh, path in meshes.items()}}
    paths_once = tuple(dict.fromkeys(by_uri.values()))
    _check_sizes(paths_once)
    by_path = {path: _hash_file(path) for path in paths_once}
    return AssetBundle(
        refs=tuple(AssetRef(uri, by_path[path].sha256) for uri, path in by_uri.items()),
        files=tuple({file.sha256: file for file in by_path.values()}.values()),
        missing=tuple(
            MissingMesh(mesh, place.reason)
            for mesh, place in named.meshes.items()
            if not place.path
        ),
        notes=tuple(_report_unsent(meshes)),
    )


def check_collision_meshes(bundle: AssetBundle) -> None:
    """Refuse a bundle that lacks a mesh of a collision.

    Raises:
        ServiceError: It does.
    """
    lost = [file for file in bundle.missing if file.mesh.is_collision]
    if not lost:
        return
    first, more = lost[0], f" and {len(lost) - 1} more" if len(lost) > 1 else ""
    raise make_refusal(
        SpawnCode.MISSING_ASSETS,
        "mesh.missing",
        f"collision mesh {first.mesh.uri[:160]!r}{more}: {first.reason}, "
        "or leave collisions out by --allow-missing",
    )


def _locate_mesh(mesh: MeshReference, paths: SearchPaths) -> FileLocation:
    if not mesh.uri.lower().endswith(MESH_ENDINGS):
        return FileLocation(reason=f"is no mesh that is sent; use one of {', '.join(MESH_ENDINGS)}")
    return paths.find(mesh.uri)


def _check_sizes(paths: tuple[Path, ...]) -> None:
    sizes = {path: path.stat().st_size for path in paths}
    for path, size in sizes.items():
        if size > MAX_FILE_BYTES:
            raise make_refusal(
                SpawnCode.UNSUPPORTED_ASSETS,
                "bundle.size",
                f"{path} has {size / MIB:.1f} MiB; a file has at most {MAX_FILE_BYTES // MIB} MiB",
            )
    if len(paths) > MAX_BUNDLE_FILES:
        raise make_refusal(
            SpawnCode.UNSUPPORTED_ASSETS,
            "bundle.files",
            f"the description names {len(paths)} files; at most {MAX_BUNDLE_FILES} are sent",
        )
    if (total := sum(sizes.values())) > MAX_BUNDLE_BYTES:
        raise make_refusal(
            SpawnCode.UNSUPPORTED_ASSETS,
            "bundle.size",
            f"the files of the description have {total / MIB:.1f} MiB in all; "
            f"at most {MAX_BUNDLE_BYTES // MIB} MiB are sent",
        )


def _hash_file(path: Path) -> AssetFile:
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            digest.update(block)
            size += len(block)
    return AssetFile(path, digest.hexdigest(), size)


def _report_unsent(found: dict[MeshReference, Path]) -> Iterable[ReportEntry]:
    for mesh, path in found.items():
        mark = UNSENT_REFERENCES.get(path.suffix.lower())
        if mark and not mesh.is_collision and mark in path.read_bytes():
            reason = "its materials and textures are not sent, only its shape is"
            yield ReportEntry("ignored", mesh.uri, reason)


MAX_SEND_ATTEMPTS = 3
"""At one place in a file, before silence counts."""


class PendingFile(msgspec.Struct, frozen=True):
    """A file that the server lacks, and how many bytes of its beginning are there."""

    file: AssetFile
    received: int


def find_pending_files(client: SimClient, files: Sequence[AssetFile]) -> list[PendingFile]:
    """Ask which of these files the server lacks."""
    if not files:
        return []
    answer = client.missing_assets(tuple(file.sha256 for file in files))
    received = answer.received or (0,) * len(answer.missing)
    begun = dict(zip(answer.missing, received, strict=False))
    return [PendingFile(file, begun[file.sha256]) for file in files if file.sha256 in begun]


def send_file(client: SimClient, lacking: PendingFile, on_bytes: Callable[[int], None]) -> None:
    """Send one file from where the server has it.

    Raises:
        ServiceError: The server refuses it.
        TimeoutError: It does not answer, though asked again.
    """
    offset, attempts = lacking.received, 0
    with lacking.file.path.open("rb") as file:
        while True:
            file.seek(offset)
            try:
                received = client.put_asset(
                    lacking.file.sha256,
                    offset=offset,
                    total=lacking.file.size,
                    data=file.read(MAX_CHUNK_BYTES),
                )
            except TimeoutError:
                received = _count_received(client, lacking.file)
            attempts = 0 if received > offset else attempts + 1
            if attempts >= MAX_SEND_ATTEMPTS:
                raise TimeoutError(f"the server takes no more than {offset} bytes of {file.name}")
            on_bytes(max(0, received - offset))
            offset = received
            if offset >= lacking.file.size:
                return


def _count_received(client: SimClient, file: AssetFile) -> int:
    still = find_pending_files(client, [file])
    return still[0].received if still else file.size
