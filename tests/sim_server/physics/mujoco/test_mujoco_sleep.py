"""Sleep of loose bodies in MuJoCo."""

import pickle
from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box, a_box_bot, a_cart, a_puck, a_state, box_bot_at, on_ground
from zensim.sim_server.physics.engine import GROUND, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.physics.sleeping_engine import SleepingEngine, wrap_with_sleep

CONFIG = EngineConfig(STEP_NS)
SECOND = 240
RESTING = SECOND
"""Steps after which boxes at rest sleep."""


class CountingMujoco(MujocoEngine):
    """Counts its steps."""

    steps = 0

    def step(self) -> bool:
        self.steps += 1
        return super().step()


@pytest.fixture
def inner() -> CountingMujoco:
    return CountingMujoco(CONFIG)


@pytest.fixture
def engine(inner: CountingMujoco) -> Iterator[SleepingEngine]:
    found = SleepingEngine(inner, CONFIG)
    yield found
    found.close()


def box_at(x: float = 0.0, y: float = 0.0, z: float = 0.1) -> FloatArray:
    return a_state((x, y, z))


def base_of(engine: SleepingEngine, body: int) -> FloatArray:
    return np.asarray(engine.read((body,)).base[0])


def test_boxes_that_stand_still_sleep_in_place(engine: SleepingEngine) -> None:
    bodies = tuple(engine.add(a_box(), box_at(i)) for i in range(3))
    advance(engine, RESTING)
    before, slept = engine.read(bodies), engine.asleep

    advance(engine, SECOND)

    assert slept == bodies
    assert engine.read(bodies).base.tolist() == before.base.tolist()
    assert not before.base[:, 7:].any()


def test_world_in_which_all_sleep_is_not_stepped(
    engine: SleepingEngine, inner: CountingMujoco
) -> None:
    engine.add(a_box(), box_at())
    engine.add(a_box("wall", is_static=True), box_at(5.0))
    advance(engine, RESTING)
    steps = inner.steps

    advance(engine, SECOND)

    assert inner.steps == steps


def test_falling_box_is_not_frozen(engine: SleepingEngine) -> None:
    box = engine.add(a_box(), a_state((0.0, 0.0, 1.0), linear=(0.0, 0.0, 2.0)))

    advance(engine, SECOND)

    assert base_of(engine, box)[2] == pytest.approx(0.1, abs=0.01)


def test_robots_do_not_sleep(engine: SleepingEngine) -> None:
    engine.add(a_box_bot(), box_bot_at())
    engine.add(a_cart(), on_ground(2.0))

    advance(engine, 3 * SECOND)

    assert engine.asleep == ()


def drive_against_a_box(engine: SleepingEngine) -> tuple[FloatArray, tuple[int, ...], bool]:
    """Drive a robot against a box and another behind it; return their states."""
    near, far = (engine.add(a_box(friction=0.2), box_at(x)) for x in (1.0, 1.25))
    robot = engine.add(a_box_bot(), box_bot_at())
    advance(engine, RESTING)
    slept = engine.asleep == (near, far)
    engine.command((robot,), np.array([15.0, 15.0]))
    advance(engine, 5 * SECOND)
    return engine.read((near, far, robot)).base, engine.asleep, slept


def test_robot_pushes_sleeping_boxes_as_it_does_awake_ones(engine: SleepingEngine) -> None:
    awake = wrap_with_sleep(MujocoEngine(CONFIG), EngineConfig(10 * SECOND * STEP_NS))
    assert isinstance(awake, SleepingEngine)
    expected, _, never_slept = drive_against_a_box(awake)
    awake.close()

    found, asleep, slept = drive_against_a_box(engine)

    assert (slept, never_slept) == (True, False)
    assert asleep == ()
    assert found[1, 0] > 1.3
    assert found[:, :3] == pytest.approx(expected[:, :3], abs=0.02)


