"""Expands xacro in a process of its own, with limits on CPU time and memory; run with `python -m`.

The request arrives on stdin, the result leaves on stdout.
"""

import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import BinaryIO
from xml.parsers.expat import ExpatError

import msgspec

from zensim.proto.child_process import reserve_stdout
from zensim.proto.process_limits import ResourceLimits, die_with_parent, set_resource_limits
from zensim.spawner.spawn.description_xml import MAX_TEXT_BYTES
from zensim.spawner.spawn.search_paths import SearchPaths, is_package, read_package_name

XACRO_PACKAGES = ("xacrodoc", "xacro", "rospkg")
CPU_LIMIT_S = 6
MEMORY_LIMIT_BYTES = 1 << 29
"""Address space on top of what the imports took."""
LIMITS = ResourceLimits(extra_memory_bytes=MEMORY_LIMIT_BYTES, total_cpu_s=CPU_LIMIT_S)


class XacroRequest(msgspec.Struct, frozen=True):
    """What to expand."""

    text: str
    path: Path
    arguments: dict[str, str]
    paths: SearchPaths


class XacroResult(msgspec.Struct, frozen=True):
    """URDF, or why there is none: a whole sentence, or a reason."""

    text: str = ""
    sentence: str = ""
    reason: str = ""


def encode_request(wish: XacroRequest) -> bytes:
    """Write a wish; paths as text."""
    return msgspec.msgpack.encode(wish, enc_hook=str)


def decode_request(data: bytes) -> XacroRequest:
    """Read what `write_wish` wrote."""
    return msgspec.msgpack.decode(data, type=XacroRequest, dec_hook=lambda kind, value: kind(value))


def main() -> None:
    """Expand one text."""
    die_with_parent()
    wish = decode_request(sys.stdin.buffer.read())
    # What macros print is no reply.
    answers = os.fdopen(reserve_stdout(), "wb")
    try:
        xacro, packages = _import_xacro(wish.path)
    except LookupError as error:
        _reply(answers, XacroResult(sentence=str(error.args[0])))
        return
    set_resource_limits(LIMITS)
    _reply(answers, _expand(wish, xacro, packages))


def _reply(answers: BinaryIO, found: XacroResult) -> None:
    answers.write(msgspec.msgpack.encode(found))
    answers.close()


def _expand(wish: XacroRequest, xacro: ModuleType, packages: ModuleType) -> XacroResult:
    packages.reset()
    packages.look_in([str(root) for root in wish.paths.roots])
    packages.walk_up_from(wish.path)
    packages.update_package_cache(_find_packages(wish.paths))
    try:
        xacro.init_stacks(str(wish.path))
        document = xacro.parse(wish.text, str(wish.path))
        xacro.process_doc(document, mappings=wish.arguments)
        text: str = document.documentElement.toxml()
    except (
        MemoryError,
        xacro.XacroException,
        packages.PackageNotFoundError,
        ExpatError,
        OSError,
        RecursionError,
        ValueError,
    ) as error:
        return XacroResult(reason=_describe_error(error))
    if len(text) > MAX_TEXT_BYTES:
        return XacroResult(reason=f"it becomes longer than {MAX_TEXT_BYTES} bytes")
    return XacroResult(text)


def _describe_error(error: BaseException) -> str:
    inner: BaseException | None = error
    while inner is not None:
        if isinstance(inner, MemoryError):
            return f"it takes more than {MEMORY_LIMIT_BYTES >> 20} MiB"
        inner = inner.__cause__ or inner.__context__
    return " ".join(str(error).split())[:300] or type(error).__name__


def _import_xacro(path: Path) -> tuple[ModuleType, ModuleType]:
    try:
        # xacrodoc comes first: it teaches xacro to find packages without ROS.
        packages = import_module("xacrodoc.packages")
        return import_module("xacro"), packages
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in XACRO_PACKAGES:
            raise
        raise LookupError(
            f"{path} is xacro, and {error.name} is not installed; use pip install 'zensim[xacro]', "
            "or expand it by hand"
        ) from error


def _find_packages(paths: SearchPaths) -> dict[str, str]:
    """Name the folders that are packages to us: those of the search paths, and neighbours."""
    known: dict[str, str] = {}
    for own in paths.own:
        if is_package(own):
            neighbours = (folder for folder in own.parent.iterdir() if is_package(folder))
            known.update({_label_package(folder): str(folder) for folder in neighbours})
    for root in reversed(paths.roots):
        known.update({folder.name: str(folder) for folder in root.iterdir() if folder.is_dir()})
        known[_label_package(root)] = str(root)
    return known


def _label_package(folder: Path) -> str:
    return read_package_name(folder) or folder.name


if __name__ == "__main__":
    main()
