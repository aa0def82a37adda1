"""Wrenches and efforts act for the requested span of simulation time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.engines import STEP_NS
from tests.models import a_box, a_state
from tests.sim_server.fakes import a_spawn, a_world
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.world.applied_forces import (
    MAX_APPLIED_FORCES,
    AppliedForces,
    JointEffort,
    LinkWrench,
    TimeSpan,
    make_time_span,
)
from zensim.sim_server.world.simulated_world import SimulatedWorld

FOREVER = TimeSpan(0, None)
PULL = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
DT_S = STEP_NS * 1e-9


def a_world_of_boxes(*names: str) -> SimulatedWorld:
    world = a_world()
    for i, name in enumerate(names):
        world.spawn(a_spawn(name, model=a_box(), base=a_state((5.0 * i, 0.0, 1.0))))
    world.clock.take_events()
    return world


def speed(world: SimulatedWorld, name: str = "b") -> float:
    return float(world.state_of(name)[7])


def run_steps(world: SimulatedWorld, count: int) -> None:
    for _ in range(count):
        world.step()


@given(
    now=st.integers(0, 1000),
    start=st.integers(0, 10 * STEP_NS),
    duration=st.integers(1, 10 * STEP_NS),
)
def test_shares_of_steps_add_up_to_the_duration(now: int, start: int, duration: int) -> None:
    now_ns = now * STEP_NS
    span = make_time_span(now_ns=now_ns, start_ns=now_ns + start, duration_ns=duration)

    assert span is not None
    shares = [span.find_share(now_ns + one * STEP_NS, STEP_NS) for one in range(21)]
    assert sum(shares) * STEP_NS == pytest.approx(duration)
    assert all(0.0 <= one <= 1.0 for one in shares)


def test_span_is_none_without_duration_and_endless_when_it_is_negative() -> None:
    def make_span(duration: int) -> TimeSpan | None:
        return make_time_span(now_ns=7, start_ns=0, duration_ns=duration)

    assert make_span(0) is None
    assert make_span(-1) == TimeSpan(7, None)
    assert make_span(1) == TimeSpan(7, 8)


def test_impulse_of_a_part_of_a_step_is_exact() -> None:
    world = a_world_of_boxes("b")
    world.applied_forces.add(LinkWrench("b", 0, PULL, TimeSpan(STEP_NS // 2, 3 * STEP_NS)))

    run_steps(world, 5)

    assert speed(world) == pytest.approx(2.5 * DT_S, rel=1e-6)


def test_force_acts_from_its_start_to_its_end() -> None:
    world = a_world_of_boxes("b")
    world.applied_forces.add(LinkWrench("b", 0, PULL, TimeSpan(2 * STEP_NS, 5 * STEP_NS)))

    run_steps(world, 2)
    before = speed(world)
    run_steps(world, 10)

    assert before == 0.0
    assert speed(world) == pytest.approx(3 * DT_S)
    assert len(world.applied_forces) == 0


def test_endless_force_acts_until_it_is_cleared() -> None:
    world = a_world_of_boxes("b", "c")
    world.applied_forces.add(LinkWrench("b", 0, PULL, FOREVER))
    world.applied_forces.add(LinkWrench("c", 0, PULL, FOREVER))
    run_steps(world, 50)

    assert world.applied_forces.clear_link("b", 0) == 1
    run_steps(world, 50)

    assert speed(world, "b") == pytest.approx(50 * DT_S)
    assert speed(world, "c") == pytest.approx(100 * DT_S)
    assert world.applied_forces.clear_link("b", 0) == 0


def test_effort_turns_a_joint_until_it_is_cleared() -> None:
    world = a_world("r")
    world.applied_forces.add(JointEffort("r", 0, 1.0, FOREVER))
    world.step()
    turned = world.states().joint_velocities[0]

    assert world.applied_forces.clear_joint("r", 1) == 0
    assert world.applied_forces.clear_joint("r", 0) == 1
    assert turned > 0.0


def test_forces_end_with_their_entity_and_with_a_reset() -> None:
    world = a_world_of_boxes("b", "c")
    for name in ("b", "c"):
        world.applied_forces.add(LinkWrench(name, 0, PULL, FOREVER))

    world.delete("b")
    assert len(world.applied_forces) == 1
    world.step()
    world.reset(1)

    assert len(world.applied_forces) == 0


def test_forces_are_refused_when_there_are_too_many() -> None:
    forces = AppliedForces()
    for _ in range(MAX_APPLIED_FORCES):
        forces.add(LinkWrench("b", 0, PULL, FOREVER))

    with pytest.raises(RequestRefused):
        forces.add(LinkWrench("b", 0, PULL, FOREVER))
