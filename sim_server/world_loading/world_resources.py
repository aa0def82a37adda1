"""Finds the models and meshes of a world in the operator's folders, and runs its parse job."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from zensim.proto.messages.asset_messages import (
    MAX_BUNDLE_BYTES,
    MAX_BUNDLE_FILES,
    MAX_FILE_BYTES,
    AssetRef,
    list_reference_uris,
    list_references,
    normalize_model_name,
    parse_fuel_uri,
)
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.strict_xml import MAX_BYTES, parse_xml
from zensim.sim_server.errors import ModelError
from zensim.sim_server.parser_process.parser_protocol import ParseRequest, ParseResult
from zensim.sim_server.world_loading.file_work import FileWork, read_regular_file
from zensim.sim_server.world_loading.world_catalog import resolve_below

if TYPE_CHECKING:
    from zensim.sim_server.description.sdf.sdf_includes import ResolveInclude
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.parser_process.description_cache import DescriptionProvider

RESOURCE_SCHEMES = ("model://", "package://", "file://")
_SLASHES = re.compile("/{2,}")
MODEL_CONFIG_FILE = "model.config"
DEFAULT_MODEL_FILE = "model.sdf"

FindFile = Callable[[str], Path | None]
"""Finds the file of a URI; None if there is none."""
FolderNames = Callable[[Path], dict[str, str]]
"""The names of the folders in a folder, by their normalized names."""
MAX_WORLD_FILES = 4 * MAX_BUNDLE_FILES
MAX_PARSE_ROUNDS = 20
"""Rounds of reading: each may add models that include others, nested 16 deep."""


def do_nothing() -> None:
    """Note no progress."""


def make_model_resolver(
    folders: Sequence[Path], on_progress: Callable[[], None] = do_nothing
) -> ResolveInclude:
    """Make a function that reads the SDF text of a model from the first folder that has it.

    `model://NAME` is the folder NAME, whose model.config names the file; `model://NAME/FILE` is
    that file; a relative path is below a folder; a URI of Gazebo Fuel is the folder with the name
    of its model. Files outside the folders are not read.
    """
    roots = [folder.resolve() for folder in folders]
    list_folders = cache(_list_folders)

    def resolve(uri: str) -> str | None:
        paths = (
            path
            for root in roots
            for part in _list_parts(uri, root, list_folders)
            if (path := resolve_below(root, part)) is not None
        )
        on_progress()
        return next((text for path in paths if (text := _read_model_text(path)) is not None), None)

    return resolve


def make_file_finder(folders: Sequence[Path]) -> FindFile:
    """Make a function that finds a file in the first folder that has it.

    `model://NAME/FILE` and `package://NAME/FILE` are NAME/FILE below a folder, or FILE below a
    folder called NAME; a relative path is below a folder; a file of a model of Gazebo Fuel is below
    the folder with the name of the model. Files outside are not found.
    """
    roots = [folder.resolve() for folder in folders]
    list_folders = cache(_list_folders)

    def find(uri: str) -> Path | None:
        places = [(root, part) for root in roots for part in _list_parts(uri, root, list_folders)]
        exact = (resolve_below(root, part) for root, part in places)
        found = next((path for path in exact if path is not None and path.is_file()), None)
        return found or next(
            (path for root, part in places if (path := _find_in_any_case(root, part))), None
        )

    return find


def _find_in_any_case(root: Path, part: str) -> Path | None:
    """Find a file whose name differs in case: authors have file systems that do not care."""
    folder, _, name = part.rpartition("/")
    where = resolve_below(root, folder or ".")
    if where is None or not where.is_dir():
        return None
    matches = sorted(one.name for one in where.iterdir() if one.name.lower() == name.lower())
    path = resolve_below(where, matches[0]) if matches else None
    is_inside = path is not None and path.is_relative_to(root) and path.is_file()
    return path if is_inside else None


def make_file_reader(
    folders: Sequence[Path], on_progress: Callable[[], None] = do_nothing
) -> Callable[[str], bytes | None]:
    """Make a function that reads what `make_file_finder` finds; None if missing or too large."""
    find = make_file_finder(folders)

    def read(uri: str) -> bytes | None:
        on_progress()
        file = find(uri)
        return None if file is None else read_regular_file(file, MAX_FILE_BYTES, on_progress)

    return read


def _list_folders(folder: Path) -> dict[str, str]:
    try:
        names = sorted(child.name for child in folder.iterdir() if child.is_dir())
    except OSError:
        return {}
    return {normalize_model_name(name): name for name in reversed(names)}


def _list_parts(uri: str, root: Path, list_folders: FolderNames) -> Iterator[str]:
    """List the paths below a root that a URI may mean, best first."""
    if (fuel := parse_fuel_uri(uri)) is not None:
        if folder := _find_fuel_folder(fuel.name, root, list_folders):
            yield f"{folder}/{fuel.file}"
        return
    part = _strip_scheme(uri)
    if not part:
        return
    name, _, inside = part.partition("/")
    model = resolve_below(root, name) if name and inside else None
    if model is not None and (beside := posixpath.dirname(_find_model_file(model))):
        # Gazebo resolves a relative path beside the file that names it.
        yield f"{name}/{beside}/{inside}"
    yield part
    if name == root.name and part != uri and inside:
        yield inside


def _find_fuel_folder(name: str, root: Path, list_folders: FolderNames) -> str:
    """Find the folder of a model by its name in any case, with `_` for spaces; empty without one.

    Fuel's own cache has a folder per version inside it, of which the newest is used.
    """
    folder = list_folders(root).get(normalize_model_name(name), "")
    if not folder:
        return ""
    versions = [inner for inner in list_folders(root / folder).values() if inner.isdecimal()]
    if versions and not (root / folder / DEFAULT_MODEL_FILE).is_file():
        return f"{folder}/{max(versions, key=int)}"
    return folder


def _strip_scheme(uri: str) -> str:
    """Find the path of a URI; slashes collapse, and only one at the start means an absolute path.

    That one is of a path or a `file://`: `model:///NAME` is `model://NAME`.
    """
    scheme = next((scheme for scheme in RESOURCE_SCHEMES if uri.startswith(scheme)), "")
    if not scheme and "://" in uri:
        return ""
    path = uri.removeprefix(scheme)
    may_be_absolute = scheme in ("", "file://") and not path.startswith("//")
    return _SLASHES.sub("/", path if may_be_absolute else path.lstrip("/"))


def _read_model_text(path: Path) -> str | None:
    if path.is_dir():
        named = resolve_below(path, _find_model_file(path))
        return _read_model_text(named) if named is not None and named.is_file() else None
    data = read_regular_file(path, MAX_BYTES)
    try:
        return None if data is None else data.decode()
    except UnicodeDecodeError:
        return None


def _find_model_file(folder: Path) -> str:
    """Choose the SDF file of a model folder: the newest version in its model.config."""
    config = resolve_below(folder, MODEL_CONFIG_FILE)
    text = _read_model_text(config) if config is not None and config.is_file() else None
    if text is None:
        return DEFAULT_MODEL_FILE
    try:
        listed = parse_xml(text, root_tag="model", slug="sdf").findall("sdf")
    except ModelError:
        return DEFAULT_MODEL_FILE
    versions = {(e.text or "").strip(): _parse_version(e.get("version") or "") for e in listed}
    return (
        max(versions, key=lambda name: versions[name], default=DEFAULT_MODEL_FILE)
        or DEFAULT_MODEL_FILE
    )


def _parse_version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".") if part.isdecimal())


class SuppliedFile(NamedTuple):
    """A file of a world."""

    uri: str
    name: str
    """SHA-256 of the file."""
    data: bytes


class WorldFiles:
    """Reads the files that a world names, from the operator's folders only."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = folders
        self._uris: set[str] = set()
        self._bytes = 0

    def read(self, uris: Iterable[str], on_progress: Callable[[], None]) -> list[SuppliedFile]:
        """Read the files that are new, and the materials and images that they name."""
        resolve = make_model_resolver(self._folders, on_progress)
        find = make_file_reader(self._folders, on_progress)
        files: list[SuppliedFile] = []
        for uri in uris:
            self._supply(uri, resolve, find, files)
        return files

    def _supply(
        self,
        uri: str,
        resolve: ResolveInclude,
        find: Callable[[str], bytes | None],
        files: list[SuppliedFile],
    ) -> bool:
        """Add a file, and what it names; return whether it is new."""
        if uri in self._uris:
            return False
        text = resolve(uri)
        data = text.encode() if text is not None else find(uri)
        if data is None or not self._has_room(data):
            return False
        self._uris.add(uri)
        files.append(SuppliedFile(uri, sha256(data).hexdigest(), data))
        for reference in list_references(uri, data):
            # The first of these that exists.
            for named in list_reference_uris(uri, reference):
                if named in self._uris or self._supply(named, resolve, find, files):
                    break
        return True

    def _has_room(self, data: bytes) -> bool:
        if len(self._uris) >= MAX_WORLD_FILES:
            return False
        self._bytes += len(data)
        return self._bytes <= MAX_BUNDLE_BYTES


