"""World: spawning, deletion, time, reset, states, claims, commands and replacement."""

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.engines import STEP_NS, MakeEngine, ObedientEngine, TieredAuto, running
from tests.models import a_box, a_cart, a_controlled_arm, a_fork, a_puck, a_state, an_arm, on_ground
from tests.sim_server.fakes import (
    CONTROL_STEPS,
    a_command,
    a_spawn,
    a_world,
    floats,
    kinds_of_events,
    names_in,
    wheel_speeds,
)
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.model_messages import Model, Origin
from zensim.proto.messages.result_messages import ClaimCode
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.sim_server.errors import (
    EntityNotFound,
    IncorrectState,
    NameNotUnique,
    NameRefused,
    NamespaceRefused,
    RequestRefused,
)
from zensim.sim_server.physics.actuation import make_stop_targets
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import BodyStates, EngineRefused, FloatArray, can_move
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.world.applied_forces import LinkWrench, TimeSpan
from zensim.sim_server.world.entity import Entity, make_entity_index
from zensim.sim_server.world.simulated_world import (
    MAX_COORDINATE_M,
    MAX_STATE_AGE_NS,
    PROBATION_NS,
    DivergenceGuard,
    SimulatedWorld,
    make_frozen_model,
)
from zensim.sim_server.world.spawn_request import ValidatedSpawn

CART, BOX = a_cart(), a_box()


def an_entity(name: str, model: Model = CART, x: float = 0.0) -> Entity:
    return Entity(name, name, model, 0, on_ground(x), "", 0)


ENTITIES = (an_entity("a"), an_entity("box", BOX, 1.0), an_entity("b", x=2.0))
INDEX = make_entity_index(ENTITIES)


def valid_states() -> BodyStates:
    base = np.array([on_ground(float(x) + 10.0) for x in range(3)])
    return BodyStates(base, np.arange(4.0), np.zeros(4))


