"""xacro to URDF, on the operator's host: macros read files, so that no server may expand them."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from xml.parsers.expat import ExpatError

from spawner.markup import DescriptionError, without_comments
from spawner.search_paths import SearchPaths, is_package, package_name

ENDING = ".xacro"
MARK = "<xacro:"
XACRO_PACKAGES = ("xacrodoc", "xacro", "rospkg")


def needs_expansion(text: str, path: Path) -> bool:
    """Whether a file is xacro: by its ending, or by the tags in it, comments apart."""
    return path.suffix == ENDING or MARK in without_comments(text)


def arguments_of(words: Sequence[str]) -> dict[str, str]:
    """Read `key:=value` words.

    Raises:
        ValueError: One is none.
    """
    pairs = [word.partition(":=") for word in words]
    for word, (key, separator, _) in zip(words, pairs, strict=True):
        if not key or not separator:
            raise ValueError(f"--xacro-arg {word[:80]!r} is no argument; use key:=value")
    return {key: value for key, _, value in pairs}


def expanded(text: str, path: Path, arguments: Mapping[str, str], paths: SearchPaths) -> str:
    """Expand xacro.

    Args:
        text: What is in the file.
        path: The file; includes are relative to its folder.
        arguments: Values of its `<xacro:arg>`s.
        paths: Where `$(find PACKAGE)` looks, besides ROS's own places.

    Raises:
        DescriptionError: It cannot be expanded, or xacrodoc is not installed.
    """
    xacro, packages = _xacro(path)
    packages.reset()
    packages.look_in([str(root) for root in paths.roots])
    packages.walk_up_from(path)
    packages.update_package_cache(_packages_known(paths))
    try:
        xacro.init_stacks(str(path))
        document = xacro.parse(text, str(path))
        xacro.process_doc(document, mappings=dict(arguments))
    except (
        xacro.XacroException,
        packages.PackageNotFoundError,
        ExpatError,
        OSError,
        RecursionError,
        ValueError,
    ) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DescriptionError(
            f"{path} cannot be expanded: {reason[:300]}; give arguments by --xacro-arg key:=value "
            "and packages by --package-path"
        ) from error
    found: str = document.documentElement.toxml()
    return found


def _xacro(path: Path) -> tuple[ModuleType, ModuleType]:
    try:
        # xacrodoc comes first: it teaches xacro to find packages without ROS.
        packages = import_module("xacrodoc.packages")
        return import_module("xacro"), packages
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in XACRO_PACKAGES:
            raise
        raise DescriptionError(
            f"{path} is xacro, and {error.name} is not installed; use pip install 'zensim[xacro]', "
            "or expand it by hand"
        ) from error


def _packages_known(paths: SearchPaths) -> dict[str, str]:
    """Name the folders that are packages to us: those of the search paths, and neighbours."""
    known: dict[str, str] = {}
    for own in paths.own:
        if is_package(own):
            neighbours = (folder for folder in own.parent.iterdir() if is_package(folder))
            known.update({_name(folder): str(folder) for folder in neighbours})
    for root in reversed(paths.roots):
        known.update({folder.name: str(folder) for folder in root.iterdir() if folder.is_dir()})
        known[_name(root)] = str(root)
    return known


def _name(folder: Path) -> str:
    return package_name(folder) or folder.name
