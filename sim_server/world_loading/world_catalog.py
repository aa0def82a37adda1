"""The worlds that can be loaded: shipped worlds and world files below the operator's folders."""

from __future__ import annotations

import logging
import os
import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from zensim.proto.bounded_files import open_regular_file
from zensim.proto.messages.result_messages import LoadWorldCode, ResultCode
from zensim.proto.messages.spawn_messages import Resource
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.strict_xml import MAX_BYTES
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.world_loading.file_work import read_regular_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

LOG = logging.getLogger(__name__)
WORLD_SUFFIXES = (".world", ".sdf")
WORLD_SCHEMES = ("zensim://", "file://")
ONLINE_SCHEMES = ("http://", "https://")
HEAD_BYTES = 64 << 10
"""Bytes of a file that are searched for the metadata of its world."""
MAX_VISITED_FILES = 10_000
"""Files and folders that one listing visits."""
FILES_PER_TURN = 8
"""Files read in one turn of the loop: 1 ms."""
MAX_TAGS = 32
_WORLD_TAG = re.compile(r"<world\s[^<>]{0,500}?name\s{0,9}=\s{0,9}[\"']([^\"'<>]{1,200})[\"']")
_CONTENT_TAG = re.compile(r"<(?:frame|model)\b")
"""The first element that may have metadata of its own."""
_METADATA_TAG = re.compile(r"<zensim:(description|tags)>([^<]{0,1000})</zensim:")


@dataclass(frozen=True)
class SearchFailure:
    """A folder that could not be searched.

    Attributes:
        is_own: Whether it is configured by the operator, not named by a request.
    """

    reason: str
    is_own: bool = True


SearchFinding = WorldResource | SearchFailure | None
"""Result of one file or folder."""


class WorldSearch:
    """A search for worlds that visits a few files in each call."""

    def __init__(self, findings: Iterator[SearchFinding]) -> None:
        self.worlds: list[WorldResource] = []
        self.failures: list[SearchFailure] = []
        self.is_over = False
        self._findings = findings

    def advance(self, files: int | None = FILES_PER_TURN) -> bool:
        """Visit this many more files, or all; return whether none is left."""
        visited = 0
        for finding in islice(self._findings, files):
            visited += 1
            if isinstance(finding, WorldResource):
                self.worlds.append(finding)
            elif finding is not None:
                self.failures.append(finding)
        self.is_over = files is None or visited < files
        return self.is_over


@dataclass(frozen=True)
class WorldText:
    """A world before it is parsed.

    Attributes:
        folders: Folders to search for its models and meshes.
    """

    resource: WorldResource
    text: str
    folders: tuple[Path, ...] = ()