def test_valid_states_have_not_diverged() -> None:
    assert DivergenceGuard().find_diverged(INDEX, valid_states()) == []
    assert (
        DivergenceGuard().find_diverged(
            make_entity_index(()), BodyStates(np.zeros((0, 13)), np.zeros(0), np.zeros(0))
        )
        == []
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", range(13))
def test_entity_with_a_number_that_is_not_finite_has_diverged(column: int, value: float) -> None:
    states = valid_states()
    states.base[1, column] = value

    assert DivergenceGuard().find_diverged(INDEX, states) == ["box"]


@pytest.mark.parametrize(("joint", "name"), [(0, "a"), (1, "a"), (2, "b"), (3, "b")])
def test_entity_with_a_joint_that_is_not_finite_has_diverged(joint: int, name: str) -> None:
    positions, velocities = valid_states(), valid_states()
    positions.joint_positions[joint] = np.nan
    velocities.joint_velocities[joint] = np.inf

    assert DivergenceGuard().find_diverged(INDEX, positions) == [name]
    assert DivergenceGuard().find_diverged(INDEX, velocities) == [name]


@pytest.mark.parametrize(
    ("x", "has_diverged"), [(MAX_COORDINATE_M, False), (-1.1 * MAX_COORDINATE_M, True)]
)
def test_entity_outside_of_the_valid_range_has_diverged(x: float, *, has_diverged: bool) -> None:
    states = valid_states()
    states.base[2, 0] = x

    assert DivergenceGuard().find_diverged(INDEX, states) == (["b"] if has_diverged else [])


def test_frozen_entity_does_not_diverge_again() -> None:
    guard, states = DivergenceGuard(), valid_states()
    guard.freeze(ENTITIES[0])
    states.base[0, 0] = np.nan

    assert guard.find_diverged(INDEX, states) == []
    assert guard.is_frozen("a")


def test_last_valid_state_is_at_rest() -> None:
    guard, states = DivergenceGuard(), valid_states()
    states.base[2, 7:] = 3.0
    guard.remember(INDEX, states)

    rest = guard.last_valid_state(ENTITIES[2])

    assert rest.base == pytest.approx(on_ground(12.0))
    assert rest.positions.tolist() == [2.0, 3.0]


@pytest.mark.parametrize("case", ["never read", "spawned since", "name used again", "reset"])
def test_last_valid_state_is_the_initial_one_when_there_is_no_other(case: str) -> None:
    guard = DivergenceGuard()
    if case == "spawned since":
        guard.remember(
            make_entity_index(ENTITIES[:1]), BodyStates(np.zeros((1, 13)), np.ones(2), np.ones(2))
        )
    elif case != "never read":
        guard.remember(INDEX, valid_states())
    if case == "name used again":
        guard.forget("b")
    if case == "reset":
        guard.forget_all()

    rest = guard.last_valid_state(ENTITIES[2])

    assert rest.base == pytest.approx(on_ground(2.0))
    assert rest.positions.tolist() == [0.0, 0.0]


def test_joints_of_a_frozen_entity_keep_their_positions() -> None:
    guard = DivergenceGuard()
    guard.remember(INDEX, valid_states())
    guard.freeze(ENTITIES[2])
    later = replace(valid_states(), joint_positions=np.zeros(4))

    assert guard.complete(INDEX, later).joint_positions.tolist() == [0.0, 0.0, 2.0, 3.0]


def test_fastest_of_the_diverged_entities_is_the_cause() -> None:
    guard, states = DivergenceGuard(), valid_states()
    states.joint_velocities[2] = -9.0
    states.base[0, 8] = 5.0
    guard.remember(INDEX, states)

    assert guard.find_culprits(ENTITIES, 0) == {"b"}


def test_entity_that_diverges_again_within_a_second_is_the_cause() -> None:
    guard, states = DivergenceGuard(), valid_states()
    states.base[2, 8] = 5.0
    guard.remember(INDEX, states)
    guard.find_culprits(ENTITIES, 0)

    assert guard.find_culprits(ENTITIES[:2], PROBATION_NS - 1) == {"a", "box"}
    assert guard.find_culprits(ENTITIES[:1], 2 * PROBATION_NS - 1) == {"a"}


def test_entity_that_cannot_move_is_never_the_cause() -> None:
    wall = an_entity("wall", a_box(is_static=True))

    assert DivergenceGuard().find_culprits([wall], 0) == set()
    assert DivergenceGuard().find_culprits([wall, ENTITIES[0]], 0) == {"a"}
    assert can_move(an_arm("revolute"))
    assert not can_move(an_arm("fixed"))


def test_entity_can_be_unfrozen_once() -> None:
    guard = DivergenceGuard()
    rest = guard.freeze(ENTITIES[0])

    assert guard.find_frozen("a") is rest
    guard.unfreeze("a")
    assert guard.find_frozen("a") is None
    assert not guard.is_frozen("a")


@pytest.mark.parametrize(
    ("kind", "position", "place", "turn"),
    [
        (
            "revolute",
            np.pi / 2.0,
            (0.0, 0.0, 1.0),
            (0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)),
        ),
        ("prismatic", 0.25, (0.0, 0.0, 1.25), (0.0, 0.0, 0.0, 1.0)),
        ("fixed", 0.25, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
    ],
)
def test_frozen_model_has_its_joints_fixed_at_their_positions(
    kind: str,
    position: float,
    place: tuple[float, float, float],
    turn: tuple[float, float, float, float],
) -> None:
    model = make_frozen_model(an_arm(kind), np.array([position]))  # type: ignore[arg-type]

    (joint,) = model.joints
    assert joint.kind == "fixed"
    assert joint.origin.position == pytest.approx(place)
    assert joint.origin.orientation == pytest.approx(turn)
    assert not can_move(model)


def test_frozen_model_has_no_drive_and_no_mimic_joints() -> None:
    model = make_frozen_model(CART, np.zeros(2))

    assert model.drive is None
    assert model.is_static
    assert all(joint.mimic is None for joint in model.joints)
    assert model.joints[0].origin == Origin(CART.joints[0].origin.position)


def test_staged_entity_is_not_listed_but_its_names_are_taken() -> None:
    world = a_world("a")

    world.stage_spawn(a_spawn("b"))

    assert names_in(world) == ["a"]
    assert world.clock.take_events() == []
    assert world.entities.index.names == ("a",)
    with pytest.raises(NameNotUnique):
        world.spawn(a_spawn("b"))
    with pytest.raises(NamespaceRefused):
        world.spawn(a_spawn("c", "b"))


def test_staged_entities_are_committed_all_at_once() -> None:
    world = a_world("a")
    staged = [world.stage_spawn(a_spawn(name))[0] for name in "cb"]

    world.commit_staged(staged)

    assert names_in(world) == ["a", "c", "b"]
    assert [event.entity for event in world.clock.take_events()] == ["c", "b"]
    assert not world.entities.is_staged(staged[0])


def test_entity_that_is_rolled_back_leaves_nothing() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("a", engine=engine)

    world.rollback_staged([world.stage_spawn(a_spawn("b"))[0]])

    assert len(engine.bodies) == 1
    world.spawn(a_spawn("b"))
    assert names_in(world) == ["a", "b"]


def test_reset_of_spawned_entities_rolls_back_staged_ones() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("a", engine=engine)
    entity, _ = world.stage_spawn(a_spawn("b"))

    world.reset(ResetScope.SPAWNED)

    assert not world.entities.is_staged(entity)
    assert engine.bodies == ()


class HidingEngine(ObedientEngine):
    """Records which bodies are hidden."""

    def __init__(self) -> None:
        super().__init__(EngineConfig(STEP_NS))
        self.hidden: set[int] = set()

    def hide(self, body: int) -> None:
        self.hidden.add(body)

    def show(self, bodies: Sequence[int]) -> None:
        self.hidden -= set(bodies)


def test_staged_entity_is_hidden_until_it_is_committed() -> None:
    engine = HidingEngine()
    world = a_world("a", engine=engine)

    entity, _ = world.stage_spawn(a_spawn("b"))
    before = set(engine.hidden)
    world.commit_staged([entity])

    assert before == {entity.body}
    assert engine.hidden == set()


def test_staged_entity_overlaps_other_staged_ones() -> None:
    world = a_world("a")
    world.stage_spawn(a_spawn("b", base=on_ground(5.0)))

    _, overlapped = world.stage_spawn(a_spawn("c", base=on_ground(5.02)))

    assert overlapped() == ["b"]


def test_world_refuses_spawn_when_name_is_taken() -> None:
    world = a_world("r1")

    with pytest.raises(NameNotUnique):
        world.spawn(a_spawn("r1", "elsewhere"))

    assert names_in(world) == ["r1"]
    assert world.clock.take_events() == []


@pytest.mark.parametrize("name", ["", "1r", "r 1", "r/1", "é", "a" * 65])
def test_world_refuses_spawn_when_name_is_not_valid(name: str) -> None:
    world = a_world()

    with pytest.raises(NameRefused):
        world.spawn(a_spawn(name))

    assert names_in(world) == []


@pytest.mark.parametrize("namespace", ["sim", "world/r", "a//b", "a b", "/"])
def test_world_refuses_spawn_when_namespace_is_not_valid(namespace: str) -> None:
    world = a_world()

    with pytest.raises(NamespaceRefused):
        world.spawn(a_spawn("r1", namespace))

    assert names_in(world) == []


def test_world_refuses_spawn_when_namespace_is_taken() -> None:
    world = a_world("r1")

    with pytest.raises(NamespaceRefused):
        world.spawn(a_spawn("r2", "/r1"))

    assert names_in(world) == ["r1"]


def test_world_appends_a_number_when_renaming_is_allowed() -> None:
    world = a_world("r", "r_1")

    entity = world.spawn(a_spawn("r", allow_renaming=True))

    assert (entity.name, entity.namespace) == ("r_2", "r_2")


def test_world_shortens_the_longest_name_to_append_a_number() -> None:
    longest = "a" * 64
    world = a_world(longest)

    entity = world.spawn(a_spawn(longest, allow_renaming=True))

    assert entity.name == "a" * 56 + "_1"


def test_world_accepts_a_name_again_when_its_entity_was_deleted() -> None:
    world = a_world("r1")
    world.delete("r1")

    world.spawn(a_spawn("r1"))

    assert names_in(world) == ["r1"]


def test_world_is_unchanged_when_the_engine_refuses_a_spawn() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r1", engine=engine)

    with pytest.raises(EngineRefused):
        world.spawn(a_spawn("r2", model=an_arm("planar")))

    assert names_in(world) == ["r1"]
    assert len(engine.bodies) == 1
    assert world.clock.take_events() == []


@pytest.mark.parametrize("method", ["delete", "state_of", "reported_state"])
def test_world_refuses_an_entity_that_does_not_exist(method: str) -> None:
    world = a_world("r1")

    with pytest.raises(EntityNotFound):
        getattr(world, method)("r2")


def test_world_reads_an_entity_after_another_was_deleted() -> None:
    world = a_world("r0", "r1", "r2")

    world.delete("r1")

    assert world.state_of("r2") == pytest.approx(on_ground(2.0))


def test_world_indexes_joints_when_some_entities_have_none() -> None:
    world = a_world("r0")
    world.spawn(a_spawn("box", model=a_box(), base=a_state((5.0, 0.0, 0.1))))
    world.spawn(a_spawn("r1", base=on_ground(1.0)))

    index = world.entities.index

    assert index.names == ("r0", "box", "r1")
    assert index.joint_start.tolist() == [0, 2, 2]
    assert index.joint_count.tolist() == [2, 0, 2]


def test_roster_number_increases_with_each_spawn_and_delete() -> None:
    world = a_world("r0")
    before = world.entities.roster_number

    world.spawn(a_spawn("r1"))
    world.delete("r0")

    assert world.entities.roster_number == before + 2


def test_world_time_is_steps_of_one_length() -> None:
    world = a_world()

    for _ in range(240):
        world.step()

    assert (world.clock.steps, world.clock.time_ns) == (240, 240 * STEP_NS)


def test_world_plays_and_pauses_with_events() -> None:
    world = a_world()

    world.clock.pause()
    state, name = world.clock.state, world.clock.state_name
    world.clock.change_state(State.PLAYING)

    assert (state, name) == (State.PAUSED, "paused")
    assert world.clock.state_name == "playing"
    assert kinds_of_events(world) == ["paused", "played"]


def test_world_refuses_single_steps_when_it_plays() -> None:
    world = a_world()

    with pytest.raises(IncorrectState):
        world.clock.require_paused()


@pytest.mark.parametrize("scope", [ResetScope.DEFAULT, ResetScope.ALL])
def test_world_is_empty_and_at_zero_when_all_is_reset(scope: ResetScope) -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r0", "r1", engine=engine)
    world.step()

    world.reset(scope)

    assert (names_in(world), engine.bodies) == ([], ())
    assert (world.clock.steps, world.clock.epoch) == (0, 1)
    assert kinds_of_events(world) == ["deleted", "deleted", "reset"]


def test_world_keeps_entities_and_states_when_time_is_reset() -> None:
    world = a_moved_world()
    moved = world.state_of("r0").copy()

    world.reset(ResetScope.TIME)

    assert (world.clock.steps, world.clock.time_ns) == (0, 0)
    assert world.state_of("r0") == pytest.approx(moved)
    assert world.claims.agent_of("r0") == "a"


def test_world_restores_initial_states_when_states_are_reset() -> None:
    world = a_moved_world()

    world.reset(ResetScope.STATE)

    assert world.clock.steps == 100
    assert world.state_of("r0") == pytest.approx(on_ground())
    world.step()
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_keeps_time_when_spawned_entities_are_reset() -> None:
    world = a_moved_world()

    world.reset(ResetScope.SPAWNED)

    assert (names_in(world), world.clock.steps, len(world.claims)) == ([], 100, 0)


def a_moved_world() -> SimulatedWorld:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    for _ in range(100):
        world.step()
    return world


def test_world_snapshot_has_every_entity() -> None:
    world = a_world("r0", "r1")
    world.clock.pause()

    snapshot = world.snapshot(0.5)

    assert snapshot.names == ("r0", "r1")
    assert np.frombuffer(snapshot.base).reshape(-1, 13)[:, 0].tolist() == [0.0, 1.0]
    assert len(snapshot.joint_positions) == 4 * 8
    assert (snapshot.real_time_factor, snapshot.state) == (0.5, "paused")


def test_world_snapshot_is_empty_without_entities() -> None:
    snapshot = a_world().snapshot(1.0)

    assert (snapshot.names, snapshot.base, snapshot.joint_positions) == ((), b"", b"")


def test_world_places_an_entity() -> None:
    world = a_world("r0")

    world.place("r0", on_ground(7.0))

    assert world.state_of("r0") == pytest.approx(on_ground(7.0))


def test_world_copies_the_initial_state_of_an_entity() -> None:
    world, row = a_world(), on_ground(1.0)
    world.spawn(a_spawn("r0", base=row))

    row[:] = 9.0
    world.reset(ResetScope.STATE)

    assert world.state_of("r0") == pytest.approx(on_ground(1.0))


def test_world_closes_its_engine() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))

    a_world(engine=engine).close()

    assert engine.is_closed


