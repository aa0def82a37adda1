"""The files of this repository, for the tests that read them."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("deploy", "proto", "robot_agent", "sim_server", "spawner", "zensim")


def files() -> list[Path]:
    """List what git tracks or would track, without what was deleted and not yet committed."""
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    paths = (ROOT / name for name in sorted(set(listing.stdout.split("\0")) - {""}))
    return [path for path in paths if path.is_file()]


def text_of(path: Path) -> str:
    """Read a file as text; bytes that are none, as in a picture, become marks."""
    return path.read_text(encoding="utf-8", errors="replace")


def shown(path: Path) -> str:
    """Name a file as a reader of the repository would."""
    return path.relative_to(ROOT).as_posix()
