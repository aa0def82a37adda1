"""Some bodies, in the order that they are read and told in."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.casting.gathering import Gathering, gathering_of
from zensim.sim_server.physics.casting.make import Make
from zensim.sim_server.physics.casting.seat import Seat
from zensim.sim_server.physics.casting.telling import Telling, telling_of
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.loads import Load


@dataclass
class Body:
    """What the engine knows of a body.

    Attributes:
        slot: Its number among those of its make.
        stand: State (13,) that it reads as where that is not MuJoCo's: when static, or broken.
    """

    model: Model
    make: Make
    slot: int
    seat: Seat
    actuation: Actuation
    loads: Sequence[Load]
    stand: FloatArray | None = None


@dataclass(frozen=True)
class Selection:
    """How some bodies are read and told."""

    gathering: Gathering
    telling: Telling
    nailed: tuple[tuple[int, Body], ...]
    """Rows of what is static."""

    def bases(self, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
        """Read states (n, 13)."""
        rows = np.empty((len(self.gathering.free) + len(self.nailed), 13))
        for row, body in self.nailed:
            rows[row] = body.stand
        return self.gathering.bases(rows, qpos, qvel)


def selection_of(bodies: Sequence[Body]) -> Selection:
    """Work out how bodies are read and told."""
    return Selection(
        gathering_of([body.seat for body in bodies]),
        telling_of((body.seat, body.actuation) for body in bodies),
        tuple((row, body) for row, body in enumerate(bodies) if body.make.is_static),
    )
