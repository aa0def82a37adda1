"""Files of a description: found on this host, identified by SHA-256, uploaded if missing."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.bounded_files import hash_file, open_regular_file, read_file, read_text_file
from zensim.proto.messages.asset_messages import (
    IMAGE_SUFFIXES,
    MATERIAL_SUFFIX,
    MAX_BUNDLE_BYTES,
    MAX_BUNDLE_FILES,
    MAX_CHUNK_BYTES,
    MAX_FILE_BYTES,
    AssetRef,
    list_reference_uris,
    list_references,
    resolve_include_uri,
)
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import SpawnCode
from zensim.spawner.spawn.description_xml import (
    MAX_TEXT_BYTES,
    DescriptionError,
    make_refusal,
    parse_description,
)
from zensim.spawner.spawn.search_paths import FileLocation, SearchPaths

if TYPE_CHECKING:
    from zensim.spawner.client.service_client import ServiceClient

MESH_SUFFIXES = (".stl", ".dae", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Only these, and images and materials of OBJ files, are uploaded, so that an untrusted description
cannot read other files.
"""
REFERRING_SUFFIXES = (".dae", ".obj", MATERIAL_SUFFIX)
"""Files that name images or files of materials."""
MIB = 1 << 20


class MeshReference(msgspec.Struct, frozen=True):
    """A mesh URI of a description."""

    uri: str
    is_collision: bool


class AssetFile(msgspec.Struct, frozen=True):
    """A file to upload."""

    path: Path
    sha256: str
    size: int


class MissingMesh(msgspec.Struct, frozen=True):
    """A mesh that was not found on this host."""

    mesh: MeshReference
    reason: str


class AssetBundle(msgspec.Struct, frozen=True):
    """Files and notes that accompany a description."""

    refs: tuple[AssetRef, ...] = ()
    files: tuple[AssetFile, ...] = ()
    """Files of equal content once."""
    missing: tuple[MissingMesh, ...] = ()
    notes: tuple[ReportEntry, ...] = ()


def find_meshes(root: ET.Element) -> tuple[MeshReference, ...]:
    """Find the meshes of a URDF or SDF, each URI once."""
    collisions = {uri for part in root.iter("collision") for uri in _find_mesh_uris(part)}
    return tuple(
        MeshReference(uri, uri in collisions) for uri in dict.fromkeys(_find_mesh_uris(root))
    )


def _find_mesh_uris(element: ET.Element) -> Iterable[str]:
    for mesh in element.iter("mesh"):
        uri = (mesh.get("filename") or mesh.findtext("uri") or "").strip()
        if uri:
            yield uri


def find_images(root: ET.Element) -> tuple[str, ...]:
    """Find the URIs of the images that a URDF or SDF names itself, each once."""
    written = [texture.get("filename") or "" for texture in root.iter("texture")]
    written += [image.text or "" for image in root.iter("albedo_map")]
    uris = (uri.strip() for uri in written)
    return tuple(dict.fromkeys(uri for uri in uris if uri.lower().endswith(IMAGE_SUFFIXES)))


