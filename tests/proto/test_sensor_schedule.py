"""When sensors are due: a rule on steps."""

import pytest

from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.sensor_schedule import find_true_rate_hz, is_due

AT_240_HZ = Environment(step_ns=4166667, control_steps=3)


def list_due(rate_hz: float, environment: Environment, seconds: int, step_hz: int) -> list[int]:
    steps = range(0, seconds * step_hz + 1, environment.control_steps)
    return [step for step in steps if is_due(step, rate_hz, environment)]


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0, 25.0, 30.0, 40.0, 79.0, 80.0])
def test_mean_rate_is_that_asked_for(rate_hz: float) -> None:
    assert len(list_due(rate_hz, AT_240_HZ, 60, 240)) == pytest.approx(60 * rate_hz + 1, abs=1)


def test_ten_hertz_are_due_at_every_24th_step() -> None:
    assert list_due(10.0, AT_240_HZ, 3600, 240) == list(range(0, 3600 * 240 + 1, 24))


def test_rates_above_the_control_rate_are_due_at_each_control_step() -> None:
    assert list_due(1000.0, AT_240_HZ, 2, 240) == list(range(0, 481, 3))
    assert find_true_rate_hz(1000.0, AT_240_HZ) == 80.0
    assert find_true_rate_hz(0.0, AT_240_HZ) == 80.0
    assert find_true_rate_hz(10.0, AT_240_HZ) == 10.0


def test_a_rate_of_zero_is_due_at_each_control_step() -> None:
    assert all(is_due(step, 0.0, AT_240_HZ) for step in range(0, 240, 3))


def test_steps_of_odd_lengths_keep_the_mean_rate() -> None:
    environment = Environment(step_ns=1234567, control_steps=8)
    seconds = 100
    steps = range(0, int(seconds * 1e9 / 1234567) + 1, 8)

    assert sum(is_due(step, 10.0, environment) for step in steps) == pytest.approx(1001, abs=1)


def test_a_due_step_that_was_left_out_is_made_up_for_at_the_next() -> None:
    assert is_due(27, 10.0, AT_240_HZ, seen_step=21)
    assert not is_due(30, 10.0, AT_240_HZ, seen_step=27)
    assert is_due(24, 10.0, AT_240_HZ, seen_step=21)


@pytest.mark.parametrize("rate_hz", [0.0, 10.0, 1000.0])
def test_a_step_that_was_seen_is_not_due_again(rate_hz: float) -> None:
    assert not is_due(24, rate_hz, AT_240_HZ, seen_step=24)
    assert not is_due(0, rate_hz, AT_240_HZ, seen_step=0)
