"""Real engines with one wrong answer, for the proof of engines."""

from typing import ClassVar

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_proof.engine_trials import Held, HeldArm, Pendulum, Ramp
from zensim.sim_server.physics.engine_proof.mujoco_trials import MujocoTrials


class CountedTrials(MujocoTrials):
    """MuJoCo that counts how often it has to prove itself."""

    made: ClassVar[list[str]] = []

    def __init__(self) -> None:
        self.made.append(type(self).__name__)


class TwoAccelerations(CountedTrials):
    """One way to the accelerations is off in one of them, once."""

    def find_accelerations(self) -> tuple[FloatArray, FloatArray]:
        first, second = super().find_accelerations()
        first[-1, 0] += 0.01 * abs(second).max()
        return first, second


class NoNumbers(CountedTrials):
    """Accelerations are no numbers."""

    def find_accelerations(self) -> tuple[FloatArray, FloatArray]:
        first, second = super().find_accelerations()
        return first * float("nan"), second


class SlipperyGround(CountedTrials):
    """Friction is weaker than it should be."""

    def slide(self, ramp: Ramp) -> float:
        return super().slide(ramp._replace(friction=0.9 * ramp.friction))


class CreepingBlock(CountedTrials):
    """Friction never holds a block."""

    def slide(self, ramp: Ramp) -> float:
        return super().slide(ramp) + 0.02


class SlowPendulum(CountedTrials):
    """Gravity is weaker than it should be."""

    def swing(self, pendulum: Pendulum) -> FloatArray:
        return super().swing(pendulum._replace(length_m=1.01 * pendulum.length_m))


class StillPendulum(CountedTrials):
    """A pendulum does not move."""

    def swing(self, pendulum: Pendulum) -> FloatArray:
        return abs(super().swing(pendulum)) + 1.0


class SaggingArm(CountedTrials):
    """Motors are soft."""

    def hold(self, arm: HeldArm) -> Held:
        (first, second), efforts = super().hold(arm)
        return Held((first, second + 0.01), efforts)


class WrongEfforts(CountedTrials):
    """One reported effort is not that of the motor."""

    def hold(self, arm: HeldArm) -> Held:
        angles, (first, second) = super().hold(arm)
        return Held(angles, (first, 1.02 * second))


class RaisingTrials(CountedTrials):
    """The library raises what nobody expects."""

    def swing(self, pendulum: Pendulum) -> FloatArray:
        raise SystemError(f"{pendulum.mass_kg} kg")
