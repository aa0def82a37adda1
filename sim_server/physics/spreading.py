"""What never moves, in small parts: an engine takes long over the triangles of a large mesh."""

from dataclasses import replace

from zensim.proto.messages.model_messages import Origin, Shape, Vec3
from zensim.sim_server.physics.blueprint import Blueprint, Part

ShapeKey = tuple[tuple[str, Vec3, Origin, str, bool], ...]


def key_of(shapes: tuple[Shape, ...], *, is_static: bool) -> ShapeKey:
    """Say what an engine makes of shapes: parts of one key share it."""
    return tuple((s.kind, s.size, s.origin, s.mesh, is_static and bool(s.mesh)) for s in shapes)


def spread(blueprint: Blueprint, *, max_parts: int) -> Blueprint:
    """Give each mesh of a static blueprint a part of its own, or a few when there are too many."""
    meshes = sum(len(_meshes(part)) for part in blueprint.parts)
    room = max_parts - len(blueprint.parts)
    if not blueprint.is_static or not meshes or room <= 0:
        return blueprint
    # Each part may have a remainder.
    few = -(-meshes // max(1, room - len(blueprint.parts)))
    parts = [replace(part, shapes=_others(part)) for part in blueprint.parts]
    skins = [
        _skin(part, number, meshes)
        for number, part in enumerate(blueprint.parts)
        for meshes in _groups(_meshes(part), few)
    ]
    return replace(blueprint, parts=(*parts, *skins))


def _meshes(part: Part) -> tuple[Shape, ...]:
    return tuple(shape for shape in part.shapes if shape.mesh)


def _others(part: Part) -> tuple[Shape, ...]:
    return tuple(shape for shape in part.shapes if not shape.mesh)


def _groups(shapes: tuple[Shape, ...], few: int) -> list[tuple[Shape, ...]]:
    return [shapes[at : at + few] for at in range(0, len(shapes), few)]


def _skin(part: Part, number: int, meshes: tuple[Shape, ...]) -> Part:
    is_skin = part.joint is None and part.parent >= 0
    return replace(
        part, mass_kg=0.0, shapes=meshes, parent=part.parent if is_skin else number, joint=None
    )