def test_world_checks_overlaps_of_a_spawn_without_changes() -> None:
    engine = ObedientEngine(EngineConfig(STEP_NS))
    world = a_world("r0", "r1", engine=engine)
    before = (world.entities.roster_number, world.states().base.tobytes(), engine.bodies)

    overlapped = world.check_overlaps(a_spawn("r9", base=on_ground(1.02)))

    assert overlapped == ["r1"]
    assert (world.entities.roster_number, world.states().base.tobytes(), engine.bodies) == before
    assert (names_in(world), world.clock.take_events()) == (["r0", "r1"], [])


def test_world_refuses_to_check_what_it_refuses_to_spawn() -> None:
    world = a_world("r0")

    with pytest.raises(NameNotUnique):
        world.check_overlaps(a_spawn("r0", base=on_ground(5.0)))
    with pytest.raises(EngineRefused):
        world.check_overlaps(a_spawn("r1", model=an_arm("planar")))

    assert names_in(world) == ["r0"]


def test_world_names_the_entities_that_an_entity_overlaps() -> None:
    world = a_world("r0", "r1")
    world.spawn(a_spawn("r2", base=on_ground(0.02)))

    first, second, _ = world.entities
    assert (world.find_overlaps(first), world.find_overlaps(second)) == (["r2"], [])