class _FileCollector:
    """Collects the files of a description and of the models that it includes."""

    def __init__(self) -> None:
        self.meshes: dict[MeshReference, FileLocation] = {}
        self.textures: dict[str, Path] = {}
        """Images and files of materials."""
        self.models: dict[str, Path] = {}
        self._pending: list[tuple[Path, SearchPaths, str]] = []

    def read(self, text: str, paths: SearchPaths) -> None:
        self._add(parse_description(text), paths, include="")
        while self._pending and len(self.models) <= MAX_BUNDLE_FILES:
            file, file_paths, uri = self._pending.pop()
            # The server reports errors of included models.
            with suppress(DescriptionError, UnicodeDecodeError):
                text = read_text_file(file, MAX_TEXT_BYTES)
                self._add(parse_description(text), file_paths, include=uri)

    def _add(self, root: ET.Element, paths: SearchPaths, *, include: str) -> None:
        for mesh in find_meshes(root):
            resolved = MeshReference(resolve_include_uri(include, mesh.uri), mesh.is_collision)
            location = _locate_mesh(mesh, paths)
            self.meshes.setdefault(resolved, location)
            if location.path is not None:
                self._add_references(location.path, mesh.uri, resolved.uri, paths)
        for image in find_images(root):
            if (path := paths.find(image).path) is not None:
                self.textures.setdefault(resolve_include_uri(include, image), path)
        for tag in root.iter("include"):
            uri = (tag.findtext("uri") or "").strip()
            resolved_uri = resolve_include_uri(include, uri)
            if resolved_uri in self.models or (file := paths.find_model(uri)) is None:
                continue
            self.models[resolved_uri] = file
            if file.stat().st_size <= MAX_TEXT_BYTES:
                self._pending.append((file, paths.with_folder_of(file), resolved_uri))

    def _add_references(self, file: Path, written: str, resolved: str, paths: SearchPaths) -> None:
        """Add the images and materials that a file names.

        Args:
            file: It.
            written: Its URI in the description.
            resolved: Its URI for the server.
            paths: Those of the description.
        """
        if file.suffix.lower() not in REFERRING_SUFFIXES or file.stat().st_size > MAX_FILE_BYTES:
            return
        for name in list_references(resolved, read_file(file, MAX_FILE_BYTES)):
            places = zip(
                list_reference_uris(written, name),
                list_reference_uris(resolved, name),
                strict=False,
            )
            for own, uri in places:
                if (path := paths.find(own).path) is not None:
                    if uri not in self.textures:
                        self.textures[uri] = path
                        self._add_references(path, own, uri, paths)
                    break


def make_bundle(text: str, paths: SearchPaths) -> AssetBundle:
    """Find the files of a description and compute their hashes.

    Raises:
        DescriptionError: The text is neither URDF nor SDF.
        ServiceError: There are too many files, or they are too large.
    """
    collector = _FileCollector()
    collector.read(text, paths)
    meshes = {mesh: found.path for mesh, found in collector.meshes.items() if found.path}
    by_uri = {**collector.models, **{mesh.uri: path for mesh, path in meshes.items()}}
    _check_sizes(tuple(dict.fromkeys(by_uri.values())))
    textures = _limit_textures(collector.textures, set(by_uri.values()))
    by_uri |= {uri: path for uri, path in textures.items() if uri not in by_uri}
    unique_paths = tuple(dict.fromkeys(by_uri.values()))
    by_path = {path: AssetFile(path, *hash_file(path)) for path in unique_paths}
    return AssetBundle(
        refs=tuple(AssetRef(uri, by_path[path].sha256) for uri, path in by_uri.items()),
        files=tuple({file.sha256: file for file in by_path.values()}.values()),
        missing=tuple(
            MissingMesh(mesh, found.reason)
            for mesh, found in collector.meshes.items()
            if not found.path
        ),
        notes=tuple(
            ReportEntry("ignored", f"texture {uri[:160]!r}", "too large for the upload; not sent")
            for uri in collector.textures
            if uri not in textures
        ),
    )


def check_collision_meshes(bundle: AssetBundle) -> None:
    """Check that no collision mesh is missing.

    Raises:
        ServiceError: A collision mesh is missing.
    """
    missing = [file for file in bundle.missing if file.mesh.is_collision]
    if not missing:
        return
    first, count = missing[0], len(missing)
    more = f" and {count - 1} more" if count > 1 else ""
    raise make_refusal(
        SpawnCode.MISSING_ASSETS,
        "mesh.missing",
        f"collision mesh {first.mesh.uri[:160]!r}{more}: {first.reason}, "
        "or leave out such collisions with `allow_missing`",
    )


def _locate_mesh(mesh: MeshReference, paths: SearchPaths) -> FileLocation:
    if not mesh.uri.lower().endswith(MESH_SUFFIXES):
        return FileLocation(
            reason=f"has an unsupported suffix; use one of {', '.join(MESH_SUFFIXES)}"
        )
    return paths.find(mesh.uri)


