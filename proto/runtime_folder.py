"""The folder of what programs of one user keep while this host runs."""

import os
import sys
import tempfile
from pathlib import Path


def find_runtime_folder() -> Path:
    """Find the folder; it may not exist."""
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    owner = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
    return Path(base) / f"zensim{owner}"


def make_runtime_folder() -> Path | None:
    """Make the folder; None if it cannot be made, or is of somebody else."""
    folder = find_runtime_folder()
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder if is_own(folder) else None
    except OSError:
        return None


def is_own(folder: Path) -> bool:
    """Whether a folder is of this user, so that others cannot write there."""
    return sys.platform == "win32" or folder.stat().st_uid == os.getuid()
