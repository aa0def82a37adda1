"""Which wheels resist rolling while they stand."""

import pytest

from sim_server.physics.blueprint import blueprint_of
from sim_server.physics.holding import RESISTANCE, holds_of
from tests.models import a_box, a_box_bot


def test_wheels_with_motors_resist_by_their_radius() -> None:
    model = a_box_bot()

    holds = dict(holds_of(model, blueprint_of(model)))

    assert holds == {0: pytest.approx(RESISTANCE * 0.035), 1: pytest.approx(RESISTANCE * 0.035)}


def test_what_has_no_motors_rolls_freely() -> None:
    assert holds_of(a_box(), blueprint_of(a_box())) == ()
