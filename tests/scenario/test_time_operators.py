"""Operators of checks in time, on hand-made traces, against brute force and against rtamt."""

import importlib
import math
import random
import sys
import warnings

import numpy as np
import pytest

from zensim.scenario.time_operators import (
    NOT_EVALUATED,
    Always,
    Eventually,
    TimeOperator,
    combine_results,
)

RTAMT_SEEDS = range(20) if sys.version_info < (3, 13) else range(0)
"""rtamt pins a parser that later versions of Python cannot import."""


def margin_of(operator: TimeOperator, trace: list[float], period: float = 1.0) -> float:
    for number, value in enumerate(trace):
        operator.update(number * period, np.array([value]))
    return operator.result().margin


def of_rtamt(formula: str, trace: list[float]) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        rtamt = importlib.import_module("rtamt")
    monitor = rtamt.StlDiscreteTimeSpecification()
    monitor.declare_var("x", "float")
    monitor.spec = formula
    monitor.parse()
    series = {"time": list(range(len(trace))), "x": trace}
    return float(monitor.evaluate(series)[0][1])


@pytest.mark.parametrize(
    ("operator", "trace", "margin"),
    [
        (Always(), [3.0, 1.0, 2.0], 1.0),
        (Always(), [3.0, -1.0, 2.0], -1.0),
        (Always(1.0), [-9.0, 1.0, 2.0], 1.0),
        (Always(0.0, 1.0), [3.0, 1.0, -9.0], 1.0),
        (Eventually(0.0, 2.0), [-1.0, 2.0, -3.0], 2.0),
        (Eventually(0.0, 1.0), [-1.0, -2.0, 3.0], -1.0),
        (Eventually(1.0, 2.0), [9.0, -2.0, -1.0], -1.0),
        (Eventually(0.0, 3.0, hold=1.0), [-1.0, 2.0, 1.0, -3.0], 1.0),
        (Eventually(0.0, 3.0, hold=1.0), [-1.0, 2.0, -1.0, 2.0, -5.0], -1.0),
    ],
)
def test_margin_of_a_hand_made_trace(
    operator: TimeOperator, trace: list[float], margin: float
) -> None:
    assert margin_of(operator, trace) == margin


def test_nothing_is_evaluated_outside_of_the_interval() -> None:
    assert math.isnan(margin_of(Always(10.0), [1.0, 2.0]))
    assert math.isnan(margin_of(Eventually(10.0, 12.0), [1.0, 2.0]))


def test_hold_needs_its_whole_time() -> None:
    assert margin_of(Eventually(0.0, 5.0, hold=3.0), [1.0, 1.0]) == -math.inf


def test_each_robot_has_to_pass_at_a_time_of_its_own() -> None:
    operator = Eventually(0.0, 2.0)

    for now, margins in enumerate(([1.0, -1.0], [-1.0, 2.0], [-5.0, -5.0])):
        operator.update(float(now), np.array(margins))

    assert operator.result().margin == 1.0


def test_result_names_time_and_robot_of_the_worst() -> None:
    operator = Always()

    for now, margins in enumerate(([3.0, 2.0], [1.0, 4.0], [2.0, 2.0])):
        operator.update(float(now), np.array(margins))

    found = operator.result()
    assert (found.margin, found.time, found.row) == (1.0, 1.0, 0)


def test_results_combine_to_the_worst() -> None:
    operators = [Always(), Always(), Always()]
    operators[0].update(0.0, np.array([2.0]))
    operators[1].update(0.0, np.array([-1.0]))

    assert combine_results([one.result() for one in operators]).margin == -1.0
    assert combine_results([]) is NOT_EVALUATED


@pytest.mark.parametrize("seed", RTAMT_SEEDS)
def test_margins_are_those_of_rtamt(seed: int) -> None:
    source = random.Random(seed)

    for _ in range(20):
        trace = [source.uniform(-2.0, 2.0) for _ in range(30)]
        start, length, hold = source.randint(0, 5), source.randint(0, 8), source.randint(0, 6)
        end = start + length
        always = margin_of(Always(float(start), float(end)), trace)
        held = margin_of(Eventually(float(start), float(end), float(hold)), trace)

        assert always == pytest.approx(of_rtamt(f"always[{start}:{end}](x >= 0)", trace), abs=1e-9)
        formula = f"eventually[{start}:{end}](always[0:{hold}](x >= 0))"
        assert held == pytest.approx(of_rtamt(formula, trace), abs=1e-9)


def test_margins_are_those_of_brute_force() -> None:
    source = random.Random(1)

    for _ in range(1000):
        trace = [source.uniform(-2.0, 2.0) for _ in range(30)]
        start, length, hold = source.randint(0, 5), source.randint(0, 8), source.randint(0, 6)
        window = range(start, start + length + 1)

        held = margin_of(Eventually(start, start + length, hold), trace)

        assert held == max(min(trace[at : at + hold + 1]) for at in window)
        always = margin_of(Always(start, start + length), trace)
        assert always == min(trace[start : start + length + 1])