def _check_sizes(paths: tuple[Path, ...]) -> None:
    sizes = {path: path.stat().st_size for path in paths}
    for path, size in sizes.items():
        if size > MAX_FILE_BYTES:
            raise make_refusal(
                SpawnCode.UNSUPPORTED_ASSETS,
                "bundle.size",
                f"{path} has {size / MIB:.1f} MiB; the limit is {MAX_FILE_BYTES // MIB} MiB",
            )
    if len(paths) > MAX_BUNDLE_FILES:
        raise make_refusal(
            SpawnCode.UNSUPPORTED_ASSETS,
            "bundle.files",
            f"the description names {len(paths)} files; the limit is {MAX_BUNDLE_FILES}",
        )
    if (total := sum(sizes.values())) > MAX_BUNDLE_BYTES:
        raise make_refusal(
            SpawnCode.UNSUPPORTED_ASSETS,
            "bundle.size",
            f"the files of the description have {total / MIB:.1f} MiB; "
            f"the limit is {MAX_BUNDLE_BYTES // MIB} MiB",
        )


def _limit_textures(textures: dict[str, Path], others: set[Path]) -> dict[str, Path]:
    """Select the textures for which there is room beside the other files."""
    kept: dict[str, Path] = {}
    paths = set(others)
    total = sum(path.stat().st_size for path in others)
    for uri, path in textures.items():
        size = 0 if path in paths else path.stat().st_size
        has_room = len(paths) < MAX_BUNDLE_FILES and total + size <= MAX_BUNDLE_BYTES
        if path in paths or (has_room and size <= MAX_FILE_BYTES):
            kept[uri] = path
            paths.add(path)
            total += size
    return kept


def read_assets(bundle: AssetBundle) -> dict[str, tuple[str, bytes | None]]:
    """Read the files of a bundle: sha256 and bytes by URI.

    Raises:
        OSError: A file cannot be read.
    """
    paths = {file.sha256: file.path for file in bundle.files}
    return {
        ref.uri: (ref.sha256, read_file(paths[ref.sha256], MAX_FILE_BYTES)) for ref in bundle.refs
    }


MAX_SEND_ATTEMPTS = 3
"""Attempts without progress, before the upload fails."""


class PendingFile(msgspec.Struct, frozen=True):
    """A file that the server lacks, and the number of bytes that it has."""

    file: AssetFile
    received: int


def find_pending_files(client: "ServiceClient", files: Sequence[AssetFile]) -> list[PendingFile]:
    """Find which of these files the server lacks."""
    if not files:
        return []
    response = client.missing_assets(tuple(file.sha256 for file in files))
    received = response.received or (0,) * len(response.missing)
    pending = dict(zip(response.missing, received, strict=False))
    return [PendingFile(file, pending[file.sha256]) for file in files if file.sha256 in pending]


def send_file(
    client: "ServiceClient", pending: PendingFile, on_bytes: Callable[[int], None]
) -> None:
    """Upload one file, beginning with the first missing byte.

    Raises:
        ServiceError: The server refused the file.
        TimeoutError: The server does not reply to repeated calls.
    """
    offset, attempts = pending.received, 0
    with open_regular_file(pending.file.path) as file:
        while True:
            file.seek(offset)
            try:
                received = client.put_asset(
                    pending.file.sha256,
                    offset=offset,
                    total=pending.file.size,
                    data=file.read(MAX_CHUNK_BYTES),
                )
            except TimeoutError:
                received = _count_received(client, pending.file)
            attempts = 0 if received > offset else attempts + 1
            if attempts >= MAX_SEND_ATTEMPTS:
                raise TimeoutError(
                    f"the server has {offset} bytes of {file.name} and accepts no more"
                )
            on_bytes(max(0, received - offset))
            offset = received
            if offset >= pending.file.size:
                return


def _count_received(client: "ServiceClient", file: AssetFile) -> int:
    pending = find_pending_files(client, [file])
    return pending[0].received if pending else file.size
