"""What a model looks like: its visuals and hinges without any name, so that like robots are one."""

from collections.abc import Container

import msgspec

from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.spawner.viewer.kinematics import Hinge


class NotATree(Exception):
    """A model's joints do not put every link under one that comes before it."""


class Form(msgspec.Struct, frozen=True):
    """Equal for all robots that look and move alike, whatever their links are called."""

    links: tuple[tuple[Shape, ...], ...]
    """What is drawn of every link, the base first."""
    hinges: tuple[Hinge, ...]
    """`hinges[i]` moves `links[i + 1]`."""


def form_of(model: Model, meshes: Container[str] = ()) -> Form:
    """Strip a model of everything that cannot be seen.

    Args:
        model: What to strip.
        meshes: The sha256 of those that are here.

    Raises:
        NotATree: A joint names a parent that does not come before its child.
    """
    index = {link.name: number for number, link in enumerate(model.links)}
    children = tuple(joint.child for joint in model.joints)
    if not model.links or children != tuple(link.name for link in model.links[1:]):
        raise NotATree(f"model '{model.name}' is no tree: its joints do not move its links in turn")
    hinges = []
    for number, joint in enumerate(model.joints):
        parent = index.get(joint.parent, len(index))
        if parent > number:
            raise NotATree(f"joint '{joint.name}' of '{model.name}' has no parent before it")
        hinges.append(Hinge(joint.kind, parent, joint.origin, joint.axis))
    return Form(tuple(_drawn(link, meshes) for link in model.links), tuple(hinges))


def _drawn(link: Link, meshes: Container[str]) -> tuple[Shape, ...]:
    """Visuals that have triangles; collisions stand in for those whose mesh is not here."""
    shapes = _with_triangles(link.visuals, meshes)
    return shapes if shapes or not link.visuals else _with_triangles(link.collisions, ())


def _with_triangles(shapes: tuple[Shape, ...], meshes: Container[str]) -> tuple[Shape, ...]:
    """The page draws the ground itself."""
    return tuple(
        shape
        for shape in shapes
        if shape.kind != "plane" and (shape.kind != "mesh" or shape.mesh in meshes)
    )