def test_entity_of_the_world_file_has_no_namespace_and_survives_a_reset() -> None:
    world = a_world("r1")
    shelf = ValidatedSpawn("shelf", "", a_box(is_static=True), a_state((1.0, 0.0, 0.1)))
    world.spawn(replace(shelf, belongs_to_world=True))
    world.place("shelf", a_state((5.0, 0.0, 0.1)))

    world.reset(ResetScope.ALL)

    assert names_in(world) == ["shelf"]
    assert world.entities.find("shelf").namespace == ""
    assert world.state_of("shelf")[0] == 1.0


def test_robot_of_the_world_file_has_a_namespace() -> None:
    world = a_world()

    robot = world.spawn(replace(a_spawn("r1"), belongs_to_world=True))

    assert robot.namespace == "r1"


class CountingEngine(ObedientEngine):
    """Records which bodies are read."""

    def __init__(self) -> None:
        super().__init__(EngineConfig(STEP_NS))
        self.reads: list[tuple[int, ...]] = []

    def read(self, bodies: Sequence[int]) -> BodyStates:
        self.reads.append(tuple(bodies))
        return super().read(bodies)


def test_world_reads_one_entity_alone_when_the_others_were_not_read() -> None:
    engine = CountingEngine()
    world = a_world("a", "b", engine=engine)
    world.step()

    row = world.state_of("b")

    assert engine.reads == [(world.entities.find("b").body,)]
    assert row.tolist() == world.states().base[1].tolist()


