"""The worlds that can be loaded: shipped worlds and world files below the operator's folders."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from zensim.proto.messages.result_messages import LoadWorldCode, ResultCode
from zensim.proto.messages.spawn_messages import Resource
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.strict_parsing import MAX_BYTES
from zensim.sim_server.errors import RequestRefused

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

WORLD_SUFFIXES = (".world", ".sdf")
WORLD_SCHEMES = ("zensim://", "file://")
ONLINE_SCHEMES = ("http://", "https://")
HEAD_BYTES = 64 << 10
"""Of a file: what is said of the world stands at its beginning."""
MAX_VISITED_FILES = 10_000
"""Files and folders that one listing looks at."""
FILES_PER_TURN = 8
"""Opened and read at each turn of the loop: 1 ms."""
MAX_TAGS = 32
_WORLD_TAG = re.compile(r"<world\s[^<>]{0,500}?name\s{0,9}=\s{0,9}[\"']([^\"'<>]{1,200})[\"']")
_CONTENT_TAG = re.compile(r"<(?:frame|model)\b")
"""What follows the words of the world itself; frames have words of their own."""
_METADATA_TAG = re.compile(r"<zensim:(description|tags)>([^<]{0,1000})</zensim:")


@dataclass(frozen=True)
class SearchFailure:
    """A place that could not be looked into.

    Attributes:
        is_own: Whether the operator gave it, not a request.
    """

    reason: str
    is_own: bool = True


SearchFinding = WorldResource | SearchFailure | None
"""What one file came to."""


class WorldSearch:
    """Looks for worlds, a few files at a time."""

    def __init__(self, findings: Iterator[SearchFinding]) -> None:
        self.worlds: list[WorldResource] = []
        self.failures: list[SearchFailure] = []
        self.is_over = False
        self._findings = findings

    def go_on(self, files: int | None = FILES_PER_TURN) -> bool:
        """Look at so many more files, or at all; say whether there are no more."""
        looked_at = 0
        for finding in islice(self._findings, files):
            looked_at += 1
            if isinstance(finding, WorldResource):
                self.worlds.append(finding)
            elif finding is not None:
                self.failures.append(finding)
        self.is_over = files is None or looked_at < files
        return self.is_over


@dataclass(frozen=True)
class WorldText:
    """A world before it is read.

    Attributes:
        folders: Where its models and meshes may be.
    """

    resource: WorldResource
    text: str
    folders: tuple[Path, ...] = ()


class WorldCatalog:
    """Finds worlds by name."""

    def __init__(self, folders: Sequence[Path], start: Path | None = None) -> None:
        """Take the operator's folders, and the file that the server was started with, if any."""
        self._folders = tuple(folder.resolve() for folder in folders)
        self._start = start.resolve() if start is not None else None
        self._start_name = str(start)

    def find(self, resource: Resource) -> WorldText:
        """Find what a request asks for.

        Raises:
            Refused: It names nothing that may be loaded.
        """
        if not (resource.uri or resource.resource_string):
            raise RequestRefused(
                LoadWorldCode.NO_RESOURCE,
                "world_resource is empty; give a uri that get_available_worlds lists, or SDF",
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
        """Say how to ask for the world that a server has at its start.

        Args:
            name: That its command line gives.
            model_name: Of the world; another one when a journal brought it back.
        """
        try:
            found = self.find(Resource(name)).resource
        except RequestRefused:  # restored, and its file has gone
            found = WorldResource()
        if found.name == model_name:
            return found
        search = self.search()
        search.go_on(None)
        alike = (world for world in search.worlds if world.name == model_name)
        return next(alike, WorldResource(model_name))

    def search(self, sources: Sequence[str] = ()) -> WorldSearch:
        """Look for what ships, in the operator's folders, and in further ones below those."""
        return WorldSearch(self._findings(sources))

    def _findings(self, sources: Sequence[str]) -> Iterator[SearchFinding]:
        for name in list_builtin_worlds():
            yield read_world_metadata(Resource(name), read_builtin_world(name))
        if self._start is not None:
            yield _read_listed_file(self._start, self._start.name)
        for folder in self._folders:
            yield from _search_folder(folder, folder)
        for source in sources:
            yield from self._below(source)

    def _below(self, source: str) -> Iterator[SearchFinding]:
        name = _strip_world_scheme(source)
        for root in self._folders:
            if (folder := _resolve_inside(root, name)) is not None and folder.is_dir():
                yield from _search_folder(folder, root)
                return
        reason = f"source {source[:120]!r} is no folder below those of --model-path"
        yield SearchFailure(reason, is_own=False)

    def _from_file(self, name: str, uri: str) -> WorldText:
        file, folders = self._file(name)
        if file is None:
            raise RequestRefused(
                ResultCode.NOT_FOUND,
                f"no world {uri[:120]!r} comes with the server or lies below --model-path; "
                "get_available_worlds lists those that do",
            )
        if file.suffix not in WORLD_SUFFIXES:
            raise RequestRefused(
                LoadWorldCode.UNSUPPORTED_FORMAT,
                f"world {uri[:120]!r} ends in {file.suffix[:20]!r}; use .world or .sdf, both SDF",
            )
        try:
            if file.stat().st_size > MAX_BYTES:
                raise RequestRefused(
                    LoadWorldCode.RESOURCE_PARSE_ERROR,
                    f"world {uri[:120]!r} has more than {MAX_BYTES} bytes; make it smaller",
                )
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise RequestRefused(
                LoadWorldCode.RESOURCE_PARSE_ERROR,
                f"world {uri[:120]!r} cannot be read as text: {type(error).__name__}",
            ) from error
        return WorldText(read_world_metadata(Resource(name), text), text, folders)

    def _file(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        start = self._start
        if start is not None and name in (start.name, start.stem, str(start), self._start_name):
            return (start if start.is_file() else None), (start.parent, *self._folders)
        for root in self._folders:
            for ending in ("", *WORLD_SUFFIXES):
                if (file := _resolve_inside(root, name + ending)) is not None and file.is_file():
                    return file, (file.parent, *self._folders)
        return None, ()


def find_start_file(name: str) -> Path | None:
    """Find the file that a server is started with; None when its world is a shipped one."""
    return None if name in list_builtin_worlds() else Path(name)


def read_world_metadata(resource: Resource, text: str) -> WorldResource:
    """Say what a world's file says of itself: its name, `<zensim:description>`, `<zensim:tags>`."""
    head = text[:HEAD_BYTES]
    named = _WORLD_TAG.search(head)
    begin = named.end() if named else len(head)
    content = _CONTENT_TAG.search(head, begin)
    said: dict[str, str] = {}
    for what, words in _METADATA_TAG.findall(
        head, begin, content.start() if content else len(head)
    ):
        said.setdefault(what, " ".join(words.split()))
    tags = tuple(said.get("tags", "").replace(",", " ").split()[:MAX_TAGS])
    name = named[1] if named else Path(resource.uri).stem
    return WorldResource(name, resource, said.get("description", ""), tags)


def _strip_world_scheme(uri: str) -> str:
    for scheme in WORLD_SCHEMES:
        uri = uri.removeprefix(scheme)
    return uri


def _resolve_inside(root: Path, name: str) -> Path | None:
    try:
        place = (root / name).resolve()
        return place if place.is_relative_to(root) and place.exists() else None
    except (OSError, ValueError):  # a name too long, or one that no file can have
        return None


def _search_folder(folder: Path, root: Path) -> Iterator[SearchFinding]:
    if not os.access(folder, os.R_OK | os.X_OK):
        yield SearchFailure(f"folder {str(folder)!r} cannot be looked into")
        return
    left = MAX_VISITED_FILES
    for place, folders, files in os.walk(folder):
        folders.sort()
        left -= len(files) + 1
        if left < 0:
            yield SearchFailure(f"folder {str(folder)!r} holds more than {MAX_VISITED_FILES} files")
            return
        yield None
        for path in (Path(place, name) for name in sorted(files) if name.endswith(WORLD_SUFFIXES)):
            is_inside = _is_inside(root, path)
            yield _read_listed_file(path, str(path.relative_to(root))) if is_inside else None


def _is_inside(root: Path, path: Path) -> bool:
    """Whether a path is still below a folder once links are followed."""
    return path.resolve().is_relative_to(root)


def _read_listed_file(file: Path, uri: str) -> WorldResource | None:
    try:
        with file.open(encoding="utf-8", errors="replace") as opened:
            head = opened.read(HEAD_BYTES)
    except OSError:
        return None
    return read_world_metadata(Resource(uri), head) if _WORLD_TAG.search(head) else None
