"""Process that expands xacro with limited CPU time and memory; run with `python -m`.

It reads a request from stdin and writes the result to stdout.
"""

import os
import re
import sys
from collections.abc import Iterator
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import BinaryIO
from xml.parsers.expat import ExpatError

import msgspec

from zensim.proto.bounded_files import MAX_TEXT_FILE_BYTES, read_file
from zensim.proto.child_process import reserve_stdout
from zensim.proto.parent_death import die_with_parent
from zensim.proto.process_limits import ResourceLimits, set_resource_limits
from zensim.spawner.spawn.description_xml import MAX_TEXT_BYTES
from zensim.spawner.spawn.search_paths import SearchPaths, is_package, read_package_name

UNDEFINED = re.compile(r"name '(\w+)' is not defined|Undefined substitution argument (\w+)")
CLASS_NAME = re.compile(r"<class '[^']*'>: ")
ARGUMENT = re.compile(
    r"<xacro:arg\s[^>]*name\s*=\s*[\"']([^\"']+)[\"']|\$\(\s*arg\s+([^()\s]+)\s*\)"
)
XACRO_PACKAGES = ("xacrodoc", "xacro", "rospkg")
CPU_LIMIT_S = 6
MEMORY_LIMIT_BYTES = 1 << 29
"""Address space on top of the present use."""
LIMITS = ResourceLimits(extra_memory_bytes=MEMORY_LIMIT_BYTES, total_cpu_s=CPU_LIMIT_S)


class XacroRequest(msgspec.Struct, frozen=True):
    """A text to expand."""

    text: str
    path: Path
    arguments: dict[str, str]
    paths: SearchPaths


class XacroResult(msgspec.Struct, frozen=True):
    """The expanded text, or an error."""

    text: str = ""
    missing: str = ""
    """Error if a package of xacro is not installed."""
    reason: str = ""
    """Error of the expansion."""


def encode_request(request: XacroRequest) -> bytes:
    """Encode a request; paths as text."""
    return msgspec.msgpack.encode(request, enc_hook=str)


def decode_request(data: bytes) -> XacroRequest:
    """Decode the output of `encode_request`."""
    return msgspec.msgpack.decode(data, type=XacroRequest, dec_hook=lambda kind, value: kind(value))


def main() -> None:
    """Expand the text of one request."""
    die_with_parent()
    request = decode_request(sys.stdin.buffer.read())
    # Output of macros must not mix with the reply.
    output = os.fdopen(reserve_stdout(), "wb")
    try:
        xacro, packages = _import_xacro(request.path)
    except LookupError as error:
        _reply(output, XacroResult(missing=str(error.args[0])))
        return
    set_resource_limits(LIMITS)
    _reply(output, _expand(request, xacro, packages))


def _reply(output: BinaryIO, result: XacroResult) -> None:
    output.write(msgspec.msgpack.encode(result))
    output.close()


def _expand(request: XacroRequest, xacro: ModuleType, packages: ModuleType) -> XacroResult:
    packages.reset()
    packages.walk_up_from(request.path)
    packages.update_package_cache(_find_packages(request.paths))
    try:
        xacro.init_stacks(str(request.path))
        document = xacro.parse(request.text, str(request.path))
        xacro.process_doc(document, mappings=request.arguments)
        text: str = document.documentElement.toxml()
        _check_arguments(request, xacro)
    except (
        MemoryError,
        xacro.XacroException,
        packages.PackageNotFoundError,
        ExpatError,
        OSError,
        RecursionError,
        ValueError,
    ) as error:
        return XacroResult(reason=_describe_failure(error, request, xacro, packages))
    if len(text) > MAX_TEXT_BYTES:
        return XacroResult(reason=f"the result has more than {MAX_TEXT_BYTES} bytes")
    return XacroResult(text)


def _list_sources(request: XacroRequest, xacro: ModuleType) -> Iterator[tuple[str, str]]:
    """List the files that were read, with their texts."""
    yield request.path.name, request.text
    for file in map(Path, dict.fromkeys(getattr(xacro, "all_includes", ()))):
        if file.is_file():
            yield file.name, read_file(file, MAX_TEXT_FILE_BYTES).decode(errors="replace")