def test_world_reads_states_once_per_step() -> None:
    engine = CountingEngine()
    world = a_world("a", "b", engine=engine)
    world.states()

    world.state_of("b")
    world.states()

    assert len(engine.reads) == 1


def a_driving_world() -> SimulatedWorld:
    """Make a world with a driving cart, with the states of a control step published."""
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 5.0, 5.0))
    for _ in range(CONTROL_STEPS):
        world.step()
    list(world.drive_states())
    return world


def test_reported_state_is_that_of_the_control_step_until_the_next() -> None:
    world = a_driving_world()
    published = world.state_of("r0").copy()

    for _ in range(CONTROL_STEPS - 1):
        world.step()
        row, time_ns = world.reported_state("r0")
        assert row.tolist() == published.tolist()
        assert time_ns == CONTROL_STEPS * STEP_NS

    assert world.state_of("r0")[0] > published[0]


def test_reported_state_is_read_again_when_a_control_step_was_not_published() -> None:
    world = a_driving_world()
    for _ in range(CONTROL_STEPS):
        world.step()

    row, time_ns = world.reported_state("r0")

    assert row.tolist() == world.state_of("r0").tolist()
    assert time_ns == 2 * CONTROL_STEPS * STEP_NS


def test_reported_state_is_read_again_when_it_is_too_old() -> None:
    world = a_driving_world()
    world.control_steps = 240
    steps = MAX_STATE_AGE_NS // STEP_NS + 1
    for _ in range(steps):
        world.step()

    assert world.reported_state("r0")[1] == (CONTROL_STEPS + steps) * STEP_NS


def test_reported_state_is_the_one_that_was_set() -> None:
    world = a_driving_world()
    world.step()

    world.place("r0", on_ground(7.0))

    assert world.reported_state("r0")[0][0] == pytest.approx(7.0)


def test_reported_state_is_current_while_paused() -> None:
    world = a_driving_world()
    world.clock.pause()
    world.step()

    row, time_ns = world.reported_state("r0")

    assert row.tolist() == world.state_of("r0").tolist()
    assert time_ns == (CONTROL_STEPS + 1) * STEP_NS


def list_informed_agents(world: SimulatedWorld) -> list[str]:
    return [agent for agent, _ in world.drive_states()]


def test_world_drives_an_entity_as_its_agent_commands() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()

    # The joints of a cart come right before left.
    assert wheel_speeds(world) == [5.0, 3.0]
    assert (world.claims.taken, world.claims.dropped) == (1, 0)


def test_world_takes_the_newest_command_when_several_come_in_one_step() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    for speed in (1.0, 2.0, 3.0):
        world.command("a", a_command(world, "a", speed, speed))
    world.step()

    assert wheel_speeds(world) == [3.0, 3.0]


