"""Joints start, and start again, where their controllers hold them, followers where these lead."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import STEP_NS, MakeEngine, advance, running
from tests.models import a_body, a_state
from zensim.proto.messages.model_messages import (
    CommandInterface,
    Joint,
    JointController,
    Link,
    Mimic,
    Model,
    Origin,
    Shape,
)
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.spawn_request import ValidatedSpawn

START = (0.3, 0.5, 1.1)
"""Of the lift [m], the elbow and its follower [rad]."""


def an_arm_with_a_start(*, is_static: bool = True) -> Model:
    """A lift, on it an elbow, on it a joint that turns twice as far and 0.1 rad more."""
    hand = Link("hand", a_body(0.5, 0.005), (Shape("sphere", (0.02, 0.0, 0.0)),))
    links = (Link("base", a_body()), *(Link(name, a_body(0.5, 0.005)) for name in "ab"), hand)
    up, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    joints = (
        Joint("lift", "prismatic", "base", "a", axis=up, lower=0.0, upper=1.0, effort=200.0),
        Joint(
            *("elbow", "revolute", "a", "b"), Origin((0.1, 0.0, 0.0)),
            axis=across, lower=-1.5, upper=1.5, effort=50.0,
        ),
        Joint(
            *("wrist", "revolute", "b", "hand"), Origin((0.2, 0.0, 0.0)),
            axis=across, lower=-3.0, upper=3.0, effort=50.0, mimic=Mimic("elbow", 2.0, 0.1),
        ),
    )  # fmt: skip
    return Model(
        "arm",
        links,
        joints,
        is_static=is_static,
        joint_controllers=(JointController("c", ("lift", "elbow"), holds=True),),
        command_interfaces=(
            CommandInterface("lift", "position", initial=START[0]),
            CommandInterface("elbow", "position", initial=START[1]),
        ),
    )


@pytest.fixture(params=[PyBulletEngine, MujocoEngine], ids=lambda make: make.name)
def world(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    make: MakeEngine = request.param
    with running(make) as engine:
        yield SimulatedWorld(engine, name="w", step_ns=STEP_NS, control_steps=1)


def positions(world: SimulatedWorld) -> list[float]:
    return [float(one) for one in world.states().joint_positions]


def test_joints_start_where_their_controller_holds_them(world: SimulatedWorld) -> None:
    world.spawn(ValidatedSpawn("arm", "", an_arm_with_a_start(), a_state((0.0, 0.0, 0.0))))

    assert positions(world) == pytest.approx(START)
    assert not world.states().joint_velocities.any()


def test_a_reset_brings_them_back(world: SimulatedWorld) -> None:
    world.spawn(ValidatedSpawn("arm", "", an_arm_with_a_start(), a_state((0.0, 0.0, 0.0))))
    advance(world.engine, 60)  # nothing holds them
    moved = positions(world)

    world.reset(ResetScope.STATE)

    assert moved != pytest.approx(START, abs=1e-3)
    assert positions(world) == pytest.approx(START)


def test_joints_without_a_start_are_at_zero(world: SimulatedWorld) -> None:
    model = an_arm_with_a_start()
    world.spawn(
        ValidatedSpawn("arm", "", Model("arm", model.links[:3], model.joints[:2]), a_state())
    )

    assert not np.any(positions(world))


def test_robot_stands_on_the_ground_with_its_joints_at_their_start() -> None:
    lowest = find_ground_clearance(an_arm_with_a_start())

    # The hand is 0.2 m beyond the elbow, which turns it down from the height of the lift.
    assert lowest == pytest.approx(0.3 - 0.2 * np.sin(0.5) - 0.02)
