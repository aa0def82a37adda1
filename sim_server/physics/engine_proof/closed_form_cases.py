"""The cases of a proof: what a trial of an engine has shown, beside the closed form."""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from zensim.proto.engine_proofs import CaseResult
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_proof.engine_trials import (
    EngineTrials,
    HeldArm,
    Pendulum,
    Ramp,
)

SLIDING = Ramp(slope_rad=math.radians(25.0), friction=0.3)
RESTING = Ramp(slope_rad=math.radians(20.0), friction=0.6)
PENDULUM = Pendulum()
ARM = HeldArm()


class ClosedFormCase(NamedTuple):
    """A case: how it is seen, and what is right."""

    name: str
    what: str
    see: Callable[[EngineTrials], float]
    expected: float
    tolerance: float

    def run(self, trials: EngineTrials) -> CaseResult:
        """Try it; an error of the engine is a failure, too."""
        seen, fault = math.nan, ""
        try:
            seen = self.see(trials)
        except Exception as error:  # noqa: BLE001  # a broken engine may raise anything
            fault = f"{type(error).__name__}: {error}"
        found = float(seen) if math.isfinite(seen) else None
        return CaseResult(self.name, self.what, found, self.expected, self.tolerance, fault)


def see_difference(trials: EngineTrials) -> float:
    """See how far two ways to the same accelerations differ, relative to the greatest."""
    first, second = trials.find_accelerations()
    return float(np.abs(first - second).max() / np.abs(second).max())


def see_friction(ramp: Ramp, trials: EngineTrials) -> float:
    """See the friction coefficient of a block that slides."""
    return ramp.find_friction(trials.slide(ramp))


def see_creep(trials: EngineTrials) -> float:
    """See the acceleration of a block that friction holds."""
    return trials.slide(RESTING)


def see_period(trials: EngineTrials) -> float:
    """See the period of a pendulum."""
    return measure_period(trials.swing(PENDULUM), PENDULUM.step_s)


def see_sag(trials: EngineTrials) -> float:
    """See the greatest angle by which a held arm sags."""
    return max(map(abs, trials.hold(ARM).angles))


def see_effort_error(trials: EngineTrials) -> float:
    """See by how much the efforts of a held arm are off those that hold it, relatively."""
    held = trials.hold(ARM)
    right = ARM.find_efforts(held.angles)
    return max(abs(a / b - 1.0) for a, b in zip(held.efforts, right, strict=True))


def measure_period(angles: FloatArray, step_s: float) -> float:
    """Measure the period from the zeros with falling angles; NaN where there are not two."""
    before, after = angles[:-1], angles[1:]
    rows = np.flatnonzero((before > 0.0) & (after <= 0.0))
    if len(rows) < 2:  # noqa: PLR2004
        return math.nan
    zeros = rows + before[rows] / (before[rows] - after[rows])
    return float(zeros[-1] - zeros[0]) / (len(zeros) - 1) * step_s


CASES = (
    ClosedFormCase(
        *("accelerations", "the difference of two ways to them", see_difference, 0.0, 1e-5)
    ),
    ClosedFormCase(
        *("block that slides", "friction", partial(see_friction, SLIDING), SLIDING.friction, 0.01)
    ),
    ClosedFormCase("block at rest", "acceleration [m/s^2]", see_creep, 0.0, 0.01),
    ClosedFormCase("pendulum", "period [s]", see_period, PENDULUM.period_s, 0.002),
    ClosedFormCase("held arm", "sag [rad]", see_sag, 0.0, 0.002),
    ClosedFormCase("effort of a held arm", "relative error", see_effort_error, 0.0, 0.01),
)
