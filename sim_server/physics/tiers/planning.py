"""Which models may be driven flat: each planned once, and tried out in the full engine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from zensim.sim_server.physics.engine import EngineRefused
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.tiers.footprint import Footprint, corners_in
from zensim.sim_server.physics.tiers.vehicle import NotFlat, Vehicle, vehicle_of

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Dynamics, Model

KEPT = 256

FlatPlan = tuple[Vehicle, Footprint]


class FlatPlans:
    """Plans of the models seen last."""

    def __init__(self, config: EngineConfig, default: Dynamics) -> None:
        self.corners = corners_in(config.mesh_folder)
        self._folder = config.mesh_folder
        self._gravity = max(-config.gravity[2], 0.0)
        self._default: Dynamics = default or "full"
        self._plans: dict[int, tuple[Model, FlatPlan | None]] = {}

    def dynamics(self, model: Model) -> Dynamics:
        """Say which dynamics a model asks for, or else the world."""
        return "full" if model.is_static else model.dynamics or self._default

    def plan(self, model: Model) -> FlatPlan | None:
        """Find how a model is driven flat; None where it is full, always or for want of a drive.

        Raises:
            EngineRefused: It asks to be kinematic and cannot.
        """
        if self.dynamics(model) == "full":
            return None
        if id(model) not in self._plans:
            if len(self._plans) >= KEPT:
                del self._plans[next(iter(self._plans))]
            self._plans[id(model)] = (model, self._planned(model))
        return self._plans[id(model)][1]

    def _planned(self, model: Model) -> FlatPlan | None:
        shapes = (shape for link in model.links for shape in link.collisions)
        if not all(Path(self._folder, f"{s.mesh}.stl").is_file() for s in shapes if s.mesh):
            return None  # the full engine says which is missing
        try:
            return vehicle_of(model, self.corners, self._gravity)
        except NotFlat as error:
            if model.dynamics == "kinematic":
                raise EngineRefused(
                    f"model '{model.name}' cannot be kinematic: {error}; use full or auto"
                ) from error
            return None
