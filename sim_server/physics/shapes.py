"""Collision shapes, each made once and shared: Bullet never frees one that a body has used."""

from collections.abc import Callable, Mapping

from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.physics.acceptance import check_meshes
from zensim.sim_server.physics.blueprint import Blueprint, Part
from zensim.sim_server.physics.creation import solids_of
from zensim.sim_server.physics.spreading import ShapeKey, key_of


class Shapes:
    """Which shapes an engine has made, by what they are."""

    def __init__(
        self, make: Callable[..., int], *, folder: str, kinds: Mapping[str, int], dented: int
    ) -> None:
        """Begin with none.

        Args:
            make: Makes one of what `solids_of` lays out.
            folder: Where `<Shape.mesh>.stl` is.
            kinds: The engine's number for each kind of shape.
            dented: The flag of meshes that are taken as they are; only what never moves may be.
        """
        self._make = make
        self._folder = folder
        self._kinds = kinds
        self._dented = dented
        self._made: dict[ShapeKey, int] = {(): -1}

    def of(self, plan: Blueprint, shapes: tuple[Shape, ...]) -> int:
        """Find the engine's number for the shapes of one part, made now if need be."""
        key = key_of(shapes, is_static=plan.is_static)
        if key not in self._made:
            flag = self._dented if plan.is_static else 0
            solids = solids_of(shapes, folder=self._folder, kinds=self._kinds, mesh_flag=flag)
            self._made[key] = self._make(**solids)
        return self._made[key]

    def unmade(self, plan: Blueprint) -> list[Part]:
        """List the parts whose shapes the engine has not yet."""
        keys = {key_of(part.shapes, is_static=plan.is_static): part for part in plan.parts}
        return [part for key, part in keys.items() if key not in self._made]

    def check(self, plan: Blueprint, parts: list[Part]) -> None:
        """See that meshes of parts can be made; raises EngineRefused if not."""
        check_meshes(plan.name, parts, self._folder)
