"""Sleep of bodies at rest."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pybullet
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box, a_box_bot, a_state, an_arm, box_bot_at
from tests.sim_server.physics.bullet_probe import client_of, unique_id_of
from zensim.proto.messages.model_messages import Decay, Link, Model, Shape
from zensim.proto.stl import write_corners
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.sleeping_engine import (
    BRAKED_BODY_THRESHOLDS,
    FREE_BODY_THRESHOLDS,
    SleepingEngine,
    SleepState,
    SleepTracker,
    choose_sleep_thresholds,
    find_initial_sleep_state,
    find_reachable,
)

STEPS = 10
ONE = np.array([3], dtype=np.intp)


def a_reading(base: FloatArray, *positions: float) -> BodyStates:
    return BodyStates(base[None], np.array(positions), np.zeros(len(positions)))


def tracker_with(model: Model) -> SleepTracker:
    tracker = SleepTracker(STEPS)
    tracker.add(int(ONE[0]), model, 0.2, 0)
    return tracker


def is_resting_after(tracker: SleepTracker, states: list[FloatArray]) -> bool:
    """Update with a state at each step; return whether the body is at rest after the last."""
    joints = [0.0] * int(tracker.joint_count[ONE[0]])
    found = [
        tracker.update(ONE, a_reading(state, *joints), step) for step, state in enumerate(states)
    ]
    return bool(found[-1])


def test_body_is_at_rest_after_the_delay() -> None:
    tracker = tracker_with(an_arm("revolute"))
    states = [a_state((1.0, 2.0, 3.0), turn=(0.1, 0.2, 0.3))] * (STEPS + 1)

    assert not is_resting_after(tracker, states[:-1])
    assert is_resting_after(tracker_with(an_arm("revolute")), states)


def test_robot_on_braked_wheels_that_does_not_move_at_all_is_at_rest_at_once() -> None:
    settling = [a_state((0.0, 0.0, 3e-5)), a_state(), a_state()]

    assert not is_resting_after(tracker_with(a_box_bot()), settling[:2])
    assert is_resting_after(tracker_with(a_box_bot()), settling)


@pytest.mark.parametrize(
    ("position", "speed"), [(2e-5, 0.0), (0.0, 2e-4)], ids=["turned", "turning"]
)
def test_robot_whose_wheel_moves_waits_for_the_delay(position: float, speed: float) -> None:
    tracker, base = tracker_with(a_box_bot()), a_state()[None]
    tracker.update(ONE, BodyStates(base, np.zeros(2), np.zeros(2)), 0)

    found = tracker.update(
        ONE, BodyStates(base, np.array([0.0, position]), np.array([speed, 0.0])), 1
    )

    assert not found.any()


def test_placed_robot_sleeps_sooner_than_after_the_delay(engine: SleepingEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())

    advance(engine, SECONDS // 2)

    assert engine.asleep == (body,)


def test_loose_body_that_does_not_move_at_all_is_at_rest_at_once() -> None:
    states = [a_state((1.0, 2.0, 3.0))] * 2

    assert is_resting_after(tracker_with(a_box()), states)
    assert not is_resting_after(tracker_with(an_arm("revolute")), states)


def test_placement_is_the_first_check_of_a_loose_body() -> None:
    box, arm = (SleepTracker(STEPS) for _ in range(2))
    box.add(int(ONE[0]), a_box(), 0.2, 0, a_state((1.0, 2.0, 3.0)))
    arm.add(int(ONE[0]), an_arm("revolute"), 0.2, 0, a_state((1.0, 2.0, 3.0)))
    states = [a_state((1.0, 2.0, 3.0))]

    assert is_resting_after(box, states)
    assert not is_resting_after(arm, states)


@pytest.mark.parametrize(
    "second",
    [a_state((4e-5, 0.0, 0.0)), a_state(turn=(0.0, 0.0, 2e-5)), a_state(linear=(0.0, 0.0, 2e-4))],
    ids=["creeps", "turns", "is at its apex"],
)
def test_loose_body_that_moves_a_little_waits_for_the_delay(second: FloatArray) -> None:
    assert not is_resting_after(tracker_with(a_box()), [a_state(), second])


@pytest.mark.parametrize("each_m", [1e-4, 1e-3])
def test_drifting_body_is_never_at_rest(each_m: float) -> None:
    states = [a_state((each_m * step, 0.0, 0.0)) for step in range(200)]

    assert not any(is_resting_after(tracker_with(a_box()), states[:n]) for n in range(1, 200, 7))


def test_slowly_rotating_body_is_never_at_rest() -> None:
    states = [a_state(turn=(0.0, 0.0, 5e-4 * step)) for step in range(50)]

    assert not is_resting_after(tracker_with(a_box()), states)


def test_body_with_a_moving_joint_is_not_at_rest() -> None:
    tracker = tracker_with(an_arm("revolute"))
    still = a_state()

    found = [tracker.update(ONE, a_reading(still, 0.01 * step), step) for step in range(30)]

    assert not any(is_resting.any() for is_resting in found)


def test_robot_with_braked_wheels_has_larger_thresholds_than_a_box() -> None:
    assert choose_sleep_thresholds(a_box_bot()) == BRAKED_BODY_THRESHOLDS
    assert choose_sleep_thresholds(a_box()) == FREE_BODY_THRESHOLDS


def test_moved_body_restarts_the_delay() -> None:
    tracker, states = tracker_with(a_box()), [a_state()] * (STEPS + 1)
    is_resting_after(tracker, states)

    tracker.mark_moved(int(ONE[0]), STEPS)

    assert not tracker.update(ONE, a_reading(a_state()), STEPS + 1).any()


def test_sleeping_body_keeps_its_pose_and_has_no_velocity() -> None:
    tracker = tracker_with(a_box_bot())

    tracker.store_asleep(
        ONE, a_reading(a_state((1.0, 0.0, 0.0), linear=(1e-4, 0.0, 0.0)), 0.5, -0.5)
    )

    assert tracker.state[3] == SleepState.ASLEEP
    assert tracker.base[3].tolist() == a_state((1.0, 0.0, 0.0)).tolist()
    assert tracker.joints_of(ONE).tolist() == [0.5, -0.5]


def test_tracker_grows_with_bodies_and_joints() -> None:
    tracker = tracker_with(a_box())

    tracker.add(500, a_box_bot(), 0.1, 7)

    assert (tracker.state[3], tracker.state[500], tracker.state[499]) == (
        SleepState.AWAKE,
        SleepState.AWAKE,
        SleepState.UNKNOWN,
    )


def test_body_with_velocity_damping_never_sleeps() -> None:
    box = a_box()
    dragged = msgspec.structs.replace(box.links[0], decay=Decay(0.1, 0.1))

    assert find_initial_sleep_state(box) == SleepState.AWAKE
    assert find_initial_sleep_state(a_box(is_static=True)) == SleepState.FIXED
    assert (
        find_initial_sleep_state(msgspec.structs.replace(box, links=(dragged,)))
        == SleepState.NEVER_SLEEPS
    )


def test_reach_grows_with_speed() -> None:
    others = np.array([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0], [9.0, 0.0, 0.0]])
    slow, fast = a_state(), a_state(linear=(4.0, 0.0, 0.0))
    radius, radii = np.array([0.4]), np.full(3, 0.4)

    near = find_reachable(slow[None], radius, others, radii, 0.2)
    far = find_reachable(fast[None], radius, others, radii, 0.2)

    assert near.tolist() == [True, False, False]
    assert far.tolist() == [True, True, False]
    assert not find_reachable(np.zeros((0, 13)), np.zeros(0), others, radii, 0.2).any()


CONFIG = EngineConfig(STEP_NS)
SECONDS = 240
STANDING = 2 * SECONDS
"""Steps after which standing bodies sleep."""
SIZE_M = 0.2


class CountingEngine(PyBulletEngine):
    """Counts bodies read."""

    def __init__(self, config: EngineConfig = CONFIG) -> None:
        super().__init__(config)
        self.readings = 0

    def read(self, bodies: Sequence[int]) -> BodyStates:
        self.readings += len(bodies)
        return super().read(bodies)


@pytest.fixture
def inner() -> CountingEngine:
    return CountingEngine()


@pytest.fixture
def engine(inner: CountingEngine) -> Iterator[SleepingEngine]:
    found = SleepingEngine(inner, CONFIG)
    yield found
    found.close()


def box_at(x: float = 0.0, z: float = SIZE_M / 2.0) -> FloatArray:
    return a_state((x, 0.0, z))


def base_of(engine: SleepingEngine, body: int) -> FloatArray:
    return np.asarray(engine.read((body,)).base[0])


def stopped_box_bot(engine: SleepingEngine) -> int:
    """Add a robot, drive and stop it."""
    body = engine.add(a_box_bot(), box_bot_at())
    engine.command((body,), np.array([10.0, 10.0]))
    advance(engine, SECONDS)
    engine.command((body,), np.zeros(2))
    return body


def test_stopped_robot_sleeps_in_place(engine: SleepingEngine) -> None:
    body = stopped_box_bot(engine)
    advance(engine, SECONDS // 2)
    stopped = base_of(engine, body)

    advance(engine, STANDING)
    asleep = base_of(engine, body)
    advance(engine, STANDING)

    assert engine.asleep == (body,)
    assert asleep[:3] == pytest.approx(stopped[:3], abs=2e-3)
    assert base_of(engine, body).tolist() == asleep.tolist()
    assert not asleep[7:].any()


def test_sleeping_bodies_are_not_read(engine: SleepingEngine, inner: CountingEngine) -> None:
    bodies = tuple(engine.add(a_box_bot(), box_bot_at(float(i))) for i in range(5))
    advance(engine, STANDING)
    inner.readings = 0

    for _ in range(SECONDS):
        engine.step()
        engine.read(bodies)

    assert engine.asleep == bodies
    assert inner.readings == 0


def test_reading_keeps_the_requested_order_of_sleeping_and_awake_bodies(
    engine: SleepingEngine,
) -> None:
    robot, box = engine.add(a_box_bot(), box_bot_at(-3.0)), engine.add(a_box(), box_at(5.0))
    other = engine.add(a_box_bot(), box_bot_at(3.0))
    advance(engine, STANDING)
    engine.command((other,), np.array([5.0, 5.0]))
    advance(engine, SECONDS)

    reading = engine.read((other, box, robot))

    assert engine.asleep == (robot, box)
    assert reading.base[:, 0] == pytest.approx([3.0, 5.0, -3.0], abs=0.3)
    assert reading.joint_velocities == pytest.approx([5.0, 5.0, 0.0, 0.0], abs=0.05)
    assert reading.joint_positions[:2] == pytest.approx([5.0, 5.0], abs=0.2)


def test_sleeping_robot_wakes_on_a_command_and_drives(engine: SleepingEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    advance(engine, STANDING)
    slept = engine.asleep

    engine.command((body,), np.array([10.0, 10.0]))
    advance(engine, SECONDS)

    assert slept == (body,)
    assert engine.asleep == ()
    assert base_of(engine, body)[0] == pytest.approx(0.35, abs=0.03)


def test_repeated_command_wakes_no_body(engine: SleepingEngine) -> None:
    body = stopped_box_bot(engine)

    for _ in range(STANDING * 2):
        engine.command((body,), np.zeros(2))
        engine.step()

    assert engine.asleep == (body,)


def test_driven_robot_never_sleeps(engine: SleepingEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    engine.command((body,), np.array([0.02, 0.02]))
    start = base_of(engine, body)[0]

    advance(engine, 4 * SECONDS)

    assert engine.asleep == ()
    assert base_of(engine, body)[0] - start == pytest.approx(4 * 0.02 * 0.035, abs=2e-3)


def test_wrench_moves_a_sleeping_body_as_an_awake_one(engine: SleepingEngine) -> None:
    body = engine.add(a_box(), box_at())
    advance(engine, STANDING)
    slept = engine.asleep
    wrench = np.array([0.0, 0.0, 200.0, 0.0, 0.0, 0.0])

    for _ in range(24):
        engine.apply_link_wrench(body, 0, wrench)
        engine.step()
    engine.step()
    pushed = base_of(engine, body)[9]

    awake = PyBulletEngine(CONFIG)
    twin = awake.add(a_box(), box_at())
    advance(awake, STANDING)
    for _ in range(24):
        awake.apply_link_wrench(twin, 0, wrench)
        awake.step()
    expected = awake.read([twin]).base[0, 9]
    awake.close()
    assert slept == (body,)
    assert pushed == pytest.approx(expected, abs=0.06)


def test_sleeping_body_wakes_before_a_robot_hits_it(engine: SleepingEngine) -> None:
    sleeper = engine.add(a_box(friction=0.2), box_at(1.0))
    robot = engine.add(a_box_bot(), box_bot_at())
    advance(engine, STANDING)
    slept = engine.asleep

    engine.command((robot,), np.array([15.0, 15.0]))
    advance(engine, 4 * SECONDS)

    assert sleeper in slept
    assert base_of(engine, sleeper)[0] > 1.05
    assert base_of(engine, robot)[0] < base_of(engine, sleeper)[0]


def test_sleeping_body_far_from_a_driving_robot_stays_asleep(engine: SleepingEngine) -> None:
    far, robot = engine.add(a_box(), box_at(20.0)), engine.add(a_box_bot(), box_bot_at())
    advance(engine, STANDING)

    engine.command((robot,), np.array([5.0, 5.0]))
    advance(engine, SECONDS)

    assert engine.asleep == (far,)


def test_body_falls_when_the_one_below_is_removed(engine: SleepingEngine) -> None:
    below, above = engine.add(a_box(), box_at()), engine.add(a_box(), box_at(z=0.3))
    advance(engine, STANDING)
    slept = engine.asleep

    engine.remove(below)
    advance(engine, SECONDS)

    assert slept == (below, above)
    assert base_of(engine, above)[2] == pytest.approx(0.1, abs=0.01)


def test_body_falls_when_the_one_below_is_moved(engine: SleepingEngine) -> None:
    below, above = engine.add(a_box(), box_at()), engine.add(a_box(), box_at(z=0.3))
    advance(engine, STANDING)
    slept = engine.asleep

    engine.set_base_state(below, box_at(3.0))
    advance(engine, SECONDS)

    assert slept == (below, above)
    assert base_of(engine, above)[2] == pytest.approx(0.1, abs=0.01)


def test_tower_sleeps_as_a_whole_and_wakes_as_a_whole(engine: SleepingEngine) -> None:
    tower = tuple(engine.add(a_box(), box_at(z=0.1 + 0.2 * i)) for i in range(5))
    advance(engine, 2 * STANDING)
    slept = engine.asleep

    engine.apply_link_wrench(tower[2], 0, np.zeros(6))

    assert slept == tower
    assert engine.asleep == ()
    advance(engine, STANDING)
    heights = engine.read(tower).base[:, 2]
    assert heights == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9], abs=0.01)


def test_box_dropped_on_a_sleeping_body_lands_on_it(engine: SleepingEngine) -> None:
    below = engine.add(a_box(), box_at())
    advance(engine, STANDING)
    slept = engine.asleep

    above = engine.add(a_box(), box_at(z=1.5))
    advance(engine, 3 * SECONDS)

    assert slept == (below,)
    assert base_of(engine, above)[2] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("steps_before", [0, 23])
def test_body_that_hardly_falls_is_not_frozen(steps_before: int) -> None:
    faint = EngineConfig(STEP_NS, gravity=(0.0, 0.0, -0.01), has_ground=False)
    engine = SleepingEngine(PyBulletEngine(faint), faint)
    advance(engine, steps_before)
    body = engine.add(a_box(), a_state())

    advance(engine, SECONDS)

    assert base_of(engine, body)[2] == pytest.approx(-0.005, rel=0.02)
    engine.close()


@pytest.mark.parametrize("speed_mps", [0.001, 0.002, 0.01])
def test_slowly_sliding_body_never_sleeps(speed_mps: float) -> None:
    floating = EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False)
    engine = SleepingEngine(PyBulletEngine(floating), floating)
    state = a_state((0.0, 0.0, 0.0), linear=(speed_mps, 0.0, 0.0))
    body = engine.add(a_box(), state)

    advance(engine, 5 * SECONDS)

    assert engine.asleep == ()
    assert base_of(engine, body)[0] == pytest.approx(5 * speed_mps, rel=0.01)
    engine.close()


def test_sleeping_body_keeps_a_velocity_that_is_set(engine: SleepingEngine) -> None:
    body = engine.add(a_box(), box_at())
    advance(engine, STANDING)

    engine.set_base_state(body, a_state((0.0, 0.0, 5.0), linear=(1.0, 0.0, 0.0)))
    advance(engine, SECONDS // 2)

    assert base_of(engine, body)[0] == pytest.approx(0.5, abs=0.02)


def test_sleeping_body_does_not_move_in_bullet(
    engine: SleepingEngine, inner: CountingEngine
) -> None:
    body = stopped_box_bot(engine)
    advance(engine, STANDING)
    own, client = unique_id_of(inner, body), client_of(inner)
    before = pybullet.getBasePositionAndOrientation(own, physicsClientId=client)
    advance(engine, SECONDS)
    after = pybullet.getBasePositionAndOrientation(own, physicsClientId=client)

    assert before == after


def test_runs_with_sleep_repeat_exactly() -> None:
    def run() -> list[list[float]]:
        engine = SleepingEngine(PyBulletEngine(CONFIG), CONFIG)
        bodies = tuple(engine.add(a_box_bot(), box_bot_at(0.3 * i)) for i in range(4))
        engine.command(bodies[:1], np.array([8.0, 8.0]))
        found = []
        for _ in range(40):
            advance(engine, 24)
            found.append(engine.read(bodies).base.ravel().tolist())
        engine.close()
        return found

    assert run() == run()


def test_add_of_a_prepared_model_reads_no_mesh(tmp_path: Path) -> None:
    file, corners = tmp_path / "a.stl", np.array([[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0] * 3]])
    file.write_bytes(write_corners(corners))
    model = Model(
        "m", (Link("l", collisions=(Shape("mesh", (1.0, 1.0, 1.0), mesh="a"),)),), is_static=True
    )
    config = EngineConfig(STEP_NS, mesh_folder=str(tmp_path))
    sleeping = SleepingEngine(PyBulletEngine(config), config)

    answers = [sleeping.prepare(model) for _ in range(3)]
    file.unlink()
    body = sleeping.add(model, a_state())

    assert answers == [False, False, True]
    assert sleeping.read([body]).base[0, 2] == 0.0
    sleeping.close()
