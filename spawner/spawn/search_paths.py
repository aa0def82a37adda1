"""Where the files that a description names are looked for, on the operator's host.

A description may be untrusted: only files in a folder that the operator named, or in the package that
holds the description, are found. Links are resolved before this check.
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

import msgspec

PATH_VARIABLES = (
    ("ROS_PACKAGE_PATH", ""),
    ("GAZEBO_MODEL_PATH", ""),
    ("GZ_SIM_RESOURCE_PATH", ""),
    ("AMENT_PREFIX_PATH", "share"),
)
"""Lists of folders, and which folder inside each holds packages."""
PACKAGE_FILES = ("package.xml", "manifest.xml", "model.config")
PACKAGE_NAME = re.compile(r"<name>\s*([\w.-]+)\s*</name>")
MODEL_FILE = re.compile(r"<sdf[^>]*>\s*([^<\s]+)\s*</sdf>")
PACKAGE_SCHEMES = ("package://", "model://")
FILE_SCHEME = "file://"
MAX_PACKAGE_FILE = 65536


class FileLocation(msgspec.Struct, frozen=True):
    """Where a file is, or why it is nowhere."""

    path: Path | None = None
    reason: str = ""


class SearchPaths(msgspec.Struct, frozen=True):
    """Folders to look in; all resolved."""

    roots: tuple[Path, ...] = ()
    """Named by the operator: options first, then the environment."""
    folder: Path | None = None
    """Where the description lies."""

    @property
    def own(self) -> tuple[Path, ...]:
        """The description's folder and the packages around it."""
        if self.folder is None:
            return ()
        packages = (parent for parent in self.folder.parents if is_package(parent))
        return (self.folder, *packages)

    def beside(self, file: Path) -> "SearchPaths":
        """Look beside this description too."""
        return SearchPaths(self.roots, file.resolve().parent)

    def find(self, uri: str) -> FileLocation:
        """Look for the file that a description means by this uri."""
        scheme, separator, _ = uri.partition("://")
        if separator and f"{scheme}://" not in (*PACKAGE_SCHEMES, FILE_SCHEME):
            return FileLocation(
                reason=f"{scheme[:20]}:// is not fetched; put the file on this host"
            )
        outside = None
        for candidate, allowed in self._candidates(uri):
            real = _resolve_file(candidate)
            if real is None:
                continue
            # A folder that is a link to elsewhere is a prefix of nothing real.
            if any(real.is_relative_to(root) for root in (allowed, *self.own, *self.roots)):
                return FileLocation(real)
            outside = outside or real
        if outside is not None:
            hint = f"allow it by --package-path {outside.parent}"
            return FileLocation(reason=f"is outside the search paths; {hint}")
        return FileLocation(
            reason="no such file in the search paths; name its folder by --package-path"
        )

    def find_model(self, uri: str) -> Path | None:
        """Look for the SDF of a model that another includes: `model://NAME`, or the file itself."""
        if uri.endswith(".sdf"):
            return self.find(uri).path
        scheme = next((known for known in PACKAGE_SCHEMES if uri.startswith(known)), "")
        for folder in self.package_folders(uri.removeprefix(scheme)) if scheme else ():
            file = find_model_file(folder)
            if file and any(file.is_relative_to(r) for r in (folder, *self.own, *self.roots)):
                return file
        return None

    def package_folders(self, name: str) -> Iterator[Path]:
        """List the folders that may be the package or model of this name, best first."""
        if name in ("", ".", "..") or "/" in name:
            return
        yield from (
            folder for folder in self.own if name in (folder.name, read_package_name(folder))
        )
        for root in self.roots:
            yield from _find_package_below(root, name)
        beside = (home.parent / name for home in self.own if is_package(home))
        yield from (folder for folder in beside if is_package(folder))

    def _candidates(self, uri: str) -> Iterator[tuple[Path, Path]]:
        """List where the file may be, each with a folder that it must not leave."""
        for text in dict.fromkeys((uri, unquote(uri))):
            scheme = next((known for known in PACKAGE_SCHEMES if text.startswith(known)), "")
            if scheme:
                name, _, inside = text.removeprefix(scheme).partition("/")
                for folder in self.package_folders(name):
                    yield folder / inside, folder
            else:
                plain = text.removeprefix(FILE_SCHEME)
                yield from ((folder / plain, folder) for folder in (*self.own[:1], *self.roots))


def collect_search_paths(named: Sequence[Path], environment: Mapping[str, str]) -> SearchPaths:
    """Collect the folders that the operator named, by options or by the environment."""
    found = [*named]
    for variable, inside in PATH_VARIABLES:
        entries = environment.get(variable, "").split(os.pathsep)
        found += [Path(entry) / inside for entry in entries if entry]
    roots = dict.fromkeys(path.resolve() for path in found if path.is_dir())
    return SearchPaths(tuple(roots))


def is_package(folder: Path) -> bool:
    """Whether ROS or Gazebo would take this folder for a package or a model."""
    return any((folder / name).is_file() for name in PACKAGE_FILES)


def read_package_name(folder: Path) -> str:
    """Read the name that a folder's package.xml gives it; empty when there is none."""
    try:
        with (folder / "package.xml").open(encoding="utf-8", errors="replace") as file:
            match = PACKAGE_NAME.search(file.read(MAX_PACKAGE_FILE))
    except OSError:
        return ""
    return match[1] if match else ""


def find_model_file(folder: Path) -> Path | None:
    """Find the newest file that a model's model.config names, or model.sdf; inside the folder."""
    config = folder / "model.config"
    names = MODEL_FILE.findall(config.read_text(errors="replace")) if config.is_file() else []
    for name in (*reversed(names), "model.sdf", "model.urdf"):
        file = _resolve_file(folder / name)
        if file and file.is_relative_to(folder.resolve()):
            return file
    return None


def _find_package_below(root: Path, name: str) -> Iterator[Path]:
    """Find a package in a root, at most two folders down, as a workspace of repositories has it."""
    if name in (root.name, read_package_name(root)):
        yield root
    level = [root]
    for _ in range(3):
        yield from (folder / name for folder in level if (folder / name).is_dir())
        level = [child for folder in level for child in _list_folders(folder)]


def _list_folders(folder: Path) -> list[Path]:
    try:
        return sorted(child for child in folder.iterdir() if child.is_dir())
    except OSError:
        return []


def _resolve_file(path: Path) -> Path | None:
    try:
        real = path.resolve()
        return real if real.is_file() else None
    except (OSError, ValueError):  # a name too long, or one that no file can have
        return None
