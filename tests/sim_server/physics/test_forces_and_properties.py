"""Forces, efforts and changed properties in each engine."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS
from tests.models import a_box, a_box_bot, a_lopsided_box, a_state, an_arm, box_bot_at
from tests.sim_server.fakes import a_spawn
from zensim.proto.messages.model_messages import Inertial, Model
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.world.applied_forces import JointEffort, LinkWrench, TimeSpan
from zensim.sim_server.world.simulated_world import SimulatedWorld

DT_S = STEP_NS * 1e-9
SECOND = 240
FOREVER = TimeSpan(0, None)


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def space(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    engine = request.param(EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False))
    world = SimulatedWorld(engine, name="default", step_ns=STEP_NS, control_steps=3)
    yield world
    world.close()


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def earth(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    world = SimulatedWorld(
        request.param(EngineConfig(STEP_NS)), name="default", step_ns=STEP_NS, control_steps=3
    )
    yield world
    world.close()


def steps(world: SimulatedWorld, count: int) -> None:
    for _ in range(count):
        world.step()


def wrench(*numbers: float) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return np.array(numbers)


def test_force_at_the_centre_of_mass_does_not_turn_a_lopsided_body(space: SimulatedWorld) -> None:
    model = a_lopsided_box()
    space.spawn(a_spawn("b", model=model, base=a_state((1.0, 2.0, 3.0), turn=(0.3, 0.2, 0.1))))
    space.applied_forces.add(LinkWrench("b", 0, wrench(3.0, -1.0, 0.5, 0.0, 0.0, 0.0), FOREVER))

    steps(space, SECOND)

    row = space.state_of("b")
    expected = np.array([3.0, -1.0, 0.5]) * SECOND * DT_S / model.mass_kg
    assert row[7:10] == pytest.approx(expected, rel=1e-4)
    assert row[10:] == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)


def test_force_on_a_child_link_moves_the_whole_body(space: SimulatedWorld) -> None:
    # Momentum of two free bodies is force times time, whichever gets the force.
    model = a_box_bot()
    space.spawn(a_spawn("r", model=model, base=box_bot_at()))
    space.applied_forces.add(
        LinkWrench("r", 1, wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.0), TimeSpan(0, STEP_NS))
    )

    steps(space, 1)

    assert 0.0 < space.state_of("r")[7] < 2.0 * DT_S / model.mass_kg


def test_effort_holds_an_arm_against_gravity(earth: SimulatedWorld) -> None:
    model = an_arm("continuous")
    earth.spawn(a_spawn("a", model=model, base=a_state((0.0, 0.0, 0.0))))
    link = model.links[1].inertial
    most = link.mass_kg * 9.81 * link.com_in_link[0]
    earth.applied_forces.add(JointEffort("a", 0, -0.3 * most, FOREVER))
    earth.replace_model("a", damped(model, 0.3))

    steps(earth, 10 * SECOND)

    assert np.cos(earth.states().joint_positions[0]) == pytest.approx(0.3, abs=0.01)


def damped(model: Model, damping: float) -> Model:
    joint = msgspec.structs.replace(model.joints[0], damping=damping)
    return msgspec.structs.replace(model, joints=(joint,))


def test_body_stays_in_the_air_once_its_gravity_is_off(earth: SimulatedWorld) -> None:
    model = a_box()
    earth.spawn(a_spawn("b", model=model, base=a_state((0.0, 0.0, 2.0))))
    link = msgspec.structs.replace(model.links[0], weightless=model.links[0].inertial)

    earth.replace_model("b", msgspec.structs.replace(model, links=(link,)))
    steps(earth, SECOND)

    assert earth.state_of("b")[2] == pytest.approx(2.0, abs=1e-6)


def test_body_keeps_its_speed_when_its_mass_changes(space: SimulatedWorld) -> None:
    model = a_box()
    space.spawn(a_spawn("b", model=model, base=a_state((0.0, 0.0, 2.0), linear=(1.0, 0.0, 0.0))))
    heavy = Inertial(10.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1))
    link = msgspec.structs.replace(model.links[0], inertial=heavy)

    space.replace_model("b", msgspec.structs.replace(model, links=(link,)))
    assert space.state_of("b")[7] == pytest.approx(1.0)
    space.applied_forces.add(LinkWrench("b", 0, wrench(5.0, 0.0, 0.0, 0.0, 0.0, 0.0), FOREVER))
    steps(space, SECOND)

    assert space.state_of("b")[7] == pytest.approx(1.0 + 0.5 * SECOND * DT_S, rel=1e-4)


def test_joint_keeps_a_limit_that_is_set(earth: SimulatedWorld) -> None:
    model = an_arm("revolute", damping=0.05)
    earth.spawn(a_spawn("a", model=model, base=a_state((0.0, 0.0, 0.0))))
    joint = msgspec.structs.replace(model.joints[0], lower=-0.1, upper=0.1)
    earth.replace_model("a", msgspec.structs.replace(model, joints=(joint,)))
    earth.applied_forces.add(JointEffort("a", 0, 50.0, FOREVER))

    steps(earth, 2 * SECOND)

    assert float(earth.states().joint_positions[0]) == pytest.approx(0.1, abs=0.02)
