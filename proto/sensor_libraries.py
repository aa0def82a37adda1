"""Libraries that some sensors need: which of them a host lacks, and what to install."""

import sys
from collections.abc import Iterable
from ctypes import CDLL
from importlib.util import find_spec
from typing import Final, Literal, get_args

Library = Literal["embree", "opengl"]
LIBRARIES: Final[tuple[Library, ...]] = get_args(Library)
PACKAGES: Final[dict[Library, str]] = {"embree": "embreex", "opengl": "moderngl"}
ADVICE: Final[dict[Library, str]] = {
    "embree": "install embreex, which is in the extra 'server'",
    "opengl": "install the extra 'cameras' and the packages libegl1 and libgl1-mesa-dri",
}
NOTHING: Final = "nothing"
EGL: Final = "libEGL.so.1"
"""Library that lets OpenGL work without a display."""


def find_library_fault(library: Library) -> str:
    """Find why this host lacks a library, without using it; empty if nothing is against it."""
    package = PACKAGES[library]
    if find_spec(package) is None:
        return f"{package} is not installed"
    if library == "opengl" and sys.platform == "linux" and not _can_be_loaded(EGL):
        return f"{EGL} is not installed"
    return ""


def find_missing_libraries() -> dict[Library, str]:
    """Find the libraries that this host lacks, and why."""
    faults = {library: find_library_fault(library) for library in LIBRARIES}
    return {library: fault for library, fault in faults.items() if fault}


def find_advice(library: str) -> str:
    """Find what to install for a library; empty for an unknown one."""
    return {str(one): advice for one, advice in ADVICE.items()}.get(library, "")


def format_missing(missing: Iterable[Library]) -> str:
    """Write what a host lacks as part of a key."""
    return "+".join(sorted(missing)) or NOTHING


def parse_missing(text: str) -> frozenset[Library]:
    """Read what `format_missing` writes; unknown libraries are left out."""
    words = text.split("+")
    return frozenset(library for library in LIBRARIES if library in words)


def _can_be_loaded(name: str) -> bool:
    try:
        CDLL(name)
    except OSError:
        return False
    return True
