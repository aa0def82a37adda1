"""The files of this repository."""

import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("deploy", "proto", "robot_agent", "sim_server", "spawner", "zensim")


def files() -> list[Path]:
    """List files that git tracks or would track, without deleted ones, as of the first call."""
    return list(_list_files())


@cache
def _list_files() -> tuple[Path, ...]:
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    paths = (ROOT / name for name in sorted(set(listing.stdout.split("\0")) - {""}))
    return tuple(path for path in paths if path.is_file())


@cache
def text_of(path: Path) -> str:
    """Read a file as text, once; invalid bytes become replacement characters."""
    return path.read_text(encoding="utf-8", errors="replace")


def shown(path: Path) -> str:
    """Get the path of a file in the repository."""
    return path.relative_to(ROOT).as_posix()