class WorldParseJob:
    """Parses one world, whose files are read in a thread."""

    def __init__(
        self,
        text: str,
        folders: Sequence[Path],
        descriptions: DescriptionProvider,
        store: AssetStore,
        *,
        allow_missing: bool,
    ) -> None:
        self._text = text
        self._allow_missing = allow_missing
        self._files = WorldFiles(folders)
        self._descriptions = descriptions
        self._store = store
        self._supplied: dict[str, str] = {}
        self._parsed: ParseResult | None = None
        """The last result, while the files that it wants are read."""
        self._reading: FileWork[list[SuppliedFile]] | None = None
        self._result: ParseResult | None = None
        self._rounds = 0
        self._is_final_round = False
        self._submit()

    def poll(self) -> ParseResult | None:
        """Return the result; None until the job is done.

        Raises:
            FilesStalled: A file system does not answer.
        """
        if self._reading is not None and self._reading.is_over():
            new, self._reading = self._reading.outcome(), None
            self._store_files(new)
            self._go_on(has_new=bool(new))
        return self._result

    def _submit(self) -> None:
        self._rounds += 1
        self._descriptions.parse(
            ParseRequest(
                0,
                self._text,
                # Files may be missing only in the last round.
                allow_missing=self._is_final_round,
                assets=tuple(AssetRef(uri, name) for uri, name in self._supplied.items()),
                files=tuple(dict.fromkeys(self._supplied.values())),
                is_world=True,
            ),
            self._on_parsed,
        )

    def _on_parsed(self, result: ParseResult) -> None:
        self._parsed = result
        if result.wanted:
            self._reading = FileWork(partial(self._files.read, result.wanted))
        else:
            self._go_on(has_new=False)

    def _store_files(self, new: Iterable[SuppliedFile]) -> None:
        for file in new:
            self._store.add(file.name, file.data)
            self._supplied[file.uri] = file.name

    def _go_on(self, *, has_new: bool) -> None:
        parsed = self._parsed
        assert parsed is not None
        is_missing = parsed.code == SpawnCode.MISSING_ASSETS
        if has_new and self._rounds < MAX_PARSE_ROUNDS:
            self._submit()
        elif is_missing and self._allow_missing and not self._is_final_round:
            self._is_final_round = True
            self._submit()
        else:
            self._result = parsed