class WorldCatalog:
    """Finds worlds by name."""

    def __init__(self, folders: Sequence[Path], start: Path | None = None) -> None:
        """Make a catalog.

        Args:
            folders: Configured by the operator.
            start: World file that the server was started with.
        """
        for folder in folders:
            if not folder.is_dir():
                LOG.warning("`model_path`: there is no folder '%s'", folder)
        self._folders = tuple(folder.resolve() for folder in folders)
        self._start = start.resolve() if start is not None else None
        self._start_name = str(start)

    def find(self, resource: Resource) -> WorldText:
        """Find the world that a request names.

        Raises:
            RequestRefused: There is no such world, or it must not be loaded.
        """
        if not (resource.uri or resource.resource_string):
            raise RequestRefused(
                LoadWorldCode.NO_RESOURCE,
                "world_resource is empty; set a uri that get_available_worlds lists, or SDF",
            )
        if not resource.uri:
            text = resource.resource_string
            return WorldText(read_world_metadata(resource, text), text, self._folders)
        name = _strip_world_scheme(resource.uri)
        if name in list_builtin_worlds():
            text = read_builtin_world(name)
            return WorldText(read_world_metadata(Resource(name), text), text)
        return self._from_file(name, resource.uri)

    def find_start_world(self, name: str, model_name: str) -> WorldResource:
        """Describe the world that a server starts with.

        Args:
            name: World name or file on the command line.
            model_name: Name in the world file; it differs if a journal restored another world.
        """
        try:
            found = self.find(Resource(name)).resource
        except RequestRefused:  # restored, and its file was deleted
            found = WorldResource()
        if found.name == model_name:
            return found
        search = self.search()
        search.advance(None)
        same_name = (world for world in search.worlds if world.name == model_name)
        return next(same_name, WorldResource(model_name))

    def search(self, sources: Sequence[str] = ()) -> WorldSearch:
        """Search the built-in worlds, the operator's folders, and these folders below them."""
        return WorldSearch(self._findings(sources))

    def _findings(self, sources: Sequence[str]) -> Iterator[SearchFinding]:
        for name in list_builtin_worlds():
            yield read_world_metadata(Resource(name), read_builtin_world(name))
        if self._start is not None:
            yield _read_listed_file(self._start, self._start.name)
        for folder in self._folders:
            yield from _search_folder(folder, folder)
        for source in sources:
            yield from self._search_source(source)

    def _search_source(self, source: str) -> Iterator[SearchFinding]:
        name = _strip_world_scheme(source)
        for root in self._folders:
            if (folder := resolve_below(root, name)) is not None and folder.is_dir():
                yield from _search_folder(folder, root)
                return
        reason = f"source {source[:120]!r} is not a folder below `model_path`"
        yield SearchFailure(reason, is_own=False)

    def _from_file(self, name: str, uri: str) -> WorldText:
        file, folders = self._file(name)
        if file is None:
            raise RequestRefused(
                ResultCode.NOT_FOUND,
                f"world {uri[:120]!r} is neither built in nor below `model_path`; "
                "get_available_worlds lists all worlds",
            )
        if file.suffix not in WORLD_SUFFIXES:
            raise RequestRefused(
                LoadWorldCode.UNSUPPORTED_FORMAT,
                f"world {uri[:120]!r} ends in {file.suffix[:20]!r}; use .world or .sdf, both SDF",
            )
        text = _decode_world(read_regular_file(file, MAX_BYTES), uri)
        return WorldText(read_world_metadata(Resource(name), text), text, folders)

    def _file(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        start = self._start
        if start is not None and name in (start.name, start.stem, str(start), self._start_name):
            return (start if start.is_file() else None), (start.parent, *self._folders)
        for root in self._folders:
            for ending in ("", *WORLD_SUFFIXES):
                if (file := resolve_below(root, name + ending)) is not None and file.is_file():
                    return file, (file.parent, *self._folders)
        return None, ()


def is_file_needed(resource: Resource) -> bool:
    """Whether `WorldCatalog.find` reads a file of the operator for this resource."""
    return bool(resource.uri) and _strip_world_scheme(resource.uri) not in list_builtin_worlds()


def _decode_world(data: bytes | None, uri: str) -> str:
    if data is None:
        raise RequestRefused(
            LoadWorldCode.RESOURCE_PARSE_ERROR,
            f"world {uri[:120]!r} cannot be read, or has more than {MAX_BYTES} bytes; make it "
            "smaller",
        )
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise RequestRefused(
            LoadWorldCode.RESOURCE_PARSE_ERROR, f"world {uri[:120]!r} is not text in UTF-8"
        ) from error


def find_start_file(name: str) -> Path | None:
    """Find the world file that a server is started with; None for a built-in world."""
    return None if name in list_builtin_worlds() else Path(name)


def read_world_metadata(resource: Resource, text: str) -> WorldResource:
    """Read name, `<zensim:description>` and `<zensim:tags>` of a world file."""
    head = text[:HEAD_BYTES]
    named = _WORLD_TAG.search(head)
    begin = named.end() if named else len(head)
    content = _CONTENT_TAG.search(head, begin)
    metadata: dict[str, str] = {}
    for key, value in _METADATA_TAG.findall(head, begin, content.start() if content else len(head)):
        metadata.setdefault(key, " ".join(value.split()))
    tags = tuple(metadata.get("tags", "").replace(",", " ").split()[:MAX_TAGS])
    name = named[1] if named else Path(resource.uri).stem
    return WorldResource(name, resource, metadata.get("description", ""), tags)


def _strip_world_scheme(uri: str) -> str:
    for scheme in WORLD_SCHEMES:
        uri = uri.removeprefix(scheme)
    return uri


def resolve_below(root: Path, name: str) -> Path | None:
    """Resolve a path below a folder; None if it does not exist or is outside of the folder."""
    try:
        path = (root / name).resolve()
        return path if path.is_relative_to(root) and path.exists() else None
    except (OSError, ValueError):  # the name is too long or not valid
        return None


def _search_folder(folder: Path, root: Path) -> Iterator[SearchFinding]:
    if not os.access(folder, os.R_OK | os.X_OK):
        yield SearchFailure(f"folder {str(folder)!r} cannot be read")
        return
    left = MAX_VISITED_FILES
    for place, folders, files in os.walk(folder):
        folders.sort()
        left -= len(files) + 1
        if left < 0:
            yield SearchFailure(f"folder {str(folder)!r} has more than {MAX_VISITED_FILES} files")
            return
        yield None
        for path in (Path(place, name) for name in sorted(files) if name.endswith(WORLD_SUFFIXES)):
            is_inside = path.resolve().is_relative_to(root)
            yield _read_listed_file(path, str(path.relative_to(root))) if is_inside else None


def _read_listed_file(file: Path, uri: str) -> WorldResource | None:
    try:
        with open_regular_file(file) as stream:
            head = stream.read(HEAD_BYTES).decode(errors="replace")
    except (OSError, ValueError):
        return None
    return read_world_metadata(Resource(uri), head) if _WORLD_TAG.search(head) else None
