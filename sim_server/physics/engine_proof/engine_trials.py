"""What an engine does in the cases of its proof, and what it shall have done.

Trials use the engine's library alone, with settings of their own: no setting of a world matters.
"""

import math
from typing import NamedTuple, Protocol

from zensim.sim_server.physics.engine import FloatArray

GRAVITY = 9.81
"""[m/s^2]"""
MEANS = 6
"""Arithmetic-geometric means; each doubles the correct digits."""


class Ramp(NamedTuple):
    """A block on a plane that is tilted; gravity is tilted in its place."""

    slope_rad: float
    friction: float
    half_extents_m: tuple[float, float, float] = (0.2, 0.2, 0.05)
    mass_kg: float = 2.0
    duration_s: float = 0.6

    @property
    def gravity(self) -> tuple[float, float, float]:
        """Gravity [m/s^2] in the frame of the plane, x down the slope."""
        along, into = math.sin(self.slope_rad), math.cos(self.slope_rad)
        return GRAVITY * along, 0.0, -GRAVITY * into

    def find_friction(self, acceleration: float) -> float:
        """Find the friction coefficient with which a block slides so [m/s^2]."""
        along, _, into = self.gravity
        return (along - acceleration) / -into


class Pendulum(NamedTuple):
    """A body on a hinge, released at rest."""

    length_m: float = 0.5
    """Distance from the hinge to the centre of mass."""
    mass_kg: float = 1.0
    moment: float = 0.01
    """Moment about the centre of mass [kg m^2]."""
    amplitude_rad: float = 1.0
    step_s: float = 0.001
    duration_s: float = 4.0

    @property
    def period_s(self) -> float:
        """Exact period, by the arithmetic-geometric mean."""
        inertia = self.moment + self.mass_kg * self.length_m**2
        small = math.tau * math.sqrt(inertia / (self.mass_kg * GRAVITY * self.length_m))
        x, y = 1.0, math.cos(self.amplitude_rad / 2.0)
        for _ in range(MEANS):
            x, y = (x + y) / 2.0, math.sqrt(x * y)
        return small / x


class HeldArm(NamedTuple):
    """Two links on hinges about y, the second at the end of the first; both are held level."""

    lengths_m: tuple[float, float] = (0.5, 0.4)
    masses_kg: tuple[float, float] = (2.0, 1.0)
    moment: float = 0.03
    """Moment of each link about its centre of mass, which is its middle [kg m^2]."""
    duration_s: float = 1.5

    def find_efforts(self, angles: tuple[float, float]) -> tuple[float, float]:
        """Find the efforts [N m] that hold the arm at these angles [rad]; positive is down."""
        (near, far), (first, second) = self.lengths_m, self.masses_kg
        outer = -GRAVITY * second * far / 2.0 * math.cos(sum(angles))
        inner = -GRAVITY * (first * near / 2.0 + second * near) * math.cos(angles[0])
        return inner + outer, outer


class Held(NamedTuple):
    """An arm after some time."""

    angles: tuple[float, float]
    """[rad]"""
    efforts: tuple[float, float]
    """Efforts of the motors [N m]."""


class EngineTrials(Protocol):
    """Trials of one engine."""

    def find_accelerations(self) -> tuple[FloatArray, FloatArray]:
        """Find accelerations in two ways that have only the result in common."""

    def slide(self, ramp: Ramp) -> float:
        """Release a block; return its acceleration [m/s^2] in the second half of the time."""

    def swing(self, pendulum: Pendulum) -> FloatArray:
        """Release a pendulum; return its angle [rad] after each step, the start included."""

    def hold(self, arm: HeldArm) -> Held:
        """Hold an arm that is level at first."""
