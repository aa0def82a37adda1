"""Pool of removed Bullet bodies, reused by the next body that is built alike."""

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
"""Depth of pooled bodies below the world."""
PARKING_SPACING_M = 100.0


BodyBuildKey = tuple[tuple[Link, ...], tuple[Joint, ...], bool]
"""What a Bullet body depends on; topics and namespaces do not count."""


@dataclass(frozen=True)
class BulletBody:
    """A body in Bullet.

    Attributes:
        parts: Number of parts besides the root.
        gears: Bullet's numbers of its gear constraints.
        rolling_frictions: Rolling friction of its wheels while it stands.
    """

    model: Model
    parts: int
    actuation: Actuation
    loads: Sequence[LinkForce]
    gears: Sequence[int]
    rolling_frictions: RollingFrictions

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Bullet's joint numbers, in the order of `Model.joints`."""
        return tuple(range(len(self.model.joints)))


def make_bullet_body(
    model: Model, blueprint: Blueprint, loads: Sequence[LinkForce], gears: Sequence[int]
) -> BulletBody:
    """Make the record of a body."""
    return BulletBody(
        model,
        parts=len(blueprint.parts) - 1,
        actuation=make_actuation(model),
        loads=loads,
        gears=gears,
        rolling_frictions=find_rolling_frictions(model, blueprint),
    )


class ParkedBody(NamedTuple):
    """A body taken from the pool."""

    number: int
    body: BulletBody
    was_awake: bool


class BodyPool:
    """Bodies parked below the world."""

    def __init__(self, awake: int) -> None:
        """Keep this many of the newest awake: a sleeping body cannot be reused with a velocity."""
        self._parked: dict[BodyBuildKey, list[tuple[int, BulletBody]]] = {}
        self._count = 0
        self._max_awake = awake
        self._awake: list[int] = []
        self._waking: list[int] = []

    def has_room_for(self, body: BulletBody) -> bool:
        """Whether a body may be parked; not with gears, which would wake it."""
        return self._count < MAX_PARKED_BODIES and not body.gears

    def park(self, number: int, body: BulletBody) -> FloatArray:
        """Park a body; return the state (13,) to set."""
        self._parked.setdefault(_make_build_key(body.model), []).append((number, body))
        self._count += 1
        return np.array(
            [PARKING_SPACING_M * number, 0.0, -PARKING_DEPTH_M, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6]
        )

    def add_awake(self, number: int) -> list[int]:
        """Record that a parked body is awake; return those to put to sleep."""
        self._awake.append(number)
        return self._take_excess_awake()

    def take(self, model: Model, *, awake: bool) -> ParkedBody | None:
        """Take a parked body that is built as a model needs.

        Args:
            model: Of the body.
            awake: Only if it is awake.
        """
        parked = self._parked.get(_make_build_key(model), [])
        for i in reversed(range(len(parked))):
            if not awake or parked[i][0] in self._awake:
                number, body = parked.pop(i)
                self._count -= 1
                was_awake = number in self._awake
                for listed in (self._awake, self._waking):
                    if number in listed:
                        listed.remove(number)
                reused = replace(body, model=model, actuation=make_actuation(model))
                return ParkedBody(number, reused, was_awake)
        return None

    def wake_next(self, model: Model) -> int | None:
        """Choose a sleeping body built as a model needs; it counts as awake after the next step."""
        parked = self._parked.get(_make_build_key(model), [])
        awake = {*self._awake, *self._waking}
        found = next((number for number, _ in reversed(parked) if number not in awake), None)
        if found is not None:
            self._waking.append(found)
        return found

    def after_step(self) -> list[int]:
        """Count woken bodies as awake; return those to put to sleep."""
        self._awake += self._waking
        self._waking.clear()
        return self._take_excess_awake()

    def take_all(self) -> list[int]:
        """Empty the pool; return all bodies."""
        taken = [number for parked in self._parked.values() for number, _ in parked]
        self._parked.clear()
        self._awake.clear()
        self._waking.clear()
        self._count = 0
        return taken

    def _take_excess_awake(self) -> list[int]:
        count = max(0, len(self._awake) - self._max_awake)
        excess, self._awake = self._awake[:count], self._awake[count:]
        return excess


def _make_build_key(model: Model) -> BodyBuildKey:
    return model.links, model.joints, model.is_static
