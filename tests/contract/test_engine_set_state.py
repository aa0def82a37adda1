"""Contract of `set_base_state`, `set_at_rest` and `set_state`."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import ENGINES, advance, running
from tests.models import a_cart, assert_same_state, on_ground
from zensim.sim_server.physics.engine import Engine, FloatArray

CONTACT_HISTORY_ERROR = 2e-3
"""MuJoCo's contacts start from the slip of the last step, which is not part of a state."""


@pytest.fixture(params=ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def state_of(engine: Engine, body: int) -> FloatArray:
    return np.asarray(engine.read([body]).base[0])


def test_engine_keeps_joints_when_the_base_state_is_set(engine: Engine) -> None:
    body = engine.add(a_cart(), on_ground())
    engine.command([body], np.array([4.0, 4.0]))
    advance(engine, 120)
    before = engine.read([body])

    engine.set_base_state(body, on_ground(5.0))

    after = engine.read([body])
    assert after.joint_positions == pytest.approx(before.joint_positions, abs=1e-12)
    assert abs(after.joint_positions).min() > 0.5


def test_engine_sets_a_robot_at_rest_with_zero_joints_and_targets(engine: Engine) -> None:
    body = engine.add(a_cart(), on_ground())
    engine.command([body], np.array([6.0, 2.0]))
    advance(engine, 120)

    engine.set_at_rest(body, on_ground(5.0, 1.0, 0.3))

    reading = engine.read([body])
    assert_same_state(reading.base[0], on_ground(5.0, 1.0, 0.3))
    assert not reading.joint_positions.any()
    assert not reading.joint_velocities.any()
    advance(engine, 120)
    assert state_of(engine, body)[:3] == pytest.approx(on_ground(5.0, 1.0)[:3], abs=2e-3)


def test_engine_sets_a_robot_at_rest_with_given_joints(engine: Engine) -> None:
    body = engine.add(a_cart(), on_ground())
    engine.command([body], np.array([6.0, 2.0]))
    advance(engine, 120)

    engine.set_at_rest(body, on_ground(5.0), np.array([0.5, -2.0]))

    reading = engine.read([body])
    assert reading.joint_positions == pytest.approx([0.5, -2.0], abs=1e-12)
    assert not reading.joint_velocities.any()


def test_engine_robot_continues_equally_from_a_state_that_is_set(engine: Engine) -> None:
    driven, other = (engine.add(a_cart(), on_ground(y=y)) for y in (0.0, 50.0))
    engine.command([driven, other], np.array([4.0, 5.0, 4.0, 5.0]))
    advance(engine, 100)
    reading = engine.read([driven])
    shifted = reading.base[0].copy()
    shifted[1] += 50.0

    engine.set_state(other, shifted, reading.joint_positions, reading.joint_velocities)

    found = engine.read([other])
    assert_same_state(found.base[0], shifted)
    assert found.joint_positions == pytest.approx(reading.joint_positions, abs=1e-9)
    assert found.joint_velocities == pytest.approx(reading.joint_velocities, abs=1e-9)
    advance(engine, 100)
    rows = engine.read([driven, other]).base
    error = CONTACT_HISTORY_ERROR if "mujoco" in engine.name else 1e-6
    assert rows[1] - rows[0] == pytest.approx([0.0, 50.0, *[0.0] * 11], abs=error)


def test_engine_sets_the_state_of_a_robot_that_was_readded(engine: Engine) -> None:
    twin = engine.add(a_cart(), on_ground())
    advance(engine, 10)
    engine.remove(twin)
    advance(engine, 10)
    body = engine.add(a_cart(), on_ground())
    moving = on_ground()
    moving[7], speed = 0.5, 0.5 / 0.05

    engine.command([body], np.array([speed, speed]))
    engine.set_state(body, moving, np.array([1.0, 2.0]), np.array([speed, speed]))
    engine.step()

    reading = engine.read([body])
    assert reading.base[0, 7] == pytest.approx(0.5, rel=0.02)
    assert reading.joint_velocities == pytest.approx([speed, speed], rel=0.02)
    advance(engine, 239)
    assert state_of(engine, body)[0] == pytest.approx(0.5, abs=0.01)


def test_engine_does_not_change_a_state_that_is_set(engine: Engine) -> None:
    body = engine.add(a_cart(), on_ground())
    base, positions, velocities = on_ground(1.0), np.array([0.1, 0.2]), np.array([3.0, 3.0])
    kept = base.copy(), positions.copy(), velocities.copy()

    engine.set_state(body, base, positions, velocities)
    advance(engine, 5)

    for found, expected in zip((base, positions, velocities), kept, strict=True):
        assert np.array_equal(found, expected)
