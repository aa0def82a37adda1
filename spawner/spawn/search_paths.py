"""Search paths of the files that a description names.

A description may be untrusted: only files in a folder that the user gave, or in the package of the
description, are found. Symbolic links are resolved before this check.
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

import msgspec

from zensim.proto.bounded_files import MAX_TEXT_FILE_BYTES, open_regular_file, read_file

PATH_VARIABLES = (
    ("ROS_PACKAGE_PATH", ""),
    ("GAZEBO_MODEL_PATH", ""),
    ("GZ_SIM_RESOURCE_PATH", ""),
    ("AMENT_PREFIX_PATH", "share"),
)
"""Environment variables with lists of folders, and the subfolder that contains packages."""
PACKAGE_FILES = ("package.xml", "manifest.xml", "model.config")
PACKAGE_NAME = re.compile(r"<name>\s*([\w.-]+)\s*</name>")
FIND_PACKAGE = re.compile(r"(?<!\$)(?:file://)?\$\(\s*find(?:-pkg-share)?\s+([\w.-]+)\s*\)")
MODEL_FILE = re.compile(r"<sdf[^>]*>\s*([^<\s]+)\s*</sdf>")
PACKAGE_SCHEMES = ("package://", "model://")
FILE_SCHEME = "file://"
MAX_PACKAGE_FILE = 65536


class FileLocation(msgspec.Struct, frozen=True):
    """Path of a file, or the reason why it was not found."""

    path: Path | None = None
    reason: str = ""


class SearchPaths(msgspec.Struct, frozen=True):
    """Folders to search; resolved."""

    roots: tuple[Path, ...] = ()
    """Given by the user: options first, then environment variables."""
    folder: Path | None = None
    """Folder of the description."""

    @property
    def own_folders(self) -> tuple[Path, ...]:
        """The folder of the description and the packages that contain it."""
        if self.folder is None:
            return ()
        packages = (parent for parent in self.folder.parents if is_package(parent))
        return (self.folder, *packages)

    def with_folder_of(self, file: Path) -> "SearchPaths":
        """Add the folder of a description."""
        return SearchPaths(self.roots, file.resolve().parent)

    def find(self, uri: str) -> FileLocation:
        """Find the file of a URI in a description."""
        scheme, separator, _ = uri.partition("://")
        if separator and f"{scheme}://" not in (*PACKAGE_SCHEMES, FILE_SCHEME):
            return FileLocation(
                reason=f"scheme {scheme[:20]}:// is not supported; use a file on this host"
            )
        outside = None
        for candidate, allowed in self._candidates(uri):
            real = _resolve_file(candidate)
            if real is None:
                continue
            # `allowed` may be a symbolic link, and is then no prefix of a resolved path.
            if any(real.is_relative_to(root) for root in (allowed, *self.own_folders, *self.roots)):
                return FileLocation(real)
            outside = outside or real
        if outside is not None:
            hint = f"allow it with --package-path {outside.parent}"
            return FileLocation(reason=f"is outside the search paths; {hint}")
        return FileLocation(
            reason="no such file in the search paths; add its folder with --package-path "
            "(package_paths in a scenario), or to ROS_PACKAGE_PATH"
        )

    def find_model(self, uri: str) -> Path | None:
        """Find the file of an included model: `model://NAME`, or a path of an SDF file."""
        if uri.endswith(".sdf"):
            return self.find(uri).path
        scheme = next((known for known in PACKAGE_SCHEMES if uri.startswith(known)), "")
        for folder in self.package_folders(uri.removeprefix(scheme).strip("/")) if scheme else ():
            file = find_model_file(folder)
            if file and any(
                file.is_relative_to(r) for r in (folder, *self.own_folders, *self.roots)
            ):
                return file
        return None

    def package_folders(self, name: str) -> Iterator[Path]:
        """List the folders that may be the package or model of a name, best first."""
        if name in ("", ".", "..") or "/" in name:
            return
        yield from (
            folder
            for folder in self.own_folders
            if name in (folder.name, read_package_name(folder))
        )
        for root in self.roots:
            yield from _find_package_below(root, name)
        siblings = (own.parent / name for own in self.own_folders if is_package(own))
        yield from (folder for folder in siblings if is_package(folder))

    def _candidates(self, uri: str) -> Iterator[tuple[Path, Path]]:
        """List candidate paths, each with the folder that must contain it."""
        for text in dict.fromkeys((uri, unquote(uri))):
            scheme = next((known for known in PACKAGE_SCHEMES if text.startswith(known)), "")
            if scheme:
                name, _, inside = text.removeprefix(scheme).lstrip("/").partition("/")
                for folder in self.package_folders(name):
                    yield folder / inside.lstrip("/"), folder
            else:
                plain = text.removeprefix(FILE_SCHEME)
                # `//file.dae` is what remains of a folder without a name before `/file.dae`.
                names = dict.fromkeys((plain, plain.lstrip("/") if plain[:2] == "//" else plain))
                folders = (*self.own_folders[:1], *self.roots)
                yield from ((folder / name, folder) for name in names for folder in folders)


def collect_search_paths(folders: Sequence[Path], environment: Mapping[str, str]) -> SearchPaths:
    """Collect the folders of options and environment variables."""
    paths = [*folders]
    for variable, inside in PATH_VARIABLES:
        entries = environment.get(variable, "").split(os.pathsep)
        paths += [Path(entry) / inside for entry in entries if entry]
    roots = dict.fromkeys(path.resolve() for path in paths if path.is_dir())
    return SearchPaths(tuple(roots))


def to_package_uris(text: str) -> str:
    """Replace each `$(find PACKAGE)` of xacro and of launch files by `package://PACKAGE`."""
    return FIND_PACKAGE.sub(r"package://\1", text)


def is_package(folder: Path) -> bool:
    """Whether a folder is a package of ROS or a model of Gazebo."""
    return any((folder / name).is_file() for name in PACKAGE_FILES)


def read_package_name(folder: Path) -> str:
    """Read the package name in package.xml; empty if there is none."""
    match = PACKAGE_NAME.search(read_manifest(folder))
    return match[1] if match else ""


def read_manifest(folder: Path) -> str:
    """Read package.xml; empty if there is none."""
    try:
        with open_regular_file(folder / "package.xml") as file:
            return file.read(MAX_PACKAGE_FILE).decode(errors="replace")
    except OSError:
        return ""


def find_model_file(folder: Path) -> Path | None:
    """Find the last file named in model.config, or model.sdf; only inside the folder."""
    config = folder / "model.config"
    text = (
        read_file(config, MAX_TEXT_FILE_BYTES).decode(errors="replace") if config.is_file() else ""
    )
    for name in (*reversed(MODEL_FILE.findall(text)), "model.sdf", "model.urdf"):
        file = _resolve_file(folder / name)
        if file and file.is_relative_to(folder.resolve()):
            return file
    return None


def _find_package_below(root: Path, name: str) -> Iterator[Path]:
    """Find a package at most two folders below a root, as in a workspace of repositories."""
    if name in (root.name, read_package_name(root)):
        yield root
    level, below = [root], list[Path]()
    for _ in range(3):
        yield from (folder / name for folder in level if (folder / name).is_dir())
        level = [child for folder in level for child in list_folders(folder)]
        below += level
    yield from (one for one in below if one.name != name and read_package_name(one) == name)


def list_folders(folder: Path) -> list[Path]:
    """List the folders in a folder; empty if it cannot be read."""
    try:
        return sorted(child for child in folder.iterdir() if child.is_dir())
    except OSError:
        return []


def _resolve_file(path: Path) -> Path | None:
    try:
        real = path.resolve()
        return real if real.is_file() else None
    except (OSError, RuntimeError, ValueError):  # a loop of links, too long, or with NUL
        return None
