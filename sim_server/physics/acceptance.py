"""Whether an engine can simulate a blueprint: asked before anything of it is made."""

from collections.abc import Collection, Iterable
from pathlib import Path

from zensim.sim_server.physics.blueprint import Blueprint, Part
from zensim.sim_server.physics.engine import EngineRefused


def check_blueprint(
    blueprint: Blueprint,
    engine: str,
    *,
    max_parts: int,
    joint_kinds: Collection[str],
    shape_kinds: Collection[str],
) -> None:
    """Compare a blueprint with what an engine has.

    Raises:
        EngineRefused: It has too many parts, or a joint or a shape that the engine has not.
    """
    if (count := len(blueprint.parts)) > max_parts:
        raise EngineRefused(
            f"model '{blueprint.name}' has {count} parts: links, and further frictions on one; "
            f"use at most {max_parts}"
        )
    for part in blueprint.parts:
        _check_kind(blueprint, engine, "joint", part.joint_kind, joint_kinds)
        for shape in part.shapes:
            _check_kind(blueprint, engine, "collision shape", shape.kind, shape_kinds)


def _check_kind(
    blueprint: Blueprint, engine: str, what: str, kind: str, known: Collection[str]
) -> None:
    if kind not in known:
        raise EngineRefused(
            f"model '{blueprint.name}': {what} '{kind}' is not supported by {engine} here; "
            f"use {', '.join(known)}"
        )


def check_meshes(name: str, parts: Iterable[Part], folder: str) -> None:
    """Refuse a mesh of the model of this name whose file is not in the folder.

    Raises:
        EngineRefused: One is not.
    """
    for shape in (shape for part in parts for shape in part.shapes):
        if shape.mesh and not Path(folder, f"{shape.mesh}.stl").is_file():
            raise EngineRefused(
                f"model '{name}': collision shape '{shape.kind}' {shape.mesh[:80]!r} is "
                "not here; send it again, or use box, sphere, cylinder or capsule"
            )