def _check_arguments(request: XacroRequest, xacro: ModuleType) -> None:
    """Check that each given argument is used; xacro itself does not read others.

    Raises:
        ValueError: One is not.
    """
    texts = [text for _, text in _list_sources(request, xacro)]
    known = sorted(
        {name for text in texts for pair in ARGUMENT.findall(text) for name in pair if name}
    )
    for name in request.arguments:
        if name in known:
            continue
        similar = get_close_matches(name, known, n=1)
        advice = (
            f"did you mean {similar[0]!r}?" if similar else f"it has {', '.join(known) or 'none'}"
        )
        raise ValueError(f"no argument {name!r} in it; {advice}")


def _describe_failure(
    error: BaseException, request: XacroRequest, xacro: ModuleType, packages: ModuleType
) -> str:
    """Describe why a text is not expanded, and what would help."""
    reason = _describe_error(error)
    if isinstance(error, packages.PackageNotFoundError) or "Package not found" in reason:
        return (
            f"{reason}; set package folders with --package-path (package_paths in a list or a "
            "scenario), or in ROS_PACKAGE_PATH"
        )
    if (undefined := UNDEFINED.search(reason)) is None:
        return reason
    name = undefined[1] or undefined[2]
    for file, text in _list_sources(request, xacro):
        if re.search(rf"<property\s[^>]*name\s*=\s*[\"']{re.escape(name)}[\"']", text):
            return (
                f"{reason}; {file} sets {name!r} by <property>: xacro reads tags with its prefix "
                "only, write <xacro:property>"
            )
    return f"{reason}; set it with --xacro-arg {name}:=VALUE"


def _describe_error(error: BaseException) -> str:
    inner: BaseException | None = error
    while inner is not None:
        if isinstance(inner, MemoryError):
            return f"it takes more than {MEMORY_LIMIT_BYTES >> 20} MiB"
        inner = inner.__cause__ or inner.__context__
    # xacro says the name of an unknown class, and then its text twice.
    words = CLASS_NAME.sub("", " ".join(str(error).split()))
    half = words[: len(words) // 2].rstrip()
    return (half if words == f"{half} {half}" else words)[:300] or type(error).__name__


def _import_xacro(path: Path) -> tuple[ModuleType, ModuleType]:
    try:
        # xacrodoc comes first: it patches xacro to find packages without ROS.
        packages = import_module("xacrodoc.packages")
        return import_module("xacro"), packages
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in XACRO_PACKAGES:
            raise
        raise LookupError(
            f"{path} is xacro, and {error.name} is not installed; use pip install 'zensim[xacro]', "
            "or expand the file first"
        ) from error


def _find_packages(paths: SearchPaths) -> dict[str, str]:
    """Map package names to folders: of the search paths, and siblings of the own package.

    rospkg would refuse all packages for one package.xml that is not well-formed.
    """
    packages = {
        _label_package(folder): str(folder)
        for root in reversed(paths.roots)
        for folder in _list_packages_below(root)
    }
    for own in paths.own_folders:
        if is_package(own):
            siblings = (folder for folder in own.parent.iterdir() if is_package(folder))
            packages.update({_label_package(folder): str(folder) for folder in siblings})
    for root in reversed(paths.roots):
        # A folder without package.xml may have the name of a package inside of it.
        folders = (root, *(folder for folder in root.iterdir() if folder.is_dir()))
        packages = {one.name: str(one) for one in reversed(folders)} | packages
        packages |= {_label_package(one): str(one) for one in reversed(folders) if is_package(one)}
    return packages


def _list_packages_below(root: Path) -> Iterator[Path]:
    """List the packages at any depth, without those inside of packages."""
    for folder, inner, _ in os.walk(root):
        if is_package(Path(folder)):
            yield Path(folder)
            inner.clear()
        inner[:] = sorted(name for name in inner if not name.startswith("."))


def _label_package(folder: Path) -> str:
    return read_package_name(folder) or folder.name


if __name__ == "__main__":
    main()
