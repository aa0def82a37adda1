"""The files that a description names, gathered on the operator's host and named by content."""

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import msgspec

from zensim.proto.messages.asset_messages import (
    MAX_BUNDLE_BYTES,
    MAX_BUNDLE_FILES,
    MAX_FILE_BYTES,
    AssetRef,
    resolve_include_uri,
)
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import SpawnCode
from zensim.spawner.markup import MAX_TEXT_BYTES, DescriptionError, parsed, refused
from zensim.spawner.search_paths import Place, SearchPaths

MESH_ENDINGS = (".stl", ".dae", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Nothing else is sent, so that a stranger's description cannot ask for what is no mesh."""
LEFT_OUT = {".dae": b"<init_from>", ".obj": b"mtllib"}
"""Marks of further files that a mesh names: textures and materials."""
BLOCK_BYTES = 1 << 20
MIB = 1 << 20


class Mesh(msgspec.Struct, frozen=True):
    """A mesh as a description names it."""

    uri: str
    is_collision: bool


class AssetFile(msgspec.Struct, frozen=True):
    """A file to send."""

    path: Path
    sha256: str
    size: int


class MissingFile(msgspec.Struct, frozen=True):
    """A mesh that is not on this host."""

    mesh: Mesh
    reason: str


class Bundle(msgspec.Struct, frozen=True):
    """What goes with a description."""

    refs: tuple[AssetRef, ...] = ()
    files: tuple[AssetFile, ...] = ()
    """Each content once."""
    missing: tuple[MissingFile, ...] = ()
    notes: tuple[ReportEntry, ...] = ()


def meshes_named(text: str) -> tuple[Mesh, ...]:
    """List the meshes of a URDF or SDF, each uri once.

    Raises:
        DescriptionError: It is neither.
    """
    return _meshes_in(parsed(text))


def _meshes_in(root: ET.Element) -> tuple[Mesh, ...]:
    solid = {uri for part in root.iter("collision") for uri in _uris(part)}
    return tuple(Mesh(uri, uri in solid) for uri in dict.fromkeys(_uris(root)))


def _uris(element: ET.Element) -> Iterable[str]:
    for mesh in element.iter("mesh"):
        uri = (mesh.get("filename") or mesh.findtext("uri") or "").strip()
        if uri:
            yield uri


class _Named:
    """All that a description names, and what the models that it includes name."""

    def __init__(self) -> None:
        self.meshes: dict[Mesh, Place] = {}
        self.models: dict[str, Path] = {}
        self._waiting: list[tuple[Path, SearchPaths, str]] = []

    def read(self, text: str, paths: SearchPaths) -> None:
        self._add(parsed(text), paths, include="")
        while self._waiting and len(self.models) <= MAX_BUNDLE_FILES:
            file, around, uri = self._waiting.pop()
            # What is wrong with an included model is for the server to say.
            with suppress(DescriptionError, UnicodeDecodeError):
                self._add(parsed(file.read_text(encoding="utf-8")), around, include=uri)

    def _add(self, root: ET.Element, paths: SearchPaths, *, include: str) -> None:
        for mesh in _meshes_in(root):
            whole = Mesh(resolve_include_uri(include, mesh.uri), mesh.is_collision)
            self.meshes.setdefault(whole, _place(mesh, paths))
        for tag in root.iter("include"):
            uri = (tag.findtext("uri") or "").strip()
            whole_uri = resolve_include_uri(include, uri)
            if whole_uri in self.models or (file := paths.find_model(uri)) is None:
                continue
            self.models[whole_uri] = file
            if file.stat().st_size <= MAX_TEXT_BYTES:
                self._waiting.append((file, paths.beside(file), whole_uri))


def bundle_of(text: str, paths: SearchPaths) -> Bundle:
    """Find the files of a description and name each by its content.

    Raises:
        DescriptionError: The text is neither URDF nor SDF.
        ServiceError: The files are too many or too large.
    """
    named = _Named()
    named.read(text, paths)
    meshes = {mesh: place.path for mesh, place in named.meshes.items() if place.path}
    by_uri = {**named.models, **{mesh.uri: path for mesh, path in meshes.items()}}
    paths_once = tuple(dict.fromkeys(by_uri.values()))
    _check_sizes(paths_once)
    by_path = {path: _asset(path) for path in paths_once}
    return Bundle(
        refs=tuple(AssetRef(uri, by_path[path].sha256) for uri, path in by_uri.items()),
        files=tuple({file.sha256: file for file in by_path.values()}.values()),
        missing=tuple(
            MissingFile(mesh, place.reason)
            for mesh, place in named.meshes.items()
            if not place.path
        ),
        notes=tuple(_notes(meshes)),
    )


def check_collisions(bundle: Bundle) -> None:
    """Refuse a bundle that lacks a mesh of a collision.

    Raises:
        ServiceError: It does.
    """
    lost = [file for file in bundle.missing if file.mesh.is_collision]
    if not lost:
        return
    first, more = lost[0], f" and {len(lost) - 1} more" if len(lost) > 1 else ""
    raise refused(
        SpawnCode.MISSING_ASSETS,
        "mesh.missing",
        f"collision mesh {first.mesh.uri[:160]!r}{more}: {first.reason}, "
        "or leave collisions out by --allow-missing",
    )


def _place(mesh: Mesh, paths: SearchPaths) -> Place:
    if not mesh.uri.lower().endswith(MESH_ENDINGS):
        return Place(reason=f"is no mesh that is sent; use one of {', '.join(MESH_ENDINGS)}")
    return paths.find(mesh.uri)


def _check_sizes(paths: tuple[Path, ...]) -> None:
    sizes = {path: path.stat().st_size for path in paths}
    for path, size in sizes.items():
        if size > MAX_FILE_BYTES:
            raise refused(
                SpawnCode.UNSUPPORTED_ASSETS,
                "bundle.size",
                f"{path} has {size / MIB:.1f} MiB; a file has at most {MAX_FILE_BYTES // MIB} MiB",
            )
    if len(paths) > MAX_BUNDLE_FILES:
        raise refused(
            SpawnCode.UNSUPPORTED_ASSETS,
            "bundle.files",
            f"the description names {len(paths)} files; at most {MAX_BUNDLE_FILES} are sent",
        )
    if (total := sum(sizes.values())) > MAX_BUNDLE_BYTES:
        raise refused(
            SpawnCode.UNSUPPORTED_ASSETS,
            "bundle.size",
            f"the files of the description have {total / MIB:.1f} MiB in all; "
            f"at most {MAX_BUNDLE_BYTES // MIB} MiB are sent",
        )


def _asset(path: Path) -> AssetFile:
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            digest.update(block)
            size += len(block)
    return AssetFile(path, digest.hexdigest(), size)


def _notes(found: dict[Mesh, Path]) -> Iterable[ReportEntry]:
    for mesh, path in found.items():
        mark = LEFT_OUT.get(path.suffix.lower())
        if mark and not mesh.is_collision and mark in path.read_bytes():
            reason = "its materials and textures are not sent, only its shape is"
            yield ReportEntry("ignored", mesh.uri, reason)
