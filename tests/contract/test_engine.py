"""Contract of every engine."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.engines import ENGINES, STEP_NS, MakeEngine, advance, running
from tests.models import (
    a_box,
    a_box_bot,
    a_cart,
    a_lopsided_box,
    a_state,
    an_arm,
    angle_between,
    assert_same_state,
    box_bot_at,
    on_ground,
)
from zensim.proto.messages.model_messages import JointKind, Model
from zensim.sim_server.physics.engine import Engine, EngineRefused, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig

FLOATING = EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False)
every_engine = pytest.mark.parametrize("make", ENGINES, ids=lambda make: make.name)
metres = st.floats(-100.0, 100.0)
angles = st.floats(-3.0, 3.0)
speeds = st.floats(-20.0, 20.0)
states = st.builds(
    a_state,
    st.tuples(metres, metres, metres),
    turn=st.tuples(angles, angles, angles),
    linear=st.tuples(speeds, speeds, speeds),
    angular=st.tuples(speeds, speeds, speeds),
)


@pytest.fixture(params=ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def state_of(engine: Engine, body: int) -> FloatArray:
    return np.asarray(engine.read([body]).base[0])


def test_engine_body_keeps_pose_when_not_commanded(engine: Engine) -> None:
    start = a_state((1.0, -2.0, 0.1), turn=(0.0, 0.0, 0.7))
    body = engine.add(a_box(), start)

    advance(engine, 240)

    assert state_of(engine, body)[:3] == pytest.approx(start[:3], abs=1e-3)
    assert angle_between(state_of(engine, body)[3:7], start[3:7]) < 1e-3


def test_engine_takes_announced_models_in_any_order(engine: Engine) -> None:
    engine.expect([a_box(), a_cart(), a_box_bot()])

    bodies = [engine.add(a_box_bot(), box_bot_at(2.0)), engine.add(a_box(), on_ground(0.0, 3.0))]
    engine.expect(())
    bodies.append(engine.add(a_cart(), on_ground()))

    assert state_of(engine, bodies[0])[0] == 2.0
    assert engine.step()
    assert np.isfinite(engine.read(bodies).base).all()


def test_engine_robot_keeps_pose_when_not_commanded(engine: Engine) -> None:
    start = on_ground(1.0, -2.0, 0.7)
    body = engine.add(a_cart(), start)

    advance(engine, 480)

    assert state_of(engine, body)[:3] == pytest.approx(start[:3], abs=1e-3)
    assert angle_between(state_of(engine, body)[3:7], start[3:7]) < 2e-3


def test_engine_static_body_stays_in_the_air(engine: Engine) -> None:
    start = a_state((0.0, 0.0, 3.0), turn=(0.1, 0.2, 0.3))
    body = engine.add(a_box(is_static=True), start)

    advance(engine, 50)

    assert_same_state(state_of(engine, body), start)


@every_engine
@given(state=states)
def test_engine_reports_the_root_link_where_it_was_added(
    make: MakeEngine, state: FloatArray
) -> None:
    with running(make, FLOATING) as engine:
        body = engine.add(a_lopsided_box(), state)

        assert_same_state(state_of(engine, body), state)


@every_engine
@given(states=st.lists(states, min_size=1, max_size=4))
def test_engine_reports_the_root_link_where_it_was_set(
    make: MakeEngine, states: list[FloatArray]
) -> None:
    with running(make, FLOATING) as engine:
        body = engine.add(a_lopsided_box(), a_state())

        for state in states:
            engine.set_base_state(body, state)

            assert_same_state(state_of(engine, body), state)


def test_engine_does_not_change_its_argument(engine: Engine) -> None:
    given_row, kept = a_state((0.0, 0.0, 5.0)), a_state((0.0, 0.0, 5.0))
    body = engine.add(a_lopsided_box(), given_row)

    engine.set_base_state(body, given_row)
    engine.set_at_rest(body, given_row)
    advance(engine, 5)

    assert np.array_equal(given_row, kept)


def test_engine_reading_does_not_change_after_a_step(engine: Engine) -> None:
    body = engine.add(a_box(), a_state((0.0, 0.0, 5.0), linear=(1.0, 0.0, 0.0)))
    reading = engine.read([body])
    kept = reading.base.copy()

    advance(engine, 10)

    assert np.array_equal(reading.base, kept)


def test_engine_moves_a_body_by_its_velocity(engine: Engine) -> None:
    body = engine.add(a_box(), a_state((0.0, 0.0, 50.0), linear=(3.0, -2.0, 0.0)))

    advance(engine, 240)

    assert state_of(engine, body)[:2] == pytest.approx([3.0, -2.0], abs=1e-4)


def test_engine_step_returns_true(engine: Engine) -> None:
    engine.add(a_cart(), on_ground())

    assert engine.step()


def test_engine_reads_joints_in_the_order_of_the_model(engine: Engine) -> None:
    model = a_cart()
    body = engine.add(model, on_ground())
    left, right = 2.0, 6.0

    engine.command([body], np.array([left, right]))
    advance(engine, 240)

    by_name = dict(
        zip(
            [joint.name for joint in model.joints],
            engine.read([body]).joint_velocities,
            strict=True,
        )
    )
    assert by_name == pytest.approx({"right_joint": right, "left_joint": left}, rel=0.05)


def test_engine_reads_bodies_in_the_requested_order(engine: Engine) -> None:
    first = engine.add(a_box(), a_state((1.0, 0.0, 0.1)))
    cart = engine.add(a_cart(), on_ground(2.0))
    last = engine.add(a_box(), a_state((3.0, 0.0, 0.1)))

    reading = engine.read([last, cart, first])

    assert reading.base[:, 0] == pytest.approx([3.0, 2.0, 1.0], abs=1e-9)
    assert reading.joint_positions.shape == reading.joint_velocities.shape == (2,)


def test_engine_reads_empty_arrays_for_no_bodies(engine: Engine) -> None:
    reading = engine.read([])

    assert reading.base.shape == (0, 13)
    assert reading.joint_positions.shape == reading.joint_velocities.shape == (0,)


def test_engine_gives_each_body_its_own_targets(engine: Engine) -> None:
    slow = engine.add(a_cart(), on_ground(0.0, 0.0))
    box = engine.add(a_box(), a_state((0.0, 5.0, 0.1)))
    fast = engine.add(a_cart(), on_ground(0.0, 10.0))

    engine.command([fast, box, slow], np.array([8.0, 8.0, 2.0, 2.0]))
    advance(engine, 240)

    x = engine.read([slow, box, fast]).base[:, 0]
    assert x == pytest.approx([2.0 * 0.05, 0.0, 8.0 * 0.05], abs=0.02)


def test_engine_holds_targets_until_they_are_set_again(engine: Engine) -> None:
    body = engine.add(a_cart(), on_ground())
    engine.command([body], np.array([4.0, 4.0]))
    advance(engine, 480)
    rolling = state_of(engine, body)

    engine.command([body], np.zeros(2))
    advance(engine, 480)

    assert rolling[7] == pytest.approx(4.0 * 0.05, rel=0.02)
    assert state_of(engine, body)[7] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("left", "right"), [(4.0, 4.0), (-3.0, 3.0), (2.0, 4.0)])
def test_engine_robot_moves_as_its_wheels_roll(engine: Engine, left: float, right: float) -> None:
    body = engine.add(a_cart(), on_ground())

    engine.command([body], np.array([left, right]))
    advance(engine, 480)

    row = state_of(engine, body)
    assert np.hypot(row[7], row[8]) == pytest.approx(abs(left + right) / 2.0 * 0.05, abs=0.005)
    assert row[12] == pytest.approx((right - left) * 0.05 / 0.3, abs=0.02)


def test_engine_keeps_other_bodies_when_one_is_removed(engine: Engine) -> None:
    bodies = [engine.add(a_cart(), on_ground(float(x))) for x in range(3)]
    engine.command(bodies, np.full(6, 2.0))
    advance(engine, 60)
    kept = [bodies[0], bodies[2]]
    before = engine.read(kept)

    engine.remove(bodies[1])

    after = engine.read(kept)
    assert after.base.tobytes() == before.base.tobytes()
    assert after.joint_positions.tobytes() == before.joint_positions.tobytes()
    assert after.joint_velocities.tobytes() == before.joint_velocities.tobytes()


def test_engine_robot_keeps_rolling_when_its_twin_is_removed(engine: Engine) -> None:
    twin, body = (engine.add(a_cart(), on_ground(0.0, y)) for y in (0.0, 5.0))
    engine.remove(twin)

    engine.command([body], np.array([4.0, 4.0]))
    advance(engine, 240)

    assert state_of(engine, body)[0] == pytest.approx(4.0 * 0.05, abs=0.01)
    assert state_of(engine, body)[2] == pytest.approx(0.05, abs=1e-3)


def test_engine_adds_a_body_after_the_last_one_was_removed(engine: Engine) -> None:
    engine.remove(engine.add(a_cart(), on_ground()))

    body = engine.add(a_lopsided_box(), a_state((1.0, 2.0, 3.0)))

    assert_same_state(state_of(engine, body), a_state((1.0, 2.0, 3.0)))


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_engine_refuses_a_multi_dof_joint(engine: Engine, kind: JointKind) -> None:
    body = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))

    with pytest.raises(EngineRefused, match=kind):
        engine.add(an_arm(kind), a_state())

    assert_same_state(state_of(engine, body), a_state((0.0, 0.0, 0.1)))


def test_engine_finds_overlapping_bodies(engine: Engine) -> None:
    first, second, far = (
        engine.add(a_box(), a_state(place))
        for place in ((0.0, 0.0, 0.1), (0.05, 0.0, 0.1), (5.0, 0.0, 0.1))
    )

    assert list(engine.find_overlaps(first)) == [second]
    assert list(engine.find_overlaps(second)) == [first]
    assert list(engine.find_overlaps(far)) == []


def test_engine_body_on_the_ground_overlaps_nothing(engine: Engine) -> None:
    body = engine.add(a_cart(), on_ground())
    advance(engine, 10)

    assert list(engine.find_overlaps(body)) == []


def test_engine_ignores_removed_and_moved_bodies_in_overlaps(engine: Engine) -> None:
    body, removed, moved = (engine.add(a_box(), a_state((0.0, 0.0, 0.1))) for _ in range(3))

    engine.remove(removed)
    engine.set_base_state(moved, a_state((3.0, 0.0, 0.1)))
    engine.step()

    assert list(engine.find_overlaps(body)) == []


def drive_scene(
    make: MakeEngine, *, with_another: bool = False, is_read_often: bool = False
) -> bytes:
    """Drive two carts and a box for 500 steps; add and remove another far away."""
    with running(make) as engine:
        bodies = [
            engine.add(a_cart(), on_ground(0.0)),
            engine.add(a_cart(), on_ground(1.0)),
            engine.add(a_box(), a_state((0.5, 0.02, 0.1))),
        ]
        engine.command(bodies[:2], np.array([4.0, 4.5, -4.0, -4.0]))
        advance(engine, 100)
        another = engine.add(a_cart(), on_ground(500.0)) if with_another else None
        for _ in range(200):
            engine.step()
            if is_read_often:
                engine.read(bodies)
                engine.find_overlaps(bodies[0])
        if another is not None:
            engine.remove(another)
        advance(engine, 200)
        reading = engine.read(bodies)
    return b"".join(
        numbers.tobytes()
        for numbers in (reading.base, reading.joint_positions, reading.joint_velocities)
    )


@every_engine
def test_engine_repeats_a_run_exactly(make: MakeEngine) -> None:
    first, second = drive_scene(make), drive_scene(make)

    assert first == second


@every_engine
def test_engine_repeats_a_run_exactly_after_a_distant_body_was_removed(make: MakeEngine) -> None:
    alone, with_another = drive_scene(make), drive_scene(make, with_another=True)

    assert alone == with_another


@every_engine
def test_engine_repeats_a_run_exactly_when_read_often(make: MakeEngine) -> None:
    once, often = drive_scene(make), drive_scene(make, is_read_often=True)

    assert once == often


@pytest.mark.parametrize("model", [a_box(), a_cart(), a_lopsided_box()], ids=lambda m: m.name)
def test_engine_numbers_are_unique(engine: Engine, model: Model) -> None:
    bodies = [engine.add(model, a_state((float(x), 0.0, 1.0))) for x in range(5)]

    assert len(set(bodies)) == 5
    assert engine.read(bodies).base[:, 0] == pytest.approx(range(5), abs=1e-9)


@pytest.mark.parametrize("model", [a_box(), a_cart(), a_lopsided_box()], ids=lambda m: m.name)
def test_engine_numbers_stay_small_however_many_bodies_come_and_go(
    engine: Engine, model: Model
) -> None:
    """Layers have tables by number, which grow with the largest."""
    stays = engine.add(model, a_state((0.0, 0.0, 1.0)))
    for x in range(1, 101):
        body = engine.add(model, a_state((float(x), 0.0, 1.0)))
        assert engine.read([stays, body]).base[:, 0] == pytest.approx([0.0, x], abs=1e-9)
        engine.remove(body)

    assert body < 64
