"""Contract of steering targets and planar twists."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import ENGINES, advance, running
from tests.models import a_box, a_cart, a_fork, a_puck, a_state, on_ground
from zensim.sim_server.physics.actuation import make_stop_targets
from zensim.sim_server.physics.engine import Engine, FloatArray

STEPS_OF_1_S = 240
STEERING = 3
STEER_TARGETS = np.array([2.0, 0.4])


@pytest.fixture(params=ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def state_of(engine: Engine, body: int) -> FloatArray:
    return np.asarray(engine.read([body]).base[0])


def test_engine_turns_a_joint_to_its_target_angle(engine: Engine) -> None:
    body = engine.add(a_fork(), a_state())

    engine.command([body], STEER_TARGETS)
    advance(engine, STEPS_OF_1_S)

    reading = engine.read([body])
    assert reading.joint_positions[STEERING] == pytest.approx(0.4, abs=1e-3)
    assert reading.joint_velocities[STEERING] == pytest.approx(0.0, abs=1e-3)
    assert reading.joint_velocities[0] == pytest.approx(2.0, rel=0.01)


def test_engine_keeps_the_angle_of_a_joint_when_it_is_stopped(engine: Engine) -> None:
    model = a_fork()
    body = engine.add(model, a_state())
    engine.command([body], STEER_TARGETS)
    advance(engine, STEPS_OF_1_S)

    engine.command([body], make_stop_targets(model, engine.read([body]).joint_positions))
    advance(engine, STEPS_OF_1_S)

    reading = engine.read([body])
    assert reading.joint_positions[STEERING] == pytest.approx(0.4, abs=1e-3)
    assert reading.joint_velocities == pytest.approx(np.zeros(4), abs=1e-3)


def test_engine_sets_steering_straight_at_rest(engine: Engine) -> None:
    body = engine.add(a_fork(), a_state())
    engine.command([body], STEER_TARGETS)
    advance(engine, STEPS_OF_1_S)

    engine.set_at_rest(body, a_state())
    advance(engine, STEPS_OF_1_S)

    assert engine.read([body]).joint_positions == pytest.approx(np.zeros(4), abs=1e-3)


@pytest.mark.parametrize(
    ("ahead", "left"), [(0.5, 0.0), (0.0, 0.5), (-0.3, 0.4)], ids=["ahead", "left", "askew"]
)
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_engine_moves_a_body_along_its_heading_by_its_twist(
    engine: Engine, ahead: float, left: float, heading: float
) -> None:
    body = engine.add(a_puck(), a_state(turn=(0.0, 0.0, heading)))

    engine.command([body], np.array([ahead, left, 0.0]))
    advance(engine, 2 * STEPS_OF_1_S)

    x, y = state_of(engine, body)[:2]
    cos, sin = math.cos(heading), math.sin(heading)
    expected = [2.0 * (cos * ahead - sin * left), 2.0 * (sin * ahead + cos * left)]
    assert [x, y] == pytest.approx(expected, abs=0.01)


def test_engine_turns_a_body_about_its_root_by_its_twist(engine: Engine) -> None:
    body = engine.add(a_puck(), a_state((1.0, 2.0, 0.0)))

    engine.command([body], np.array([0.0, 0.0, 1.0]))
    advance(engine, STEPS_OF_1_S)

    row = state_of(engine, body)
    assert row[:2] == pytest.approx([1.0, 2.0], abs=0.01)
    assert 2.0 * math.atan2(row[5], row[6]) == pytest.approx(1.0, abs=0.01)


def test_engine_stops_a_body_when_its_twist_is_zero(engine: Engine) -> None:
    body = engine.add(a_puck(), a_state())
    engine.command([body], np.array([1.0, 0.5, 1.0]))
    advance(engine, STEPS_OF_1_S)

    engine.command([body], np.zeros(3))
    advance(engine, 60)

    assert state_of(engine, body)[7:] == pytest.approx(np.zeros(6), abs=0.02)


def test_engine_imposes_no_twist_before_one_is_commanded(engine: Engine) -> None:
    flying = a_state((0.0, 0.0, 50.0), angular=(0.0, 0.0, 1.0))
    added, rested = engine.add(a_puck(), flying), engine.add(a_puck(), a_state((9.0, 0.0, 0.0)))
    engine.command([rested], np.array([0.0, 1.0, 0.0]))
    advance(engine, 10)

    engine.set_at_rest(rested, flying)
    advance(engine, 10)

    for body in (added, rested):
        assert state_of(engine, body)[12] == pytest.approx(1.0, abs=0.01)


def test_engine_gives_each_body_its_targets_when_drives_differ(engine: Engine) -> None:
    puck = engine.add(a_puck(), a_state((0.0, 5.0, 0.0)))
    box = engine.add(a_box(), a_state((0.0, 3.0, 0.1)))
    cart = engine.add(a_cart(), on_ground())
    fork = engine.add(a_fork(), a_state((0.0, 9.0, 0.0)))

    targets = np.concatenate([STEER_TARGETS, [4.0, 4.0], [0.0, 0.5, 0.0]])
    engine.command([fork, box, cart, puck], targets)
    advance(engine, STEPS_OF_1_S)

    assert state_of(engine, cart)[0] == pytest.approx(0.2, abs=0.02)
    assert state_of(engine, puck)[1] == pytest.approx(5.5, abs=0.02)
    assert engine.read([fork]).joint_positions[STEERING] == pytest.approx(0.4, abs=1e-3)


def test_engine_forgets_the_twist_of_a_body_that_was_removed(engine: Engine) -> None:
    gone = engine.add(a_puck(), a_state((5.0, 5.0, 0.0)))
    engine.command([gone], np.array([1.0, 0.0, 0.0]))
    engine.remove(gone)

    body = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    advance(engine, 60)

    assert state_of(engine, body)[:2] == pytest.approx([0.0, 0.0], abs=1e-3)
