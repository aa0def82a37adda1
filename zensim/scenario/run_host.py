"""The host of a run: its system, processor and versions, on which equal bits depend."""

import platform
import socket
from functools import cache
from pathlib import Path

import msgspec

from zensim.proto.package_versions import find_package_version

PACKAGES = ("zensim", "mujoco", "pybullet", "numpy")
"""Packages that compute states."""
CPU_FILE = Path("/proc/cpuinfo")


class RunHost(msgspec.Struct, frozen=True):
    """Where a run ran."""

    name: str = ""
    system: str = ""
    cpu: str = ""
    versions: dict[str, str] = {}
    """Versions of Python and of the packages that compute states."""


@cache
def describe_host() -> RunHost:
    """Describe this host and interpreter."""
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        if (found := find_package_version(package)) is not None:
            versions[package] = found
    return RunHost(socket.gethostname(), system, _find_cpu(), versions)


def _find_cpu() -> str:
    try:
        lines = CPU_FILE.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
