"""Write NOTICE: the licence of each package that zensim installs with any of its extras.

`python .ci/notices.py` prints it; `--check` compares the packages with those of the file, and their
licences on the Python of CI: other versions of a package may write theirs otherwise.
"""

import re
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PATH = Path(__file__).parent.parent / "NOTICE"
DEVELOPMENT = "dev"
CHOSEN = {
    "docutils": "Public Domain AND BSD-2-Clause",
    "eclipse-zenoh": "Apache-2.0 (chosen; also offered: EPL-2.0)",
    "embreex": "BSD-2-Clause, with Embree: Apache-2.0",
    "vhacdx": "MIT, with V-HACD: BSD-3-Clause",
    "xacro": "BSD-3-Clause",
}
"""Where the metadata names none, several, or the text instead of the name."""
PYTHON_OF_CI = (3, 11)
OF_SOME_PYTHONS = frozenset(
    {"absl-py", "etils", "exceptiongroup", "fsspec", "glfw", "importlib-resources", "mujoco"}
    | {"pyopengl", "typing-extensions", "zipp"}
)
"""What other versions of Python need beside."""
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
    differences = list(compare(text, PATH.read_text(encoding="utf-8")))
    sys.stderr.writelines(f"{line}; run `make notice`\n" for line in differences)
    return 1 if differences else 0


def compare(needed: str, written: str) -> Iterator[str]:
    """List what differs between the text that is needed here and that of the file."""
    is_of_ci = sys.version_info[:2] == PYTHON_OF_CI and sys.platform == "linux"
    here, there = (
        {line.split(": ")[0]: line for line in text.splitlines()[len(HEAD.splitlines()) :]}
        for text in (needed, written)
    )
    for name in sorted(here.keys() | there.keys()):
        if name not in there and (is_of_ci or name not in OF_SOME_PYTHONS):
            yield f"NOTICE lacks {here[name]!r}"
        elif is_of_ci and here.get(name) != there[name]:
            yield f"NOTICE has {there[name]!r}, and needed is {here.get(name)!r}"


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
