"""Completion of built-in models and worlds, and of their files, while a command is typed."""

from pathlib import Path
from typing import Final

SHIPPED: Final = Path(__file__).resolve().parents[2] / "sim_server"
MODEL_SUFFIXES: Final = (".urdf", ".xacro", ".sdf")
WORLD_SUFFIXES: Final = (".world", ".sdf", ".xml")


def complete_models(incomplete: str) -> list[str]:
    """Find the built-in models, and the files and folders, that start with a text."""
    return _complete_shipped("models/*.urdf", incomplete, MODEL_SUFFIXES)


def complete_worlds(incomplete: str) -> list[str]:
    """Find the built-in worlds, and the files and folders, that start with a text."""
    return _complete_shipped("worlds/*.sdf", incomplete, WORLD_SUFFIXES)


def _complete_shipped(pattern: str, incomplete: str, suffixes: tuple[str, ...]) -> list[str]:
    names = sorted(path.stem for path in SHIPPED.glob(pattern))
    found = [name for name in names if name.startswith(incomplete)]
    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    try:
        paths = sorted(folder.expanduser().iterdir())
    except OSError:
        return found
    found += [f"{path}/" for path in paths if path.is_dir() and f"{path}".startswith(incomplete)]
    return found + [
        str(path) for path in paths if path.suffix in suffixes and str(path).startswith(incomplete)
    ]
