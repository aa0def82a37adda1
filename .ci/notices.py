"""Write NOTICE: the licence of each package that zensim installs with any of its extras.

`python .ci/notices.py` prints it; `--check` compares the names of the file with those of
requirements/all.txt, and the licences on the Python of CI: other versions of a package may write
theirs otherwise.
"""

import platform
import re
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
PATH, PINS = ROOT / "NOTICE", ROOT / "requirements" / "all.txt"
DEVELOPMENT = "dev"
CHOSEN = {
    "docutils": "Public Domain AND BSD-2-Clause",
    "eclipse-zenoh": "Apache-2.0 (chosen; also offered: EPL-2.0)",
    "embreex": "BSD-2-Clause, with Embree: Apache-2.0",
    "vhacdx": "MIT, with V-HACD: BSD-3-Clause",
    "xacro": "BSD-3-Clause",
}
"""Where the metadata names none, several, or the text instead of the name."""
CI = {
    "python_version": "3.11",
    "python_full_version": "3.11.0",
    "sys_platform": "linux",
    "platform_system": "Linux",
    "platform_machine": "x86_64",
    "platform_python_implementation": "CPython",
    "implementation_name": "cpython",
}
"""Where NOTICE is written; other platforms and versions of Python need other packages."""
PIN = re.compile(r"^([a-z0-9-]+)(?:\[.*?\])?==[^ ]+(?: ; (.*?))?(?: \\)?$", re.MULTILINE)
LONGEST_NAME = 60
HEAD = """zensim
Copyright (c) 2026 the zensim authors

zensim is distributed under the MIT license; see LICENSE. It contains no code of others. Its wheel
depends on these packages. The text of each licence is in its package. Some extras and platforms
need only a part of them.

"""


def main() -> int:
    """Print NOTICE, or say what differs from it."""
    text = HEAD + "".join(f"{name}: {licence}\n" for name, licence in list_licences())
    if "--check" not in sys.argv[1:]:
        sys.stdout.write(text)
        return 0
    written = PATH.read_text(encoding="utf-8")
    differences = [*compare_names(find_names(written)), *compare_licences(text, written)]
    sys.stderr.writelines(f"{line}; run `make notice`\n" for line in differences)
    return 1 if differences else 0


def find_names(text: str) -> dict[str, str]:
    """Find the lines of packages, by name."""
    return {line.split(": ")[0]: line for line in text.removeprefix(HEAD).splitlines()}


def compare_names(written: Iterable[str]) -> Iterator[str]:
    """List what differs between the names of the file and the pinned packages."""
    pins = PIN.findall(PINS.read_text(encoding="utf-8"))
    needed = {name for name, marker in pins if not marker or Marker(marker).evaluate(CI)}
    yield from (f"NOTICE lacks {name}" for name in sorted(needed - set(written)))
    unneeded = sorted(set(written) - needed)
    yield from (f"NOTICE has {name}, which no extra installs" for name in unneeded)


def compare_licences(text: str, written: str) -> Iterator[str]:
    """List what differs between the licences of the file and those that are installed."""
    here, there = find_names(text), find_names(written)
    is_of_ci = platform.python_version_tuple()[:2] == tuple(CI["python_version"].split("."))
    if not (is_of_ci and sys.platform == CI["sys_platform"]):
        return
    for name in sorted(here.keys() & there.keys()):
        if here[name] != there[name]:
            yield f"NOTICE has {there[name]!r}, and installed is {here[name]!r}"


def list_licences() -> Iterator[tuple[str, str]]:
    """List names and licences of what is installed.

    Raises:
        SystemExit: A package names no licence.
    """
    root = distribution("zensim")
    extras = {one for one in root.metadata.get_all("Provides-Extra") or () if one != DEVELOPMENT}
    found: dict[str, set[str]] = {}
    collect("zensim", extras, found)
    for name in sorted(set(found) - {"zensim"}):
        licence = CHOSEN.get(name) or find_licence(distribution(name))
        if not licence:
            raise SystemExit(f"{name} names no licence; add it to CHOSEN in {__file__}")
        yield name, licence


def collect(name: str, extras: set[str], found: dict[str, set[str]]) -> None:
    """Collect a package and all that it needs here, with the extras of each."""
    key = canonicalize_name(name)
    if key in found and extras <= found[key]:
        return
    try:
        needs = distribution(name).requires or ()
    except PackageNotFoundError:
        return  # of another platform
    found.setdefault(key, set()).update(extras)
    for need in map(Requirement, needs):
        marker = need.marker
        if marker is None or any(marker.evaluate({"extra": one}) for one in ("", *extras)):
            collect(need.name, set(need.extras), found)


def find_licence(package: Distribution) -> str:
    """Find the name of a licence in the metadata; empty if there is none."""
    metadata = package.metadata
    texts = (metadata.get("License-Expression"), metadata.get("License"))
    for text in filter(None, texts):
        if len(text) <= LONGEST_NAME and "\n" not in text:
            return str(text)
    classifiers = [one for one in metadata.get_all("Classifier") or () if "License ::" in one]
    return " AND ".join(re.sub(r".*:: ", "", one) for one in classifiers)


if __name__ == "__main__":
    sys.exit(main())
