"""No exception of an engine about one body ends the world or changes the others."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, MakeEngine, advance, running
from tests.faulty_engines import ALWAYS, CONFIG, FAULTY_ENGINES, FaultyEngine, make_culprit
from tests.hostile.mutants import a_nested_model, an_arm_of_all_joints
from tests.models import a_box, a_box_bot, a_cart, a_state, an_arm, box_bot_at, on_ground
from tests.sim_server.fakes import a_command, a_spawn, names_in
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.physics.engine import EngineRefused, FloatArray
from zensim.sim_server.physics.isolating_engine import IsolatingEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.world.simulated_world import SimulatedWorld

CONTROL_STEPS = 5
SPEED_RAD_S = 4.0
CULPRIT_AT = on_ground(50.0)
NAMES = ["good", "box"]
CALLED_IN_EVERY_LAYER = (
    "read",
    "set_base_state",
    "set_at_rest",
    "set_state",
    "command",
    "apply_link_wrench",
    "apply_joint_effort",
    "step",
)


@pytest.fixture(params=FAULTY_ENGINES.values(), ids=list(FAULTY_ENGINES))
def world(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    """A driven cart and a box."""
    made = SimulatedWorld(
        request.param(), name="default", step_ns=STEP_NS, control_steps=CONTROL_STEPS
    )
    made.spawn(a_spawn("good", model=a_cart()))
    made.spawn(a_spawn("box", model=a_box(), base=a_state((0.0, 3.0, 0.1))))
    made.claim("agent_good", ("good",), "stop")
    made.clock.take_events()
    yield made
    made.close()


def drive(world: SimulatedWorld, steps: int) -> None:
    for _ in range(steps):
        world.step()
        if world.is_control_step:
            for _, state in world.drive_states():
                assert np.isfinite(np.frombuffer(state.base)).all()
            for agent in world.claims.agents:
                world.command(agent, a_command(world, agent, SPEED_RAD_S, SPEED_RAD_S))
    assert np.isfinite(np.frombuffer(world.snapshot(1.0).base)).all()


def assert_drives(world: SimulatedWorld) -> None:
    before = position_of(world, "good")
    drive(world, 120)
    went = position_of(world, "good")[0] - before[0]
    assert went == pytest.approx(SPEED_RAD_S * 0.05 * 120 * STEP_NS * 1e-9, rel=0.2)
    assert position_of(world, "box") == pytest.approx([0.0, 3.0, 0.1], abs=2e-3)


def position_of(world: SimulatedWorld, name: str) -> FloatArray:
    return np.array(world.state_of(name)[:3])


def spawn_culprit(world: SimulatedWorld, method: str, model: Model | None = None) -> int:
    culprit = make_culprit(model or a_cart(), method)
    return world.spawn(a_spawn("culprit", model=culprit, base=CULPRIT_AT)).body


def use(world: SimulatedWorld, method: str, body: int) -> None:
    """Call what is not called in each step."""
    engine, zeros = world.engine, np.zeros(2)
    calls = {
        "set_base_state": lambda: engine.set_base_state(body, CULPRIT_AT),
        "set_at_rest": lambda: engine.set_at_rest(body, CULPRIT_AT),
        "set_state": lambda: engine.set_state(body, CULPRIT_AT, zeros, zeros),
        "apply_link_wrench": lambda: engine.apply_link_wrench(body, 0, np.ones(6)),
        "apply_joint_effort": lambda: engine.apply_joint_effort(body, 0, 0.1),
    }
    if method in calls:
        calls[method]()


@pytest.mark.parametrize("method", CALLED_IN_EVERY_LAYER)
def test_body_that_the_engine_fails_for_is_frozen(world: SimulatedWorld, method: str) -> None:
    body = spawn_culprit(world, method)
    is_kinematic = world.engine.tier_of(body) == "kinematic"
    world.claim("agent_culprit", ("culprit",), "stop")
    drive(world, CONTROL_STEPS)

    use(world, method, body)
    drive(world, 2 * CONTROL_STEPS)

    # A kinematic robot joins the engine only when it is pushed.
    if not is_kinematic:
        assert world.divergence_guard.is_frozen("culprit")
        warned = [one for one in world.clock.take_events() if one.kind == "warning"]
        assert [one.entity for one in warned] == ["culprit"]
        assert f"SystemError: {method}" in warned[0].message
        assert position_of(world, "culprit") == pytest.approx(CULPRIT_AT[:3], abs=0.02)
    assert not world.divergence_guard.is_frozen("good")
    assert_drives(world)


@pytest.mark.parametrize("method", ["read", "step"])
def test_frozen_body_that_fails_again_loses_its_collisions(
    world: SimulatedWorld, method: str
) -> None:
    body = spawn_culprit(world, f"{method}.{ALWAYS}")
    is_kinematic = world.engine.tier_of(body) == "kinematic"

    drive(world, 2 * CONTROL_STEPS)

    assert is_kinematic or world.divergence_guard.is_frozen("culprit")
    assert_drives(world)


def test_model_that_the_engine_fails_to_add_is_refused(world: SimulatedWorld) -> None:
    spawn = a_spawn("culprit", model=make_culprit(a_cart(), "insert"), base=CULPRIT_AT)

    for attempt in (world.spawn, world.check_overlaps, world.stage_spawn):
        with pytest.raises(EngineRefused):
            attempt(spawn)

    assert names_in(world) == NAMES
    assert not world.entities.staged
    assert_drives(world)


def test_model_that_the_engine_fails_to_prepare_needs_no_preparation(world: SimulatedWorld) -> None:
    model = make_culprit(a_cart(), "prepare")

    while not world.prepare(model):
        world.step()
    world.spawn(a_spawn("culprit", model=model, base=CULPRIT_AT))

    assert_drives(world)


def test_spawn_whose_overlaps_cannot_be_found_is_refused(world: SimulatedWorld) -> None:
    model = make_culprit(a_box(), "find_overlaps")
    # Beside the box: engines of many cells ask about bodies that are near others only.
    spawn = a_spawn("culprit", model=model, base=a_state((0.0, 3.2, 0.1)))

    for attempt in (world.check_overlaps, world.spawn_and_find_overlaps):
        with pytest.raises(EngineRefused):
            attempt(spawn)
    with pytest.raises(EngineRefused):
        stage_and_wait(world, spawn)

    world.rollback_staged(world.entities.staged)
    assert names_in(world) == NAMES
    assert_drives(world)


def stage_and_wait(world: SimulatedWorld, spawn: object) -> None:
    _, find_overlaps = world.stage_spawn(spawn)  # type: ignore[arg-type]
    find_overlaps()


@pytest.mark.parametrize("method", ["hide", "show"])
def test_batch_spawn_survives_a_body_that_cannot_be_hidden(
    world: SimulatedWorld, method: str
) -> None:
    spawn = a_spawn("culprit", model=make_culprit(a_cart(), method), base=CULPRIT_AT)

    entity, _ = world.stage_spawn(spawn)
    drive(world, CONTROL_STEPS)
    world.commit_staged([entity])
    drive(world, 2 * CONTROL_STEPS)

    assert names_in(world) == [*NAMES, "culprit"]
    assert_drives(world)


def test_body_that_the_engine_fails_to_remove_is_deleted(world: SimulatedWorld) -> None:
    spawn_culprit(world, "discard")
    drive(world, CONTROL_STEPS)

    world.delete("culprit")

    assert names_in(world) == NAMES
    assert_drives(world)


@pytest.mark.parametrize("method", ["sleep", "wake", "find_contacts"])
def test_body_that_the_engine_fails_to_put_to_sleep_ends_no_other(
    world: SimulatedWorld, method: str
) -> None:
    spawn_culprit(world, method, a_box())

    drive(world, 480)
    world.place("culprit", CULPRIT_AT)
    drive(world, CONTROL_STEPS)

    assert not world.divergence_guard.is_frozen("good")
    assert_drives(world)


def test_engine_with_a_body_that_is_set_aside_is_not_copied() -> None:
    engine = IsolatingEngine(FaultyEngine(MujocoEngine(CONFIG)))
    culprit = engine.add(make_culprit(a_cart(), "command"), on_ground())
    good = engine.add(a_cart(), on_ground(2.0))
    engine.command([culprit], np.zeros(2))

    with pytest.raises(EngineRefused):
        engine.replicate([good], 1)

    engine.remove(culprit)
    assert engine.replicate([good], 1).read().base.shape == (1, 13)
    engine.close()


def test_frozen_entity_is_restored_by_a_reset_or_stays_frozen(world: SimulatedWorld) -> None:
    spawn_culprit(world, "read")
    drive(world, 2 * CONTROL_STEPS)

    world.reset(ResetScope.STATE)
    drive(world, 2 * CONTROL_STEPS)

    assert not world.divergence_guard.is_frozen("good")
    assert_drives(world)


def a_stretched_model() -> Model:
    """A model with a link 10^5 km from its joint: the first step diverges."""
    egg = "<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>"
    text = a_nested_model().replace(egg, "<sphere><radius>0.2</radius></sphere>")
    return read_robot(text.replace("0 0 0.5 0 0 0", "0 0 9e7 0 0 0"))


@pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)
def test_body_that_diverges_changes_no_bit_of_one_elsewhere(make: MakeEngine) -> None:
    alone, beside = (
        drive_beside(make, other) for other in ((), (a_stretched_model(), an_arm("continuous")))
    )

    assert alone == beside


def test_model_with_which_mujoco_cannot_invert_masses_is_refused() -> None:
    text = an_arm_of_all_joints()
    _, first, second, *_ = text.split('xyz="0 0 0.3"')
    far = 'xyz="0 0 -1e9"'
    text = text.replace(f'{first}xyz="0 0 0.3"{second}', f"{first}{far}{second}")
    with running(MujocoEngine) as engine:
        robot = engine.add(a_box_bot(), box_bot_at())
        with pytest.raises(EngineRefused):
            engine.add(read_robot(text, allow_missing=True), a_state((2e4, 0.0, 1.0)))
        engine.step()
        assert np.isfinite(engine.read([robot]).base).all()


def drive_beside(make: MakeEngine, others: Sequence[Model]) -> bytes:
    """Drive a robot, with others far away for a while; return its last state."""
    with running(make) as engine:
        bodies, targets = (engine.add(a_box_bot(), box_bot_at()),), np.array([4.0, 3.0])
        engine.command(bodies, targets)
        advance(engine, 20)
        far = [engine.add(other, a_state((2e4, 1e3 * i, 1.0))) for i, other in enumerate(others)]
        advance(engine, 40)
        for body in far:
            engine.remove(body)
        advance(engine, 20)
        reading = engine.read(bodies)
    return reading.base.tobytes() + reading.joint_positions.tobytes()
