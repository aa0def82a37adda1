"""The cases of a proof: sound engines pass them, each wrong answer fails its own."""

import math
from importlib import import_module
from typing import get_args

import numpy as np
import pytest

from tests import wrong_trials
from zensim.proto.engine_proofs import EngineName
from zensim.sim_server.physics.engine_proof.closed_form_cases import CASES, measure_period
from zensim.sim_server.physics.engine_proof.engine_prover import TRIALS
from zensim.sim_server.physics.engine_proof.engine_trials import (
    GRAVITY,
    EngineTrials,
    HeldArm,
    Pendulum,
    Ramp,
)


def failures_of(trials: EngineTrials) -> list[str]:
    return [case.name for case in CASES if not case.run(trials).is_passed]


@pytest.mark.parametrize("engine", get_args(EngineName))
def test_installed_engine_passes_every_case(engine: EngineName) -> None:
    module, class_name = TRIALS[engine]

    assert failures_of(getattr(import_module(module), class_name)()) == []


@pytest.mark.parametrize(
    ("trials", "case"),
    [
        (wrong_trials.TwoAccelerations, "accelerations"),
        (wrong_trials.NoNumbers, "accelerations"),
        (wrong_trials.SlipperyGround, "block that slides"),
        (wrong_trials.CreepingBlock, "block at rest"),
        (wrong_trials.SlowPendulum, "pendulum"),
        (wrong_trials.StillPendulum, "pendulum"),
        (wrong_trials.RaisingTrials, "pendulum"),
        (wrong_trials.SaggingArm, "held arm"),
        (wrong_trials.WrongEfforts, "effort of a held arm"),
    ],
)
def test_engine_with_a_wrong_answer_fails_the_case_of_it(
    trials: type[wrong_trials.CountedTrials], case: str
) -> None:
    assert failures_of(trials()) == [case]


def test_error_of_an_engine_is_the_fault_of_its_case() -> None:
    faults = [case.run(wrong_trials.RaisingTrials()).fault for case in CASES]

    assert [fault for fault in faults if fault] == ["SystemError: 1.0 kg"]


def test_period_of_small_swings_is_that_of_the_linear_pendulum() -> None:
    pendulum = Pendulum(length_m=1.0, moment=0.0, amplitude_rad=1e-6)

    assert pendulum.period_s == pytest.approx(math.tau / math.sqrt(GRAVITY))


def test_period_at_right_angles_is_longer_by_the_elliptic_integral() -> None:
    small = Pendulum(amplitude_rad=1e-6).period_s

    # 2 K(1/2) / pi, Abramowitz and Stegun, table 17.1
    assert Pendulum(amplitude_rad=math.pi / 2.0).period_s / small == pytest.approx(1.1803405990)


def test_period_is_measured_between_zeros() -> None:
    angles = np.cos(math.tau / 0.8 * np.arange(0.0, 4.0, 0.01))

    assert measure_period(angles, 0.01) == pytest.approx(0.8, abs=1e-4)


def test_block_slides_by_gravity_less_friction() -> None:
    ramp = Ramp(slope_rad=0.5, friction=0.2)

    acceleration = GRAVITY * (math.sin(0.5) - 0.2 * math.cos(0.5))

    assert ramp.find_friction(acceleration) == pytest.approx(0.2)


def test_level_arm_is_held_by_the_moments_of_its_weights() -> None:
    arm = HeldArm(lengths_m=(0.6, 0.4), masses_kg=(3.0, 2.0))

    first, second = arm.find_efforts((0.0, 0.0))

    assert second == pytest.approx(-GRAVITY * 2.0 * 0.2)
    assert first == pytest.approx(-GRAVITY * (3.0 * 0.3 + 2.0 * 0.8))
