"""`python -m tests.interop.crate_pins`: pin all crates to the versions of the newest build.

Cargo.lock would pin them, but it records addresses of registries. Instead Cargo.toml names crates
that others bring along for a target that does not exist: cargo resolves them and builds none.
"""

import re
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tests.interop.peer_build import SOURCES, cache_folder

PACKAGE = re.compile(r'^name = "([^"]+)"\nversion = "([^"+]+)', re.MULTILINE)
"""Name and version, without the metadata after `+`."""
DIRECT = re.compile(r'^([\w-]+) = .*"=', re.MULTILINE)
OWN = "interop-peers"
HEAD = """
# Crates that others bring along: python -m tests.interop.crate_pins
[target.'cfg(any())'.dependencies]
"""


def pin_crates(manifest: str, lock: str) -> str:
    """Rewrite the pins at the end of a Cargo.toml."""
    kept = manifest.partition(HEAD)[0].rstrip("\n") + "\n"
    direct = {*DIRECT.findall(kept), OWN}
    others = [one for one in PACKAGE.findall(lock) if one[0] not in direct]
    return kept + HEAD + "".join(_write_pins(others))


def _write_pins(packages: Iterable[tuple[str, str]]) -> Iterable[str]:
    found = sorted(packages)
    counts = Counter(name for name, _ in found)
    for name, version in found:
        pin = f'version = "={version}", default-features = false'
        if counts[name] == 1:
            yield f"{name} = {{ {pin} }}\n"
        else:
            key = f"{name}-{re.sub('[^0-9]', '-', version)}"
            yield f'{key} = {{ package = "{name}", {pin} }}\n'


def main() -> None:
    """Rewrite Cargo.toml from a lock file, by default that of the cache."""
    given = sys.argv[1:]
    lock = Path(given[0]) if given else cache_folder() / "package" / "Cargo.lock"
    manifest = SOURCES / "Cargo.toml"
    pinned = pin_crates(manifest.read_text(encoding="utf-8"), lock.read_text(encoding="utf-8"))
    manifest.write_text(pinned, encoding="utf-8")


if __name__ == "__main__":
    main()
