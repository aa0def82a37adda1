"""Engine layer that sets bodies aside for which the engine fails; the others continue."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.engine import (
    BodyStates,
    ContactPoints,
    Engine,
    EngineRefused,
    EngineReplicas,
    FloatArray,
    Place,
    concatenate_contacts,
    concatenate_states,
    describe_fault,
    make_invalid_state,
    make_unknown_efforts,
    refuse_faults,
)
from zensim.sim_server.physics.engine_layer import EngineLayer

# ruff: noqa: BLE001 - an engine may raise anything, and one body must not end the others

LOG = logging.getLogger(__name__)


class IsolatingEngine(EngineLayer):
    """An engine whose exceptions concern one body.

    `insert` and `find_overlaps` refuse. In any other call, the body that causes an exception is set
    aside: it is read as NaN, and calls for it have no effect until it is removed. A batch is
    divided only after it failed.
    """

    def __init__(self, inner: Engine) -> None:
        super().__init__(inner)
        self.capabilities = inner.capabilities
        self._models: dict[int, Model] = {}
        self._set_aside: set[int] = set()
        self._taken_out: set[int] = set()
        """Bodies set aside that the engine no longer has."""
        self._faults: dict[int, str] = {}

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`."""
        try:
            return self._inner.prepare(model)
        except Exception:
            return True  # `insert` reports it

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
        """See `Engine.expect`."""
        try:
            self._inner.expect(models, places)
        except Exception:
            LOG.debug("fault call=expect models=%d", len(models))  # `insert` reports it

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`."""
        with refuse_faults(f"model '{model.name}'"):
            self._inner.insert(body, model, base)
        self._models[body] = model

    def discard(self, body: int) -> None:
        """See `Engine.discard`."""
        del self._models[body]
        self._set_aside.discard(body)
        self._faults.pop(body, None)
        if body in self._taken_out:
            self._taken_out.remove(body)
            return
        self._discard(body)

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`; raises EngineRefused if the engine fails."""
        if body in self._set_aside:
            return ()
        with refuse_faults(f"overlaps of model '{self._models[body].name}'"):
            return self._inner.find_overlaps(body)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`; finds them now."""
        found = self.find_overlaps(body)
        return lambda: found

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        """See `Engine.replicate`; refuses a world with bodies that are set aside."""
        if self._set_aside:
            raise EngineRefused("a world with bodies that are set aside cannot be copied")
        return self._inner.replicate(bodies, count)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`; bodies that are set aside have NaN."""
        if self._set_aside.isdisjoint(bodies):
            try:
                return self._inner.read(bodies)
            except Exception:
                LOG.debug("fault call=read bodies=%d", len(bodies))
        return concatenate_states([self._read_one(body) for body in bodies])

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """See `Engine.read_joint_efforts`; bodies that are set aside have NaN."""
        if self._set_aside.isdisjoint(bodies):
            try:
                return self._inner.read_joint_efforts(bodies)
            except Exception:
                LOG.debug("fault call=read_joint_efforts bodies=%d", len(bodies))
        return np.concatenate([np.zeros(0), *(self._read_efforts_of(body) for body in bodies)])

    def _read_efforts_of(self, body: int) -> FloatArray:
        found = [make_unknown_efforts(len(self._models[body].joints))]
        self._try(body, lambda: found.append(self._inner.read_joint_efforts((body,))))
        return found[-1]

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        self._try(body, lambda: self._inner.set_base_state(body, base))

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        self._try(body, lambda: self._inner.set_at_rest(body, base, positions))

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        self._try(body, lambda: self._inner.set_state(body, base, positions, velocities))

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        if self._set_aside.isdisjoint(bodies):
            try:
                self._inner.command(bodies, targets)
            except Exception:
                LOG.debug("fault call=command bodies=%d", len(bodies))
            else:
                return
        widths = [make_actuation(self._models[body]).width for body in bodies]
        parts = np.split(targets, np.cumsum(widths[:-1])) if widths else []
        for body, own in zip(bodies, parts, strict=True):
            self._try(body, partial(self._inner.command, [body], own))

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`."""
        self._try(body, lambda: self._inner.apply_link_wrench(body, link, wrench))

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`."""
        self._try(body, lambda: self._inner.apply_joint_effort(body, joint, effort))

    def step(self) -> bool:
        """See `Engine.step`; takes out bodies until the engine can step.

        Raises:
            Exception: It cannot step without any of them either.
        """
        try:
            is_valid = self._inner.step()
        except Exception as error:
            self._step_without_culprit(error)
            return False
        return is_valid and not self._set_aside

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        self._try(body, lambda: self._inner.hide(body))

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        self._try_all(self._inner.show, bodies)

    def sleep(self, bodies: Sequence[int]) -> None:
        """See `Engine.sleep`."""
        self._try_all(self._inner.sleep, bodies)

    def wake(self, bodies: Sequence[int]) -> None:
        """See `Engine.wake`."""
        self._try_all(self._inner.wake, bodies)

    def find_contacts(self, body: int) -> Sequence[int]:
        """See `Engine.find_contacts`."""
        found: list[int] = []
        self._try(body, lambda: found.extend(self._inner.find_contacts(body)))
        return found

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`; bodies that are set aside have none."""
        if self._set_aside.isdisjoint(bodies):
            try:
                return self._inner.read_contacts(bodies)
            except Exception:
                LOG.debug("fault call=read_contacts bodies=%d", len(bodies))
        found: list[ContactPoints] = []
        for body in bodies:
            self._try(body, partial(self._read_contacts_into, found, body))
        return concatenate_contacts(found)

    def _read_contacts_into(self, found: list[ContactPoints], body: int) -> None:
        found.append(self._inner.read_contacts((body,)))

    def take_faults(self) -> Mapping[int, str]:
        """See `Engine.take_faults`."""
        faults, self._faults = self._faults, {}
        return faults

    def _try_all(self, call: Callable[[Sequence[int]], None], bodies: Sequence[int]) -> None:
        if self._set_aside.isdisjoint(bodies):
            try:
                call(bodies)
            except Exception:
                LOG.debug("fault bodies=%d", len(bodies))
            else:
                return
        for body in bodies:
            self._try(body, partial(call, [body]))

    def _try(self, body: int, call: Callable[[], object]) -> None:
        """Make a call for a body; set it aside if that fails."""
        if body in self._set_aside:
            return
        try:
            call()
        except Exception as error:
            self._set_body_aside(body, error)

    def _set_body_aside(self, body: int, error: Exception) -> None:
        LOG.error("fault body=%d model=%s", body, self._models[body].name, exc_info=error)
        self._set_aside.add(body)
        self._faults[body] = describe_fault(error)

    def _read_one(self, body: int) -> BodyStates:
        found: list[BodyStates] = []
        self._try(body, lambda: found.append(self._inner.read((body,))))
        return found[0] if found else make_invalid_state(self._models[body])

    def _step_without_culprit(self, error: Exception) -> None:
        """Take out one body after the other until a step succeeds: the last is the culprit."""
        for body in list(self._list_suspects()):
            self._take_out(body)
            try:
                self._inner.step()
            except Exception as next_error:
                error = next_error
                continue
            self._set_body_aside(body, error)
            return
        raise error

    def _list_suspects(self) -> Iterator[int]:
        """List the bodies that are not valid, then the others from the newest on."""
        newest = [body for body in reversed(self._models) if body not in self._taken_out]
        is_valid = {body: bool(np.isfinite(self._read_one(body).base).all()) for body in newest}
        yield from sorted(newest, key=lambda body: is_valid[body])

    def _take_out(self, body: int) -> None:
        self._discard(body)
        self._set_aside.add(body)
        self._taken_out.add(body)

    def _discard(self, body: int) -> None:
        try:
            self._inner.discard(body)
        except Exception:
            LOG.exception("fault call=discard body=%d", body)