def test_world_assigns_targets_in_the_order_of_claims() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r1", "r0"), "stop")

    world.command("a", a_command(world, "a", 1.0, 2.0, 3.0, 4.0))
    world.step()

    assert wheel_speeds(world) == [4.0, 3.0, 2.0, 1.0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"epoch": 1},
        {"claims": b""},
        {"claims": b"\xff" * 4},
        {"targets": floats([1.0])},
        {"targets": floats([1.0, 2.0, 3.0])},
        {"targets": floats([1.0, 2.0])[:-1]},
        {"targets": floats([float("nan"), 2.0])},
        {"targets": floats([1.0, float("-inf")])},
    ],
    ids=str,
)
def test_world_drops_and_counts_a_command_that_does_not_match(wrong: dict[str, object]) -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    command = a_command(world, "a", 1.0, 2.0)
    fields = {name: getattr(command, name) for name in command.__struct_fields__}

    is_accepted = world.command("a", DriveCommand(**{**fields, **wrong}))
    world.step()

    assert not is_accepted
    assert (world.claims.taken, world.claims.dropped) == (0, 1)
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_drops_a_command_of_an_agent_without_claims() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")

    world.command("b", a_command(world, "a", 1.0, 2.0))
    world.step()

    assert (world.claims.taken, world.claims.dropped) == (0, 1)
    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_drops_a_command_under_a_claim_that_was_renewed() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    stale = a_command(world, "a", 1.0, 2.0)

    world.claim("a", ("r0",), "stop")
    world.command("a", stale)

    assert (world.claims.taken, world.claims.dropped) == (0, 1)


def test_world_drops_a_command_from_before_a_reset() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    stale = a_command(world, "a", 1.0, 2.0)

    world.reset(ResetScope.TIME)
    world.command("a", stale)

    assert world.claims.dropped == 1


def test_world_drops_a_command_when_claims_change_before_the_step() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0", "r1"), "stop")
    world.command("a", a_command(world, "a", 1.0, 1.0, 1.0, 1.0))

    world.delete("r0")
    world.step()

    assert wheel_speeds(world) == [0.0, 0.0]


def test_world_never_uses_a_claim_twice() -> None:
    world = a_world("r0", "r1")

    numbers = []
    for agent in ("a", "b", "a"):
        numbers += [claim.claim for claim in world.claim(agent, ("r0", "r1"), "stop")]
        world.release(agent)

    assert len(set(numbers)) == len(numbers) == 6


def test_claim_has_names_model_description_and_initial_state() -> None:
    world = a_world("r0")

    (claim,) = world.claim("a", ("r0",), "stop")

    assert (claim.entity, claim.namespace, claim.robot_description) == ("r0", "r0", "<robot/>")
    assert claim.model == world.entities.find("r0").model
    assert claim.spawn_state == pytest.approx(on_ground())


def test_world_grants_an_entity_once_when_it_is_named_twice() -> None:
    world = a_world("r0")

    claims = world.claim("a", ("r0", "r0"), "stop")

    assert len(claims) == 1
    assert len(world.claims) == 1


def test_world_refuses_all_of_a_claim_when_another_agent_drives_one() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r1",), "stop")

    with pytest.raises(RequestRefused) as refused:
        world.claim("b", ("r0", "r1"), "stop")

    assert refused.value.code == ClaimCode.ALREADY_CLAIMED
    assert (world.claims.agent_of("r0"), world.claims.agent_of("r1")) == ("", "a")


def test_world_refuses_all_of_a_claim_when_one_does_not_exist() -> None:
    world = a_world("r0")

    with pytest.raises(EntityNotFound):
        world.claim("b", ("r0", "r9"), "stop")

    assert len(world.claims) == 0


def test_released_robot_stops_with_on_release_stop() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()
    world.clock.take_events()

    world.release("a")

    world.step()
    assert wheel_speeds(world) == [0.0, 0.0]
    assert world.claims.agent_of("r0") == ""
    assert kinds_of_events(world) == ["released"]


def test_released_robot_keeps_its_targets_with_on_release_keep() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "keep")
    world.command("a", a_command(world, "a", 3.0, 5.0))
    world.step()

    world.release("a")
    world.step()

    assert wheel_speeds(world) == [5.0, 3.0]


def test_released_robot_is_deleted_with_on_release_delete() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "delete")
    world.clock.take_events()

    world.release("a")

    assert names_in(world) == ["r1"]
    assert kinds_of_events(world) == ["released", "deleted"]


def test_release_of_an_unknown_agent_has_no_effect() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.clock.take_events()

    world.release("b")

    assert world.claims.agents == ("a",)
    assert world.clock.take_events() == []


def test_agent_gets_the_states_of_its_entities_in_the_order_of_claiming() -> None:
    world = a_world("r0", "r1", "r2")
    world.claim("a", ("r2",), "stop")
    world.claim("a", ("r0",), "stop")

    ((agent, state),) = world.drive_states()

    assert agent == "a"
    rows = np.frombuffer(state.base).reshape(-1, 13)
    assert rows == pytest.approx(np.array([on_ground(2.0), on_ground(0.0)]))
    assert np.frombuffer(state.claims, dtype="<u4").tolist() == [1, 2]
    assert len(state.joint_positions) == len(state.joint_velocities) == 4 * 8


