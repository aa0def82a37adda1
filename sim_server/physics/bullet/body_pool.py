"""Removed Bullet bodies, parked and reused by the next body of the same build."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Joint, Link, Model
from zensim.sim_server.physics.actuation import Actuation, make_actuation
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.bullet.bullet_contact import RollingFrictions, find_rolling_frictions
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.link_forces import LinkForce

MAX_PARKED_BODIES = 64
PARKING_DEPTH_M = 1e4
"""How far under the world parked bodies are."""
PARKING_SPACING_M = 100.0


BodyBuildKey = tuple[tuple[Link, ...], tuple[Joint, ...], bool]
"""What Bullet makes a body of; robots that differ in topics and namespace are built alike."""


@dataclass(frozen=True)
class BulletBody:
    """What the engine knows of a body.

    Attributes:
        parts: How many Bullet counts besides the root.
        gears: Bullet's numbers of the constraints between its joints.
        holds: What resists rolling while it stands.
    """

    model: Model
    parts: int
    actuation: Actuation
    loads: Sequence[LinkForce]
    gears: Sequence[int]
    holds: RollingFrictions

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Bullet's numbers of its joints, in the order of `Model.joints`."""
        return tuple(range(len(self.model.joints)))


def make_bullet_body(
    model: Model, blueprint: Blueprint, loads: Sequence[LinkForce], gears: Sequence[int]
) -> BulletBody:
    """Note what a body was made of."""
    parts, holds = len(blueprint.parts) - 1, find_rolling_frictions(model, blueprint)
    return BulletBody(model, parts, make_actuation(model), loads, gears, holds)


class ParkedBody(NamedTuple):
    """A body that was parked."""

    number: int
    body: BulletBody
    was_awake: bool


class BodyPool:
    """Which bodies are parked, and where."""

    def __init__(self, awake: int) -> None:
        """Let so many of the newest stay awake: one that slept cannot come back moving."""
        self._parked: dict[BodyBuildKey, list[tuple[int, BulletBody]]] = {}
        self._count = 0
        self._max_awake = awake
        self._awake: list[int] = []
        self._waking: list[int] = []

    def has_room_for(self, body: BulletBody) -> bool:
        """Whether a body may be parked: gears would wake it."""
        return self._count < MAX_PARKED_BODIES and not body.gears

    def park(self, number: int, body: BulletBody) -> FloatArray:
        """Park a body, and tell in which state (13,)."""
        self._parked.setdefault(_make_build_key(body.model), []).append((number, body))
        self._count += 1
        return np.array(
            [PARKING_SPACING_M * number, 0.0, -PARKING_DEPTH_M, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6]
        )

    def add_awake(self, number: int) -> list[int]:
        """Note that a parked body is awake; name those that are to sleep."""
        self._awake.append(number)
        return self._take_excess_awake()

    def take(self, model: Model, *, awake: bool) -> ParkedBody | None:
        """Take a parked body that is built as a model is, as one of this model.

        Args:
            model: What it is to be of.
            awake: Take none that sleeps.
        """
        parked = self._parked.get(_make_build_key(model), [])
        for at in reversed(range(len(parked))):
            if not awake or parked[at][0] in self._awake:
                number, body = parked.pop(at)
                self._count -= 1
                was_awake = number in self._awake
                for listed in (self._awake, self._waking):
                    if number in listed:
                        listed.remove(number)
                alike = replace(body, model=model, actuation=make_actuation(model))
                return ParkedBody(number, alike, was_awake)
        return None

    def wake_next(self, model: Model) -> int | None:
        """Choose a sleeper that is built as a model is: it will be awake after the next step."""
        parked = self._parked.get(_make_build_key(model), [])
        up = {*self._awake, *self._waking}
        found = next((number for number, _ in reversed(parked) if number not in up), None)
        if found is not None:
            self._waking.append(found)
        return found

    def after_step(self) -> list[int]:
        """Note that a step is over; name those that are to sleep."""
        self._awake += self._waking
        self._waking.clear()
        return self._take_excess_awake()

    def take_all(self) -> list[int]:
        """Take all that are parked."""
        taken = [number for parked in self._parked.values() for number, _ in parked]
        self._parked.clear()
        self._awake.clear()
        self._waking.clear()
        self._count = 0
        return taken

    def _take_excess_awake(self) -> list[int]:
        over = max(0, len(self._awake) - self._max_awake)
        tired, self._awake = self._awake[:over], self._awake[over:]
        return tired


def _make_build_key(model: Model) -> BodyBuildKey:
    return model.links, model.joints, model.is_static
