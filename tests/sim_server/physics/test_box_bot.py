"""Motion of box_bot in each engine."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, running
from tests.models import a_box_bot, box_bot_at
from tests.sim_server.fakes import a_command, a_spawn
from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.world.simulated_world import SimulatedWorld

CONTROL_STEPS = 3
STEPS_OF_10_S = 2400
WHEEL_RADIUS_M = 0.035
TRACK_M = 0.11
SIDE_M = 0.1


@dataclass
class Course:
    """Displacement and accumulated rotation of each robot."""

    moved: FloatArray
    turned: FloatArray


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_world_of(engine: Engine, *places: FloatArray) -> SimulatedWorld:
    """Make a world of box_bots, each with an agent."""
    world = SimulatedWorld(engine, name="default", step_ns=STEP_NS, control_steps=CONTROL_STEPS)
    model = a_box_bot()
    for i, place in enumerate(places):
        world.spawn(a_spawn(f"r{i}", model=model, base=place))
        world.claim(f"a{i}", (f"r{i}",), "stop")
    return world


def a_row_of(engine: Engine, count: int) -> SimulatedWorld:
    return a_world_of(engine, *(box_bot_at(float(i)) for i in range(count)))


def wheel_targets(linear: float, angular: float) -> tuple[float, float]:
    half_turn = angular * TRACK_M / 2.0
    return (linear - half_turn) / WHEEL_RADIUS_M, (linear + half_turn) / WHEEL_RADIUS_M


def drive(
    world: SimulatedWorld, linear: float, angular: float, steps: int = STEPS_OF_10_S
) -> Course:
    """Drive all robots of a world with one twist."""
    targets = wheel_targets(linear, angular)
    start = world.states().base.copy()
    heading, turned = to_yaw(start[:, 3:7]), np.zeros(len(start))
    for step in range(steps):
        if step % CONTROL_STEPS == 0:
            for agent in world.claims.agents:
                world.command(agent, a_command(world, agent, *targets))
        world.step()
        now = to_yaw(world.states().base[:, 3:7])
        turned += (now - heading + math.pi) % (2.0 * math.pi) - math.pi
        heading = now
    return Course(world.states().base[:, :3] - start[:, :3], turned)


@pytest.mark.parametrize("count", [1, 10])
def test_box_bots_go_two_metres_when_driven_at_0_2_for_ten_seconds(
    engine: Engine, count: int
) -> None:
    course = drive(a_row_of(engine, count), linear=0.2, angular=0.0)

    assert course.moved[:, 0] == pytest.approx(np.full(count, 2.0), rel=0.01)
    assert np.abs(course.moved[:, 1]).max() <= 0.01
    assert np.abs(course.turned).max() <= 0.01


@pytest.mark.parametrize("count", [1, 10])
def test_box_bots_turn_ten_radians_when_turned_at_one_for_ten_seconds(
    engine: Engine, count: int
) -> None:
    course = drive(a_row_of(engine, count), linear=0.0, angular=1.0)

    assert course.turned == pytest.approx(np.full(count, 10.0), rel=0.02)
    assert np.hypot(course.moved[:, 0], course.moved[:, 1]).max() <= 0.01


def test_box_bot_returns_after_a_full_circle(engine: Engine) -> None:
    world = a_row_of(engine, 1)

    course = drive(world, linear=0.2, angular=0.2 * math.pi)

    assert course.turned == pytest.approx([2.0 * math.pi], rel=0.02)
    assert np.hypot(*course.moved[0, :2]) <= 0.05


def test_box_bot_drives_backwards(engine: Engine) -> None:
    course = drive(a_row_of(engine, 1), linear=-0.2, angular=0.0)

    assert course.moved[0, :2] == pytest.approx([-2.0, 0.0], abs=0.02)


def test_box_bot_stays_on_its_wheels_when_it_starts_and_stops(engine: Engine) -> None:
    world = a_row_of(engine, 1)

    for linear in (0.5, 0.0, -0.5, 0.0):
        drive(world, linear, 0.0, steps=240)

    row = world.states().base[0]
    assert row[2] == pytest.approx(0.06, abs=1e-3)
    assert abs(row[7:]).max() < 0.02


def test_box_bots_stop_each_other_when_driven_head_on(engine: Engine) -> None:
    world = a_world_of(engine, box_bot_at(0.0), box_bot_at(1.0, 0.0, math.pi))
    closest = math.inf

    for _ in range(100):
        drive(world, linear=0.2, angular=0.0, steps=24)
        x = world.states().base[:, 0]
        closest = min(closest, float(x[1] - x[0]))

    speeds = np.abs(world.states().base[:, 7:9])
    assert closest >= SIDE_M - 0.002
    assert x[1] - x[0] <= SIDE_M + 0.002
    assert speeds.max() < 0.02


def test_box_bot_pushes_an_unclaimed_one(engine: Engine) -> None:
    world = a_world_of(engine, box_bot_at(0.0), box_bot_at(0.5))
    world.release("a1")

    drive(world, linear=0.2, angular=0.0, steps=1200)

    x = world.states().base[:, 0]
    assert x[1] - x[0] >= SIDE_M - 0.002
