"""Diverged robots in each engine: they are frozen, and the others continue."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, running
from tests.models import a_box, a_box_bot, a_state, box_bot_at
from tests.sim_server.description.robots import a_collision, a_joint, a_link, a_robot, an_inertial
from tests.sim_server.fakes import a_command, a_spawn
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.world.simulated_world import SimulatedWorld

SPEED_RAD_S = 4.0
CONTROL_STEPS = 5
NAMES = ("a", "b", "c")


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


@pytest.fixture
def world(engine: Engine) -> SimulatedWorld:
    """Three driving box_bots 1 m apart, each with an agent."""
    made = SimulatedWorld(engine, name="default", step_ns=STEP_NS, control_steps=CONTROL_STEPS)
    for i, name in enumerate(NAMES):
        made.spawn(a_spawn(name, model=a_box_bot(), base=box_bot_at(0.0, float(i))))
        made.claim(f"agent_{name}", (name,), "stop")
    drive(made, 60)
    made.clock.take_events()
    return made


def drive(world: SimulatedWorld, steps: int) -> None:
    """Step, read and command as the loop does; assert that all output is finite."""
    for _ in range(steps):
        world.step()
        if world.is_control_step:
            for _, state in world.drive_states():
                assert_finite(state.base, state.joint_positions, state.joint_velocities)
            for agent in world.claims.agents:
                world.command(agent, a_command(world, agent, SPEED_RAD_S, SPEED_RAD_S))
    shown = world.snapshot(1.0)
    assert_finite(shown.base, shown.joint_positions)


def assert_finite(*packed: bytes) -> None:
    for numbers in packed:
        assert np.isfinite(np.frombuffer(numbers)).all()


def set_component(world: SimulatedWorld, name: str, column: int, value: float) -> None:
    row = world.state_of(name).copy()
    row[column] = value
    world.place(name, row)


def position_of(world: SimulatedWorld, name: str) -> FloatArray:
    return np.array(world.state_of(name)[:3])


def a_mismatched_arm() -> Model:
    """Adjacent masses differ by 1e16, with a gear of 1e6: Bullet cannot solve this."""
    parts = [a_link("l0", an_inertial("1e-4", "1e-8") + a_collision())]
    gear = ""
    for i, (mass, moment) in enumerate((("1e12", "1e12"), ("1e-4", "1e-8")), start=1):
        tip = '<origin xyz="0.3 0 0"/>'
        parts.append(a_link(f"l{i}", an_inertial(mass, moment, tip) + a_collision(origin=tip)))
        place = f'<origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>{gear}'
        parts.append(a_joint(f"j{i}", (f"l{i - 1}", f"l{i}"), "continuous", place))
        gear = '<mimic joint="j1" multiplier="1e6"/>'
    return read_urdf(a_robot(*parts))


@pytest.mark.parametrize(
    ("column", "value"),
    [(0, np.nan), (2, np.inf), (5, np.nan), (7, 1e300), (7, np.nan), (12, -np.inf), (1, -2e6)],
)
def test_diverged_robot_is_frozen_and_the_others_continue(
    world: SimulatedWorld, column: int, value: float
) -> None:
    before = {name: position_of(world, name) for name in NAMES}

    set_component(world, "b", column, value)
    drive(world, 240)

    assert position_of(world, "b") == pytest.approx(before["b"], abs=1e-9)
    assert not world.state_of("b")[7:].any()
    for name in ("a", "c"):
        went = position_of(world, name)[0] - before[name][0]
        assert went == pytest.approx(SPEED_RAD_S * 0.035 * 240 * STEP_NS * 1e-9, rel=0.5)


def test_diverged_robot_causes_one_warning_and_releases_its_claim(world: SimulatedWorld) -> None:
    set_component(world, "b", 7, np.nan)
    drive(world, 60)

    events = [(event.kind, event.entity) for event in world.clock.take_events()]
    assert events == [("released", "b"), ("warning", "b")]
    assert world.claims.agents == ("agent_a", "agent_c")
    assert [entity.name for entity in world.entities] == list(NAMES)
    with pytest.raises(IncorrectState, match="'b'"):
        world.claim("agent_b", ("b",), "stop")


def test_place_of_a_frozen_robot_does_not_depend_on_readings_between_control_steps(
    world: SimulatedWorld,
) -> None:
    at_control_step = position_of(world, "b")
    world.step()
    world.step()
    assert world.read_if_valid()
    shown = world.snapshot(1.0)
    world.states()
    moved = position_of(world, "b")

    world.engine.set_base_state(world.entities.find("b").body, broken_row(moved))
    drive(world, 30)

    assert np.frombuffer(shown.base).reshape(-1, 13)[1, 0] == moved[0] != at_control_step[0]
    assert position_of(world, "b") == pytest.approx(at_control_step, abs=1e-12)


def test_diverged_robot_is_not_frozen_by_a_reading_that_wall_time_paces(
    world: SimulatedWorld,
) -> None:
    world.step()
    far = box_bot_at(-2e6, 1.0)
    world.engine.set_base_state(world.entities.find("b").body, far)

    is_valid = world.read_if_valid()

    assert not is_valid
    assert world.divergence_guard.frozen == ()
    assert world.engine.read((world.entities.find("b").body,)).base[0, 0] == far[0]


def broken_row(position: FloatArray) -> FloatArray:
    row = np.zeros(13)
    row[:3], row[6], row[7] = position, 1.0, np.nan
    return row


def test_diverged_robot_keeps_its_wheel_positions(world: SimulatedWorld) -> None:
    joints = slice(2, 4)
    turned = world.states().joint_positions[joints].copy()

    set_component(world, "b", 7, np.nan)
    drive(world, 60)

    assert turned.min() > 0.1
    assert world.states().joint_positions[joints] == pytest.approx(turned)
    assert not world.states().joint_velocities[joints].any()


def test_frozen_robot_drives_again_once_its_state_is_set(world: SimulatedWorld) -> None:
    set_component(world, "b", 7, np.nan)
    drive(world, 30)

    world.place("b", box_bot_at(0.0, 1.0))
    world.claim("agent_b", ("b",), "stop")
    drive(world, 240)

    assert position_of(world, "b")[0] > 0.05
    assert position_of(world, "b")[1:] == pytest.approx([1.0, 0.06], abs=2e-3)


def test_frozen_robot_drives_again_after_a_reset(world: SimulatedWorld) -> None:
    set_component(world, "b", 7, np.nan)
    drive(world, 30)

    world.reset(ResetScope.STATE)
    assert position_of(world, "b") == pytest.approx([0.0, 1.0, 0.06], abs=1e-9)
    world.claim("agent_b", ("b",), "stop")
    drive(world, 240)

    assert position_of(world, "b")[0] == pytest.approx(position_of(world, "a")[0], rel=0.02)


def test_reset_restores_a_robot_that_just_diverged(world: SimulatedWorld) -> None:
    set_component(world, "b", 7, np.nan)
    world.step()

    world.reset(ResetScope.STATE)
    world.claim("agent_b", ("b",), "stop")
    drive(world, 240)

    assert position_of(world, "b")[0] == pytest.approx(position_of(world, "a")[0], rel=0.02)


def test_frozen_robot_can_be_deleted_and_its_name_reused(world: SimulatedWorld) -> None:
    set_component(world, "b", 7, np.nan)
    drive(world, 30)

    world.delete("b")
    world.spawn(a_spawn("b", model=a_box_bot(), base=box_bot_at(3.0, 1.0)))
    world.claim("agent_b", ("b",), "stop")
    drive(world, 240)

    assert position_of(world, "b")[0] > 3.05


def test_frozen_robot_is_an_obstacle(world: SimulatedWorld) -> None:
    before = position_of(world, "b")
    set_component(world, "b", 7, np.nan)
    drive(world, 30)

    world.place("a", box_bot_at(before[0] - 0.3, before[1]))
    drive(world, 960)

    assert position_of(world, "a")[0] < before[0] - 0.05
    assert position_of(world, "b") == pytest.approx(before, abs=1e-9)


def test_robot_in_contact_with_a_diverged_one_continues(world: SimulatedWorld) -> None:
    world.place("a", box_bot_at(5.0, 0.0))
    world.place("b", box_bot_at(5.101, 0.0))
    drive(world, 30)
    world.clock.take_events()

    set_component(world, "b", 7, 1e300)
    drive(world, 30)

    events = [(event.kind, event.entity) for event in world.clock.take_events()]
    assert ("released", "a") not in events
    assert events.count(("released", "b")) == 1


def test_robots_continue_beside_an_unsolvable_model(world: SimulatedWorld) -> None:
    before = position_of(world, "a")

    world.spawn(a_spawn("arm", model=a_mismatched_arm(), base=a_state((0.0, 0.5, 1.0))))
    drive(world, 480)

    warned = [event.entity for event in world.clock.take_events() if event.kind == "warning"]
    assert warned == ["arm"]
    assert position_of(world, "a")[0] > before[0] + 0.1


def test_wall_stays_in_place_when_a_robot_diverges_against_it(world: SimulatedWorld) -> None:
    wall, place = a_box("wall", 1.0, is_static=True), a_state((6.0, 0.0, 0.5))
    world.spawn(a_spawn("wall", model=wall, base=place))
    world.place("b", box_bot_at(5.449, 0.0))
    drive(world, 30)
    world.clock.take_events()

    set_component(world, "b", 7, np.nan)
    world.place("a", box_bot_at(5.3, 0.3))
    drive(world, 480)

    assert [event.entity for event in world.clock.take_events() if event.kind == "released"] == [
        "b"
    ]
    assert world.state_of("wall") == pytest.approx(place, abs=1e-9)
    assert 5.4 < position_of(world, "a")[0] < 5.46
