"""DivergenceGuard: diverged entities, their causes, and their last valid states."""

from dataclasses import replace

import numpy as np
import pytest

from tests.models import a_box, a_cart, an_arm, on_ground
from zensim.proto.messages.model_messages import Model, Origin
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.world.divergence_guard import (
    MAX_COORDINATE_M,
    PROBATION_NS,
    DivergenceGuard,
    can_move,
    make_frozen_model,
)
from zensim.sim_server.world.entity import Entity, make_entity_index

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

    assert guard.remember(INDEX, later).joint_positions.tolist() == [0.0, 0.0, 2.0, 3.0]


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

    assert guard.unfreeze("a") is rest
    assert guard.unfreeze("a") is None
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
