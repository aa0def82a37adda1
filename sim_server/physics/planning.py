"""Blueprints that an engine can build: the last one is kept, as planning takes milliseconds."""

from collections.abc import Collection

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.acceptance import check_blueprint
from zensim.sim_server.physics.blueprint import Blueprint, blueprint_of
from zensim.sim_server.physics.spreading import spread


class Planner:
    """Plans models for one engine."""

    def __init__(
        self,
        engine: str,
        *,
        max_parts: int,
        joint_kinds: Collection[str],
        shape_kinds: Collection[str],
    ) -> None:
        self._engine = engine
        self._max_parts = max_parts
        self._joint_kinds = joint_kinds
        self._shape_kinds = shape_kinds
        self._last: tuple[Model, Blueprint] | None = None

    def blueprint(self, model: Model) -> Blueprint:
        """Plan a model, or find the plan again when it is the same object as the last.

        Raises:
            EngineRefused: The engine cannot build it.
        """
        if self._last is None or self._last[0] is not model:
            self._last = (model, self._planned(model))
        return self._last[1]

    def _planned(self, model: Model) -> Blueprint:
        plan = spread(blueprint_of(model), max_parts=self._max_parts)
        check_blueprint(
            plan,
            self._engine,
            max_parts=self._max_parts,
            joint_kinds=self._joint_kinds,
            shape_kinds=self._shape_kinds,
        )
        return plan