def test_robot_touches_a_sleeping_box_that_was_not_woken(engine: SleepingEngine) -> None:
    """MuJoCo wakes what it finds in contact, should a body come faster than expected."""
    box = engine.add(a_box(friction=0.2), box_at(1.0))
    bullet = engine.add(a_puck(), a_state((-20.0, 0.0, 0.1)))
    advance(engine, RESTING)
    slept = box in engine.asleep

    engine._inner.set_base_state(bullet, a_state((-2.0, 0.0, 0.1), linear=(60.0, 0.0, 0.0)))  # noqa: SLF001
    advance(engine, SECOND // 4)

    assert slept
    assert base_of(engine, box)[0] > 1.05


def test_wrench_moves_a_sleeping_box(engine: SleepingEngine) -> None:
    box = engine.add(a_box(), box_at())
    advance(engine, RESTING)
    slept = engine.asleep

    for _ in range(24):
        engine.apply_link_wrench(box, 0, np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0]))
        engine.step()
    engine.step()

    assert slept == (box,)
    assert engine.asleep == ()
    assert base_of(engine, box)[9] == pytest.approx(30.0 * 24 / 240 - 9.81 * 24 / 240, abs=0.03)


def test_sleeping_box_takes_the_state_that_is_set(engine: SleepingEngine) -> None:
    box = engine.add(a_box(), box_at())
    advance(engine, RESTING)
    slept = engine.asleep

    engine.set_base_state(box, a_state((0.0, 0.0, 5.0), linear=(1.0, 0.0, 0.0)))
    asleep = engine.asleep
    advance(engine, SECOND // 2)

    assert (slept, asleep) == ((box,), ())
    assert base_of(engine, box)[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("is_static", [False, True])
@pytest.mark.parametrize("how", ["removed", "moved"])
def test_sleeping_box_falls_when_its_support_goes(
    engine: SleepingEngine, how: str, *, is_static: bool
) -> None:
    below = engine.add(a_box("below", is_static=is_static), box_at())
    above = engine.add(a_box(), box_at(z=0.3))
    elsewhere = engine.add(a_box(), box_at(50.0))
    advance(engine, 2 * RESTING)
    slept = engine.asleep

    if how == "removed":
        engine.remove(below)
    else:
        engine.set_base_state(below, box_at(3.0))
    asleep = engine.asleep
    advance(engine, 2 * SECOND)

    assert {above, elsewhere} <= set(slept)
    assert asleep == (elsewhere,)
    assert base_of(engine, above)[2] == pytest.approx(0.1, abs=0.01)


def test_tower_sleeps_and_wakes_as_a_whole(engine: SleepingEngine) -> None:
    tower = tuple(engine.add(a_box(), box_at(z=0.1 + 0.2 * i)) for i in range(4))
    advance(engine, 3 * RESTING)
    slept = engine.asleep

    engine.apply_link_wrench(tower[2], 0, np.zeros(6))

    assert slept == tower
    assert engine.asleep == ()
    engine.step()
    assert len(engine.read_contacts(tower[:1]))  # MuJoCo makes none of what sleeps there
    advance(engine, RESTING)
    heights = engine.read(tower).base[:, 2]
    assert heights == pytest.approx([0.1, 0.3, 0.5, 0.7], abs=0.01)


def test_box_dropped_on_a_sleeping_one_lands_on_it(engine: SleepingEngine) -> None:
    below = engine.add(a_box(), box_at())
    advance(engine, RESTING)
    slept = engine.asleep

    above = engine.add(a_box(), box_at(z=1.0))
    while base_of(engine, above)[2] > 0.35:
        engine.step()
    before_impact = engine.asleep
    advance(engine, 3 * SECOND)

    assert (slept, before_impact) == ((below,), ())
    assert base_of(engine, above)[2] == pytest.approx(0.3, abs=0.01)
    assert set(engine.asleep) == {below, above}


def test_static_body_that_comes_while_others_sleep_is_where_it_was_put(
    engine: SleepingEngine,
) -> None:
    """MuJoCo does not compute the places of static bodies while others sleep."""
    sleeper, robot = engine.add(a_box(), box_at(y=20.0)), engine.add(a_box_bot(), box_bot_at())
    static = a_box("wall", is_static=True)
    walls = [engine.add(static, box_at(-30.0))]
    advance(engine, RESTING)

    walls.append(engine.add(static, box_at(0.5)))
    overlaps = engine.find_overlaps(walls[1])
    moved = engine.add(static, box_at(0.05))
    found = engine.find_overlaps(moved)
    engine.remove(moved)
    engine.command((robot,), np.array([15.0, 15.0]))
    advance(engine, 3 * SECOND)

    assert engine.asleep == (sleeper,)
    assert (overlaps, found) == ([], [robot])
    assert base_of(engine, robot)[0] < 0.45


def test_sleeping_box_keeps_its_contacts(engine: SleepingEngine) -> None:
    box, other = engine.add(a_box(), box_at()), engine.add(a_box(), box_at(9.0))
    advance(engine, RESTING)

    at_once = engine.read_contacts((box,))
    advance(engine, SECOND)
    later = engine.read_contacts((box,))

    assert set(engine.asleep) == {box, other}
    assert {(own, touched) for own, _, touched, _ in later.bodies.tolist()} == {(box, GROUND)}
    assert later.points[:, 7:].sum(axis=0)[2] == pytest.approx(9.81, rel=0.02)
    assert len(at_once) == len(later)


def test_contacts_of_the_step_in_which_a_box_falls_asleep_are_read_once(
    engine: SleepingEngine,
) -> None:
    box = engine.add(a_box(), box_at())
    while not engine.asleep:
        engine.step()

    assert len(engine.read_contacts((box,))) == 4


def test_body_that_is_woken_falls_and_others_sleep_on() -> None:
    engine = MujocoEngine(CONFIG)
    woken, other = (
        engine.add(a_box(name), box_at(x, z=1.0)) for name, x in (("a", 0.0), ("b", 5.0))
    )
    engine.sleep([woken, other])
    advance(engine, SECOND // 10)
    asleep = engine.read((woken, other)).base[:, 2]

    engine.wake([woken])
    advance(engine, SECOND // 10)

    heights = engine.read((woken, other)).base[:, 2]
    engine.close()
    assert asleep.tolist() == [1.0, 1.0]
    assert heights[0] == pytest.approx(1.0 - 9.81 * 0.1**2 / 2.0, abs=0.005)
    assert heights[1] == 1.0


def test_bodies_sleep_on_in_a_model_with_more_slots(engine: SleepingEngine) -> None:
    box = engine.add(a_box(), box_at())
    advance(engine, RESTING)
    before = base_of(engine, box)

    robot = engine.add(a_cart(), on_ground(30.0))
    engine.hide(robot)
    advance(engine, SECOND // 2)
    engine.show([robot])
    advance(engine, SECOND)

    assert engine.asleep == (box,)
    assert base_of(engine, box).tolist() == before.tolist()
    assert base_of(engine, robot)[2] == pytest.approx(on_ground()[2], abs=0.01)


def run_of_a_robot(*, has_sleepers: bool) -> list[list[float]]:
    """Drive a robot far from boxes that sleep, fall asleep and wake, or that are not there."""
    engine = SleepingEngine(MujocoEngine(CONFIG), CONFIG)
    robot = engine.add(a_box_bot(), box_bot_at())
    boxes = [engine.add(a_box(), box_at(50.0 + i, z=0.1 + 0.05 * i)) for i in range(3)]
    if not has_sleepers:
        for box in boxes:
            engine.set_base_state(box, a_state((50.0, 1e3 * box, 1e5)))  # falls in the whole run
    engine.command((robot,), np.array([9.0, 4.0]))
    found = []
    for turn in range(12):
        advance(engine, SECOND // 4)
        found.append(base_of(engine, robot).tolist())
        if turn == 8 and has_sleepers:
            assert set(engine.asleep) == set(boxes)
            engine.apply_link_wrench(boxes[0], 0, np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    engine.close()
    return found


def test_robot_has_the_same_bits_beside_sleeping_bodies() -> None:
    assert run_of_a_robot(has_sleepers=True) == run_of_a_robot(has_sleepers=False)


def test_restored_engine_continues_with_equal_bits(engine: SleepingEngine) -> None:
    boxes = [engine.add(a_box(friction=0.3), box_at(1.0 + 0.3 * i)) for i in range(3)]
    bodies = (*boxes, engine.add(a_box_bot(), box_bot_at()))
    advance(engine, RESTING)
    slept = set(engine.asleep)
    engine.command(bodies[-1:], np.array([12.0, 12.0]))
    advance(engine, SECOND // 3)
    twin = pickle.loads(pickle.dumps(engine))

    runs = []
    for one in (engine, twin):
        advance(one, 4 * SECOND)
        runs.append(one.read(bodies).base.tolist())

    assert slept == set(boxes)
    assert runs[0] == runs[1]


def test_runs_with_sleep_repeat_exactly() -> None:
    def run() -> list[list[float]]:
        engine = SleepingEngine(MujocoEngine(CONFIG), CONFIG)
        found, _, _ = drive_against_a_box(engine)
        engine.close()
        return [row.tolist() for row in found]

    assert run() == run()