def test_agent_gets_the_efforts_of_its_joints_while_it_wants_them() -> None:
    world = a_world("r0", "r1")
    for name in ("r0", "r1"):
        world.claim(name, (name,), "stop")
    found = []
    for wants in (False, True, False):
        command = a_command(world, "r1", 1.0, 1.0)
        assert world.command("r1", msgspec.structs.replace(command, wants_efforts=wants))
        world.step()
        states = dict(world.drive_states())
        found.append((len(states["r0"].joint_efforts), len(states["r1"].joint_efforts)))

    assert found == [(0, 0), (0, 2 * 8), (0, 0)]


class NumberedEfforts(ObedientEngine):
    """Joints exert the number of their body, and each reading is noted."""

    def __init__(self) -> None:
        super().__init__(EngineConfig(STEP_NS))
        self.asked: list[tuple[int, ...]] = []

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        self.asked.append(tuple(bodies))
        return np.repeat(np.array(bodies, float), 2)


def test_efforts_of_all_agents_that_want_them_are_read_in_one_call() -> None:
    engine = NumberedEfforts()
    world = a_world("r0", "r1", "r2", engine=engine)
    for name, agent in (("r0", "a"), ("r1", "b"), ("r2", "c")):
        world.claim(agent, (name,), "stop")
    for agent in ("a", "c"):
        command = a_command(world, agent, 1.0, 1.0)
        world.command(agent, msgspec.structs.replace(command, wants_efforts=True))

    states = dict(world.drive_states())

    bodies = [world.entities.find(name).body for name in ("r0", "r2")]
    assert engine.asked == [tuple(bodies)]
    for agent, body in zip(("a", "c"), bodies, strict=True):
        assert np.frombuffer(states[agent].joint_efforts).tolist() == [body, body]
    assert states["b"].joint_efforts == b""
    assert not dict(world.drive_states({"a", "c"}))["b"].joint_efforts
    assert len(engine.asked) == 1


def test_agent_that_ended_wants_no_efforts() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    command = a_command(world, "a", 1.0, 1.0)
    world.command("a", msgspec.structs.replace(command, wants_efforts=True))

    world.release("a")
    world.claim("a", ("r0",), "stop")

    assert dict(world.drive_states())["a"].joint_efforts == b""


def test_agent_gets_one_empty_state_after_its_last_claim_ended() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "stop")
    world.claim("b", ("r1",), "stop")

    world.delete("r0")

    states = dict(world.drive_states())
    assert set(states) == {"a", "b"}
    assert states["a"].claims == states["a"].base == b""
    assert list_informed_agents(world) == ["b"]


def test_agent_gets_no_empty_state_when_it_claims_again() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "stop")
    world.delete("r0")

    world.claim("a", ("r1",), "stop")

    ((_, state),) = world.drive_states()
    assert len(state.base) == 13 * 8


@pytest.mark.parametrize("on_release", ["stop", "keep", "delete"])
def test_released_agent_gets_no_states(on_release: str) -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), on_release)  # type: ignore[arg-type]

    world.release("a")

    assert list_informed_agents(world) == []


def test_every_third_step_is_a_control_step() -> None:
    world = a_world()

    flags = []
    for _ in range(6):
        world.step()
        flags.append(world.is_control_step)

    assert flags == [False, False, True, False, False, True]


def test_world_records_the_time_to_the_first_command_once() -> None:
    world = a_world("r0", "r1")
    world.claim("a", ("r0",), "stop")

    world.record_ready_time("a", 2_000_000_000)
    world.record_ready_time("a", 9_000_000_000)

    assert world.ready_s == {"r0": pytest.approx(2.0)}


entity_names = st.lists(st.sampled_from(["a", "b", "c", "d"]), unique=True)


def replace_world(
    old: list[str], new: list[str]
) -> tuple[SimulatedWorld, ObedientEngine, ObedientEngine]:
    """Make a world and replace it by another; return it with both engines."""
    engines = (ObedientEngine(EngineConfig(STEP_NS)), ObedientEngine(EngineConfig(STEP_NS)))
    world, other = a_world(*old, engine=engines[0]), a_world(*new, engine=engines[1])
    if old:
        world.claim("agent", tuple(old), "stop")
        world.applied_forces.add(LinkWrench(old[0], 0, np.zeros(6), TimeSpan(0, None)))
    world.step()
    world.clock.take_events()
    world.replace_with(other, State.STOPPED)
    return world, *engines


@given(old=entity_names, new=entity_names)
def test_replaced_world_has_the_entities_of_the_other_only(old: list[str], new: list[str]) -> None:
    world, before, after = replace_world(old, new)

    assert names_in(world) == new
    assert before.is_closed
    assert not after.is_closed
    assert [entity.body for entity in world.entities] == list(after.bodies)
    assert (len(world.claims), len(world.applied_forces)) == (0, 0)
    assert (world.clock.steps, world.clock.epoch, world.clock.state) == (0, 1, State.STOPPED)
    kinds = ["deleted"] * len(old) + ["loaded"] + ["spawned"] * len(new)
    assert kinds_of_events(world) == kinds
    assert len(world.states().base) == len(new)


