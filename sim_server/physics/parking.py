"""Bodies taken out of the world and kept for the next one that is built alike.

Bullet keeps some kilobytes of every body that it ever removed. One that sleeps where nothing
touches it costs a step two microseconds, and comes back in a tenth of the time of a new one; but it
is stopped in the first step after its sleep. One that stays awake costs 13, and comes back moving.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Joint, Link, Model
from zensim.sim_server.physics.actuation import Actuation, actuation_of
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.holding import Holds, holds_of
from zensim.sim_server.physics.loads import Load

PLACES = 64
DEPTH_M = 1e4
"""How far under the world parked bodies are."""
APART_M = 100.0


Build = tuple[tuple[Link, ...], tuple[Joint, ...], bool]
"""What Bullet makes a body of; robots that differ in topics and namespace are built alike."""


@dataclass(frozen=True)
class Body:
    """What the engine knows of a body.

    Attributes:
        parts: How many Bullet counts besides the root.
        gears: Bullet's numbers of the constraints between its joints.
        holds: What resists rolling while it stands.
    """

    model: Model
    parts: int
    actuation: Actuation
    loads: Sequence[Load]
    gears: Sequence[int]
    holds: Holds

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Bullet's numbers of its joints, in the order of `Model.joints`."""
        return tuple(range(len(self.model.joints)))


def body_of(
    model: Model, blueprint: Blueprint, loads: Sequence[Load], gears: Sequence[int]
) -> Body:
    """Note what a body was made of."""
    parts, holds = len(blueprint.parts) - 1, holds_of(model, blueprint)
    return Body(model, parts, actuation_of(model), loads, gears, holds)


class Parked(NamedTuple):
    """A body that was parked."""

    number: int
    body: Body
    was_awake: bool


class Parking:
    """Which bodies are parked, and where."""

    def __init__(self, awake: int) -> None:
        """Let so many of the newest stay awake: one that slept cannot come back moving."""
        self._parked: dict[Build, list[tuple[int, Body]]] = {}
        self._count = 0
        self._may_be_awake = awake
        self._awake: list[int] = []
        self._rising: list[int] = []

    def has_place_for(self, body: Body) -> bool:
        """Whether a body may be parked: gears would wake it."""
        return self._count < PLACES and not body.gears

    def keep(self, number: int, body: Body) -> FloatArray:
        """Park a body, and tell in which state (13,)."""
        self._parked.setdefault(_build_of(body.model), []).append((number, body))
        self._count += 1
        return np.array([APART_M * number, 0.0, -DEPTH_M, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])

    def keep_awake(self, number: int) -> list[int]:
        """Note that a parked body is awake; name those that are to sleep."""
        self._awake.append(number)
        return self._tired()

    def take(self, model: Model, *, awake: bool) -> Parked | None:
        """Take a parked body that is built as a model is, as one of this model.

        Args:
            model: What it is to be of.
            awake: Take none that sleeps.
        """
        parked = self._parked.get(_build_of(model), [])
        for at in reversed(range(len(parked))):
            if not awake or parked[at][0] in self._awake:
                number, body = parked.pop(at)
                self._count -= 1
                was_awake = number in self._awake
                for listed in (self._awake, self._rising):
                    if number in listed:
                        listed.remove(number)
                alike = replace(body, model=model, actuation=actuation_of(model))
                return Parked(number, alike, was_awake)
        return None

    def next_to_rise(self, model: Model) -> int | None:
        """Choose a sleeper that is built as a model is: it will be awake after the next step."""
        parked = self._parked.get(_build_of(model), [])
        up = {*self._awake, *self._rising}
        found = next((number for number, _ in reversed(parked) if number not in up), None)
        if found is not None:
            self._rising.append(found)
        return found

    def after_step(self) -> list[int]:
        """Note that a step is over; name those that are to sleep."""
        self._awake += self._rising
        self._rising.clear()
        return self._tired()

    def take_all(self) -> list[int]:
        """Take all that are parked."""
        taken = [number for parked in self._parked.values() for number, _ in parked]
        self._parked.clear()
        self._awake.clear()
        self._rising.clear()
        self._count = 0
        return taken

    def _tired(self) -> list[int]:
        over = max(0, len(self._awake) - self._may_be_awake)
        tired, self._awake = self._awake[:over], self._awake[over:]
        return tired


def _build_of(model: Model) -> Build:
    return model.links, model.joints, model.is_static
