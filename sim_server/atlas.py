"""The worlds that can be loaded: those that come with the server, and the operator's files.

No file is opened because a request names it, unless it lies below a folder that the operator gave.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from proto.result import LoadWorldCode, ResultCode
from proto.services import Resource
from proto.worlds import WorldResource
from sim_server.description.library import shipped_worlds, world_text
from sim_server.description.strict_xml import MAX_BYTES
from sim_server.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Sequence

ENDINGS = (".world", ".sdf")
SCHEMES = ("zensim://", "file://")
ONLINE = ("http://", "https://")
HEAD_BYTES = 64 << 10
"""Of a file: what is said of the world stands at its beginning."""
MAX_VISITED = 10_000
"""Files and folders that one listing looks at."""
MAX_TAGS = 32
_WORLD = re.compile(r"<world\s[^<>]{0,500}?name\s{0,9}=\s{0,9}[\"']([^\"'<>]{1,200})[\"']")
_CONTENT = re.compile(r"<(?:frame|model)\b")
"""What follows the words of the world itself; frames have words of their own."""
_SAID = re.compile(r"<zensim:(description|tags)>([^<]{0,1000})</zensim:")


@dataclass(frozen=True)
class Listing:
    """Worlds, and why some places could not be looked into."""

    worlds: tuple[WorldResource, ...] = ()
    failures: tuple[str, ...] = ()


@dataclass(frozen=True)
class WorldText:
    """A world before it is read.

    Attributes:
        folders: Where its models and meshes may be.
    """

    resource: WorldResource
    text: str
    folders: tuple[Path, ...] = ()


class Atlas:
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
            raise Refused(
                LoadWorldCode.NO_RESOURCE,
                "world_resource is empty; give a uri that get_available_worlds lists, or SDF",
            )
        if not resource.uri:
            text = resource.resource_string
            return WorldText(described(resource, text), text, self._folders)
        name = _without_scheme(resource.uri)
        if name in shipped_worlds():
            text = world_text(name)
            return WorldText(described(Resource(name), text), text)
        return self._from_file(name, resource.uri)

    def started(self, name: str, model_name: str) -> WorldResource:
        """Say how to ask for the world that a server has at its start.

        Args:
            name: That its command line gives.
            model_name: Of the world; another one when a journal brought it back.
        """
        try:
            found = self.find(Resource(name)).resource
        except Refused:  # restored, and its file has gone
            found = WorldResource()
        if found.name == model_name:
            return found
        alike = (world for world in self.default().worlds if world.name == model_name)
        return next(alike, WorldResource(model_name))

    def default(self) -> Listing:
        """List what ships and what is in the operator's folders."""
        worlds = [described(Resource(name), world_text(name)) for name in shipped_worlds()]
        start = self._start
        if start is not None and (started := _listed(start, start.name)) is not None:
            worlds.append(started)
        return _joined([Listing(tuple(worlds)), *(_in_folder(one, one) for one in self._folders)])

    def below(self, source: str) -> Listing:
        """List what is in a folder below the operator's."""
        name = _without_scheme(source)
        for root in self._folders:
            if (folder := _inside(root, name)) is not None and folder.is_dir():
                return _in_folder(folder, root)
        return Listing((), (f"source {source[:120]!r} is no folder below those of --model-path",))

    def _from_file(self, name: str, uri: str) -> WorldText:
        file, folders = self._file(name)
        if file is None:
            raise Refused(
                ResultCode.NOT_FOUND,
                f"no world {uri[:120]!r} comes with the server or lies below --model-path; "
                "get_available_worlds lists those that do",
            )
        if file.suffix not in ENDINGS:
            raise Refused(
                LoadWorldCode.UNSUPPORTED_FORMAT,
                f"world {uri[:120]!r} ends in {file.suffix[:20]!r}; use .world or .sdf, both SDF",
            )
        try:
            if file.stat().st_size > MAX_BYTES:
                raise Refused(
                    LoadWorldCode.RESOURCE_PARSE_ERROR,
                    f"world {uri[:120]!r} has more than {MAX_BYTES} bytes; make it smaller",
                )
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise Refused(
                LoadWorldCode.RESOURCE_PARSE_ERROR,
                f"world {uri[:120]!r} cannot be read as text: {type(error).__name__}",
            ) from error
        return WorldText(described(Resource(name), text), text, folders)

    def _file(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        start = self._start
        if start is not None and name in (start.name, start.stem, str(start), self._start_name):
            return (start if start.is_file() else None), (start.parent, *self._folders)
        for root in self._folders:
            for ending in ("", *ENDINGS):
                if (file := _inside(root, name + ending)) is not None and file.is_file():
                    return file, (file.parent, *self._folders)
        return None, ()


def start_file(name: str) -> Path | None:
    """Find the file that a server is started with; None when its world is a shipped one."""
    return None if name in shipped_worlds() else Path(name)


def described(resource: Resource, text: str) -> WorldResource:
    """Say what a world's file says of itself: its name, `<zensim:description>`, `<zensim:tags>`."""
    head = text[:HEAD_BYTES]
    named = _WORLD.search(head)
    begin = named.end() if named else len(head)
    content = _CONTENT.search(head, begin)
    said: dict[str, str] = {}
    for what, words in _SAID.findall(head, begin, content.start() if content else len(head)):
        said.setdefault(what, " ".join(words.split()))
    tags = tuple(said.get("tags", "").replace(",", " ").split()[:MAX_TAGS])
    name = named[1] if named else Path(resource.uri).stem
    return WorldResource(name, resource, said.get("description", ""), tags)


def _without_scheme(uri: str) -> str:
    for scheme in SCHEMES:
        uri = uri.removeprefix(scheme)
    return uri


def _inside(root: Path, name: str) -> Path | None:
    try:
        place = (root / name).resolve()
        return place if place.is_relative_to(root) and place.exists() else None
    except (OSError, ValueError):  # a name too long, or one that no file can have
        return None


def _joined(listings: Sequence[Listing]) -> Listing:
    return Listing(
        tuple(world for listing in listings for world in listing.worlds),
        tuple(failure for listing in listings for failure in listing.failures),
    )


def _in_folder(folder: Path, root: Path) -> Listing:
    if not os.access(folder, os.R_OK | os.X_OK):
        return Listing((), (f"folder {str(folder)!r} cannot be looked into",))
    worlds: list[WorldResource] = []
    left = MAX_VISITED
    for place, folders, files in os.walk(folder):
        folders.sort()
        left -= len(files) + 1
        if left < 0:
            failure = f"folder {str(folder)!r} holds more than {MAX_VISITED} files"
            return Listing(tuple(worlds), (failure,))
        paths = [Path(place, name) for name in sorted(files) if name.endswith(ENDINGS)]
        found = [_listed(path, str(path.relative_to(root))) for path in paths if _is_in(root, path)]
        worlds += [world for world in found if world is not None]
    return Listing(tuple(worlds))


def _is_in(root: Path, path: Path) -> bool:
    """Whether a path is still below a folder once links are followed."""
    return path.resolve().is_relative_to(root)


def _listed(file: Path, uri: str) -> WorldResource | None:
    try:
        with file.open(encoding="utf-8", errors="replace") as opened:
            head = opened.read(HEAD_BYTES)
    except OSError:
        return None
    return described(Resource(uri), head) if _WORLD.search(head) else None