def test_command_for_the_former_world_is_dropped() -> None:
    world, _, _ = replace_world(["a"], ["a"])
    stale = a_command(world, "agent", 1.0, 1.0)
    world.claim("agent", ("a",), "stop")

    assert not world.command("agent", stale)


def test_agent_that_lost_all_claims_with_the_world_gets_an_empty_state() -> None:
    world, _, _ = replace_world(["a", "b"], [])

    states = dict(world.drive_states())

    assert states["agent"].claims == b""
    assert states["agent"].epoch == 1


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine, TieredAuto, ObedientEngine])
@pytest.mark.parametrize("model", [a_cart(), a_fork(), a_puck()], ids=lambda model: model.name)
def test_robot_of_a_silent_agent_stops_in_each_engine(make: MakeEngine, model: Model) -> None:
    with running(make) as engine:
        world = SimulatedWorld(engine, name="w", step_ns=STEP_NS, control_steps=CONTROL_STEPS)
        world.spawn(a_spawn("r0", model=model))
        world.claim("a", ("r0",), "stop")
        world.command("a", a_command(world, "a", *[0.5] * model.target_count))
        _advance(world, 60)
        moving = _fastest(world)

        world.stop_silent("a")
        _advance(world, 60)

        assert moving > 0.01
        assert _fastest(world) < 0.01
        assert world.command("a", a_command(world, "a", *[0.5] * model.target_count))
        _advance(world, 60)
        assert _fastest(world) > 0.01


def _fastest(world: SimulatedWorld) -> float:
    states = world.states()
    speeds = np.concatenate([states.base[0, [7, 8, 12]], states.joint_velocities])
    return float(np.abs(speeds).max())


def _advance(world: SimulatedWorld, steps: int) -> None:
    for _ in range(steps):
        world.step()


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine], ids=lambda make: make.name)
def test_joint_stays_when_its_agent_ends_and_the_next_one_goes_on_with_it(make: MakeEngine) -> None:
    with running(make) as engine:
        world = SimulatedWorld(engine, name="w", step_ns=STEP_NS, control_steps=CONTROL_STEPS)
        world.spawn(a_spawn("r0", model=a_controlled_arm(), base=a_state((0.0, 0.0, 0.0))))
        (first,) = world.claim("a", ("r0",), "stop")
        world.command("a", a_command(world, "a", 1.0, -0.3))
        for _ in range(240):
            world.step()

        world.release("a")
        for _ in range(240):
            world.step()
        place = float(world.states().joint_positions[0])
        (second,) = world.claim("b", ("r0",), "stop")
        world.reset(ResetScope.STATE)
        (third,) = world.claim("b", ("r0",), "stop")

    assert place == pytest.approx(-0.3, abs=0.01)
    targets = [one.joint_targets for one in (first, second, third)]
    assert targets == [(), (1.0, -0.3), ()]


class RecordedStops(ObedientEngine):
    """Keeps the targets of each body in the last command."""

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(config)
        self.last: dict[int, list[float]] = {}

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        ends = np.cumsum([self._bodies[body].model.target_count for body in bodies])
        parts = np.split(targets, ends[:-1])
        self.last = {body: part.tolist() for body, part in zip(bodies, parts, strict=True)}
        super().command(bodies, targets)


def test_robots_of_a_pool_stop_with_the_targets_of_each_alone() -> None:
    models = {"c0": a_cart(), "f0": a_fork(), "arm": a_controlled_arm(), "f1": a_fork()}
    models |= {"c1": models["c0"], "f2": models["f0"], "idle_arm": models["arm"]}
    with running(RecordedStops) as engine:
        world = SimulatedWorld(engine, name="w", step_ns=STEP_NS, control_steps=1)
        for number, (name, model) in enumerate(models.items()):
            world.spawn(a_spawn(name, model=model, base=a_state((4.0 * number, 0.0, 0.0))))
        world.claim("other", ("arm",), "stop")
        world.command("other", a_command(world, "other", 1.0, -0.3))
        _advance(world, 2)
        world.release("other")
        names = tuple(models)
        world.claim("a", names, "stop")
        states = {name: engine.read([world.entities.find(name).body]) for name in names}

        world.stop_silent("a")

        for name, model in models.items():
            held = np.array([1.0, -0.3]) if name == "arm" else None
            alone = make_stop_targets(model, states[name].joint_positions, held)
            assert isinstance(engine, RecordedStops)
            assert engine.last[world.entities.find(name).body] == alone.tolist(), name
