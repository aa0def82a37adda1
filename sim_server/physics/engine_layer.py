"""Base of layers around an engine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from zensim.proto.messages.model_messages import Model, TierName
from zensim.sim_server.physics.engine import (
    BodyStates,
    ContactPoints,
    Engine,
    EngineReplicas,
    FloatArray,
    Place,
)

# ruff: noqa: D102 - see `Engine`


class EngineLayer(Engine):
    """An engine around another: every call goes to the inner engine unless overridden.

    `sleep`, `wake` and `find_contacts` are not forwarded: one layer at most controls sleep.
    """

    def __init__(self, inner: Engine) -> None:
        self._inner = inner
        self.capabilities = replace(inner.capabilities, sleeps="none")

    @property
    def name(self) -> str:
        return self._inner.name

    def prepare(self, model: Model) -> bool:
        return self._inner.prepare(model)

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        self._inner.insert(body, model, base)

    def discard(self, body: int) -> None:
        self._inner.discard(body)

    def forget_removed(self) -> None:
        self._inner.forget_removed()

    def find_overlaps(self, body: int) -> Sequence[int]:
        return self._inner.find_overlaps(body)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        return self._inner.read(bodies)

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        return self._inner.read_joint_efforts(bodies)

    def set_base_state(self, body: int, base: FloatArray) -> None:
        self._inner.set_base_state(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        self._inner.set_at_rest(body, base, positions)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        self._inner.set_state(body, base, positions, velocities)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        self._inner.command(bodies, targets)

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        self._inner.apply_link_wrench(body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        self._inner.apply_joint_effort(body, joint, effort)

    def step(self) -> bool:
        return self._inner.step()

    def close(self) -> None:
        self._inner.close()

    def resume(self) -> None:
        self._inner.resume()

    @property
    def kinematic_count(self) -> int:
        return self._inner.kinematic_count

    def tier_of(self, body: int) -> TierName:
        return self._inner.tier_of(body)

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
        self._inner.expect(models, places)

    def hide(self, body: int) -> None:
        self._inner.hide(body)

    def show(self, bodies: Sequence[int]) -> None:
        self._inner.show(bodies)

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        return self._inner.read_contacts(bodies)

    def take_faults(self) -> Mapping[int, str]:
        return self._inner.take_faults()

    def skip_validation(self, model: Model) -> None:
        self._inner.skip_validation(model)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        return self._inner.find_overlaps_async(body)

    def is_idle(self) -> bool:
        return self._inner.is_idle()

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        return self._inner.replicate(bodies, count)
