"""Print the packages of each extra and their size, as the table in docs/packages.md has them.

Usage: sizes.py [EXTRA [--packages]]. It reads what is installed: `make setup` installs all extras.
Sizes are of files on disk without bytecode.
"""

import sys
from importlib.metadata import PackageNotFoundError, distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

DEVELOPMENT = "dev"
MEGABYTE = 1e6


def main() -> None:
    """Print a row for each extra, or the packages of one."""
    root = distribution("zensim")
    extras = [one for one in root.metadata.get_all("Provides-Extra") or () if one != DEVELOPMENT]
    for extra in sys.argv[1:2] or ["", *extras]:
        sizes = measure(extra)
        total = sum(sizes.values()) / MEGABYTE
        sys.stdout.write(f"| {f'`{extra}`' if extra else 'none'} | {len(sizes)}, {total:.0f} |\n")
        if "--packages" in sys.argv[2:]:
            for name, size in sorted(sizes.items(), key=lambda one: -one[1]):
                sys.stdout.write(f"{name:24} {size / MEGABYTE:7.2f}\n")


def measure(extra: str) -> dict[str, int]:
    """Measure the packages [bytes] that zensim installs with an extra, without itself."""
    found: set[tuple[str, str]] = set()
    collect("zensim", {extra} - {""}, found)
    return {name: measure_package(name) for name in {name for name, _ in found} - {"zensim"}}


def collect(name: str, extras: set[str], found: set[tuple[str, str]]) -> None:
    """Collect a package and all that it needs here, with the extras of each."""
    key = canonicalize_name(name)
    try:
        needs = [Requirement(line) for line in distribution(name).requires or ()]
    except PackageNotFoundError:
        return  # of another platform
    for extra in {"", *extras} - {extra for known, extra in found if known == key}:
        found.add((key, extra))
        for need in needs:
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                collect(need.name, need.extras, found)


def measure_package(name: str) -> int:
    """Measure the files [bytes] of a package, without bytecode."""
    package = distribution(name)
    paths = [package.locate_file(file) for file in package.files or () if file.suffix != ".pyc"]
    return sum(path.stat().st_size for path in paths if path.is_file())


if __name__ == "__main__":
    main()
