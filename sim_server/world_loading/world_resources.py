"""Finds the models and meshes of a world in the operator's folders, and runs its parse job."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

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
from zensim.sim_server.description.strict_parsing import MAX_BYTES, parse_xml
from zensim.sim_server.errors import ModelError
from zensim.sim_server.parser_process.parser_protocol import ParseRequest, ParseResult
from zensim.sim_server.world_loading.world_catalog import resolve_below

if TYPE_CHECKING:
    from zensim.sim_server.description.sdf.sdf_includes import ResolveInclude
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.parser_process.description_cache import DescriptionProvider

RESOURCE_SCHEMES = ("model://", "package://", "file://")
MODEL_CONFIG_FILE = "model.config"
DEFAULT_MODEL_FILE = "model.sdf"

FindFile = Callable[[str], Path | None]
"""Finds the file of a URI; None if there is none."""


def make_model_resolver(folders: Sequence[Path]) -> ResolveInclude:
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


def make_file_reader(folders: Sequence[Path]) -> Callable[[str], bytes | None]:
    """Make a function that reads what `make_file_finder` finds; None if missing or too large."""
    find = make_file_finder(folders)

    def read(uri: str) -> bytes | None:
        file = find(uri)
        if file is None or not os.access(file, os.R_OK) or file.stat().st_size > MAX_FILE_BYTES:
            return None
        return file.read_bytes()

    return read


FolderNames = Callable[[Path], dict[str, str]]
"""The names of the folders in a folder, by their normalized names."""


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
    yield part
    name, _, inside = part.partition("/")
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
    for scheme in RESOURCE_SCHEMES:
        if uri.startswith(scheme):
            return uri.removeprefix(scheme)
    return "" if "://" in uri else uri


def _read_model_text(path: Path) -> str | None:
    if path.is_dir():
        named = resolve_below(path, _find_model_file(path))
        return _read_model_text(named) if named is not None and named.is_file() else None
    try:
        return path.read_text(encoding="utf-8") if path.stat().st_size <= MAX_BYTES else None
    except (OSError, UnicodeDecodeError):
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


MAX_WORLD_FILES = 4 * MAX_BUNDLE_FILES
MAX_PARSE_ROUNDS = 20
"""Each may add models that include others, nested 16 deep."""


class WorldParseJob:
    """Parses one world; files are read from the operator's folders only."""

    def __init__(
        self,
        text: str,
        folders: Sequence[Path],
        descriptions: DescriptionProvider,
        store: AssetStore,
        *,
        allow_missing: bool,
    ) -> None:
        self.result: ParseResult | None = None
        """None until the job is done."""
        self._text = text
        self._allow_missing = allow_missing
        self._resolve, self._find = make_model_resolver(folders), make_file_reader(folders)
        self._descriptions = descriptions
        self._store = store
        self._supplied: dict[str, str] = {}
        self._supplied_bytes = self._rounds = 0
        self._is_final_round = False
        self._submit()

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
        new = [uri for uri in result.wanted if self._supply(uri)]
        if new and self._rounds < MAX_PARSE_ROUNDS:
            self._submit()
        elif (
            result.code == SpawnCode.MISSING_ASSETS
            and self._allow_missing
            and not self._is_final_round
        ):
            self._is_final_round = True
            self._submit()
        else:
            self.result = result

    def _supply(self, uri: str) -> bool:
        """Add a file, and the materials and images that it names; return whether it is new."""
        if uri in self._supplied:
            return False
        text = self._resolve(uri)
        data = text.encode() if text is not None else self._find(uri)
        if data is None or not self._add(uri, data):
            return False
        for reference in list_references(uri, data):
            self._supply_first(list_reference_uris(uri, reference))
        return True

    def _supply_first(self, uris: Iterable[str]) -> None:
        """Add the first of these files that exists."""
        for uri in uris:
            if uri in self._supplied or self._supply(uri):
                return

    def _add(self, uri: str, data: bytes) -> bool:
        if len(self._supplied) >= MAX_WORLD_FILES:
            return False
        self._supplied_bytes += len(data)
        if self._supplied_bytes > MAX_BUNDLE_BYTES:
            return False
        name = sha256(data).hexdigest()
        self._store.add(name, data)
        self._supplied[uri] = name
        return True
