"""Bodies taken out of the world and kept for the next one that is built alike.

Bullet keeps some kilobytes of every body that it ever removed. One that sleeps where nothing
touches it costs a step about a microsecond, and comes back in a tenth of the time of a new one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from proto.model import Joint, Link, Model
from sim_server.physics.actuation import Actuation, actuation_of
from sim_server.physics.loads import Load

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
    """

    model: Model
    parts: int
    actuation: Actuation
    loads: Sequence[Load]
    gears: Sequence[int]

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Bullet's numbers of its joints, in the order of `Model.joints`."""
        return tuple(range(len(self.model.joints)))


class Parking:
    """Which bodies are parked, and where."""

    def __init__(self) -> None:
        self._parked: dict[Build, list[tuple[int, Body]]] = {}
        self._count = 0

    def has_place_for(self, body: Body) -> bool:
        """Whether a body may be parked: gears would wake it."""
        return self._count < PLACES and not body.gears

    def keep(self, number: int, body: Body) -> list[float]:
        """Park a body, and tell where [m]."""
        self._parked.setdefault(_build_of(body.model), []).append((number, body))
        self._count += 1
        return [APART_M * number, 0.0, -DEPTH_M]

    def take(self, model: Model) -> tuple[int, Body] | None:
        """Take a parked body that is built as a model is, as one of this model."""
        if not (parked := self._parked.get(_build_of(model))):
            return None
        self._count -= 1
        number, body = parked.pop()
        return number, replace(body, model=model, actuation=actuation_of(model))

    def take_all(self) -> list[int]:
        """Take all that are parked."""
        taken = [number for parked in self._parked.values() for number, _ in parked]
        self._parked.clear()
        self._count = 0
        return taken


def _build_of(model: Model) -> Build:
    return model.links, model.joints, model.is_static
