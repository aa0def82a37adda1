"""Versions of installed packages, by the name of the library that they have."""

import re
from importlib.metadata import PackageNotFoundError, distribution

PACKAGES_OF = {"mujoco": ("mujoco-core", "mujoco"), "pybullet": ("pybullet", "pybullet-arm64")}
"""Packages that may have the library; the first installed one counts. MuJoCo 3 was one package."""

VERSION_LINE = re.compile(r"^Version: *(\S+)", re.MULTILINE)
REPORTED_PACKAGES = ("zensim", "eclipse-zenoh", "pybullet", "mujoco", "viser", "numpy")
"""Packages whose versions matter to whoever asks for help."""
MISSING_PACKAGE = "not installed"


def find_reported_versions() -> dict[str, str]:
    """Find the versions of the packages that are reported."""
    return {name: find_package_version(name) or MISSING_PACKAGE for name in REPORTED_PACKAGES}


def find_package_version(library: str) -> str | None:
    """Find the version of a library; None if it is not installed."""
    found = (_find_version(package) for package in PACKAGES_OF.get(library, (library,)))
    return next((one for one in found if one is not None), None)


def _find_version(package: str) -> str | None:
    try:
        found = distribution(package)
    except PackageNotFoundError:
        return None
    # `found.version` parses the description, too: 3 ms for that of MuJoCo.
    head = VERSION_LINE.search(found.read_text("METADATA") or "")
    return head[1] if head else found.version
