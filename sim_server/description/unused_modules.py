"""Modules that trimesh imports if they are installed, and that reading meshes does not need."""

import sys

UNUSED_MODULES = ("embreex", "networkx", "rtree", "scipy", "shapely")


def leave_out_unused_modules() -> None:
    """Make these modules unimportable in this process: importing them takes half of its start."""
    for name in UNUSED_MODULES:
        sys.modules.setdefault(name, None)  # type: ignore[arg-type]
