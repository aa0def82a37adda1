"""The control steps at which a sensor is due: a rule on the step alone, alike in every process."""

from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.standard_messages import NANOSECONDS

WHOLE_TOLERANCE = 1e-6
"""A step is a whole number of nanoseconds: 1/240 s is 4166667 ns."""
ROUNDING = 1e-9
"""Periods by which a product may be too small."""


def find_step_rate_hz(environment: Environment) -> float:
    """Find the steps in a second of simulation time, as configured before rounding to ns."""
    rate_hz = NANOSECONDS / environment.step_ns
    return round(rate_hz) if abs(rate_hz - round(rate_hz)) < WHOLE_TOLERANCE * rate_hz else rate_hz


def find_true_rate_hz(rate_hz: float, environment: Environment) -> float:
    """Find the mean rate at which a sensor publishes; 0 asks for every control step."""
    control_hz = find_step_rate_hz(environment) / environment.control_steps
    return min(rate_hz, control_hz) if rate_hz > 0.0 else control_hz


def is_due(
    step: int, rate_hz: float, environment: Environment, seen_step: int | None = None
) -> bool:
    """Whether a sensor is due at a control step.

    It is due at the first control step at or after each multiple of its period since the epoch
    began, so that sensors of one rate are due together, whenever their robots were spawned.

    Args:
        step: Since the epoch began; a control step.
        rate_hz: 0 = at every control step.
        environment: Has the length of steps.
        seen_step: The last control step that this was asked for, where some are left out: agents
            miss states while time runs as fast as possible. None = the one before.
    """
    if seen_step is None:
        seen_step = step - environment.control_steps
    if rate_hz <= 0.0 or step == 0:
        return step != seen_step
    periods = rate_hz / find_step_rate_hz(environment)
    now, before = step * periods + ROUNDING, seen_step * periods + ROUNDING
    return now // 1.0 > before // 1.0


def count_due(before: int, step: int, rate_hz: float, environment: Environment) -> int:
    """Count the control steps after `before` and up to `step` at which a sensor is due."""
    control_steps = max(environment.control_steps, 1)
    steps = max(0, (step - before) // control_steps)
    if rate_hz <= 0.0:
        return steps
    periods = rate_hz / find_step_rate_hz(environment)
    passed = (step * periods + ROUNDING) // 1.0 - (before * periods + ROUNDING) // 1.0
    return min(steps, max(0, int(passed)))
