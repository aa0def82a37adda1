"""Models and meshes on the server's own host, for its own world files, never for a request."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from zensim.proto.messages.asset_messages import MAX_FILE_BYTES
from zensim.sim_server.description.strict_parsing import MAX_BYTES, parse_xml
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from zensim.sim_server.description.sdf.sdf_includes import ResolveInclude

SCHEMES = ("model://", "package://", "file://")
CONFIG = "model.config"
USUAL = "model.sdf"

FindFile = Callable[[str], Path | None]
"""The file that a URI stands for; None when it is not here."""


def models_in(folders: Sequence[Path]) -> ResolveInclude:
    """Look for models below these folders, the first that has one counts.

    `model://NAME` is the folder NAME, whose model.config says which file; `model://NAME/FILE` is
    that file; a relative path is below a folder. Nothing outside the folders is read.
    """
    roots = [folder.resolve() for folder in folders]

    def resolve(uri: str) -> str | None:
        part = _part(uri)
        places = [place for root in roots if part and (place := _below(root, part)) is not None]
        return next((text for place in places if (text := _text(place)) is not None), None)

    return resolve


def files_in(folders: Sequence[Path]) -> FindFile:
    """Look for files below these folders, the first that has one counts.

    `model://NAME/FILE` and `package://NAME/FILE` are NAME/FILE below a folder, or FILE below a
    folder called NAME; a relative path is below a folder. Nothing outside the folders is there.
    """
    roots = [folder.resolve() for folder in folders]

    def find(uri: str) -> Path | None:
        part = _part(uri)
        name, _, inside = part.partition("/")
        places = (
            _below(root, path)
            for root in roots
            for path in (part, inside if name == root.name and part != uri else "")
            if path
        )
        return next((place for place in places if place is not None and place.is_file()), None)

    return find


def bytes_in(folders: Sequence[Path]) -> Callable[[str], bytes | None]:
    """Read files below these folders, found as `files_in` does; None when too large or not here."""
    find = files_in(folders)

    def read(uri: str) -> bytes | None:
        file = find(uri)
        if file is None or not os.access(file, os.R_OK) or file.stat().st_size > MAX_FILE_BYTES:
            return None
        return file.read_bytes()

    return read


def _part(uri: str) -> str:
    for scheme in SCHEMES:
        if uri.startswith(scheme):
            return uri.removeprefix(scheme)
    return "" if "://" in uri else uri


def _below(root: Path, part: str) -> Path | None:
    try:
        place = (root / part).resolve()
        return place if place.is_relative_to(root) and place.exists() else None
    except (OSError, ValueError):  # a name too long, or one that no file can have
        return None


def _text(place: Path) -> str | None:
    if place.is_dir():
        named = _below(place, _configured(place))
        return _text(named) if named is not None and named.is_file() else None
    try:
        return place.read_text(encoding="utf-8") if place.stat().st_size <= MAX_BYTES else None
    except (OSError, UnicodeDecodeError):
        return None


def _configured(folder: Path) -> str:
    """Name the SDF file of a model's folder: the newest version that its model.config lists."""
    config = _below(folder, CONFIG)
    text = _text(config) if config is not None and config.is_file() else None
    if text is None:
        return USUAL
    try:
        listed = parse_xml(text, root_tag="model", slug="sdf").findall("sdf")
    except ModelError:
        return USUAL
    versions = {(e.text or "").strip(): _version(e.get("version") or "") for e in listed}
    return max(versions, key=lambda name: versions[name], default=USUAL) or USUAL


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".") if part.isdecimal())
