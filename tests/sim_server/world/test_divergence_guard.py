"""Watch: who has gone bad, whom to freeze, and where each was last good."""

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
ROSTER = make_entity_index(ENTITIES)


def a_reading() -> BodyStates:
    base = np.array([on_ground(float(x) + 10.0) for x in range(3)])
    return BodyStates(base, np.arange(4.0), np.zeros(4))


def test_watch_finds_nobody_when_all_numbers_are_good() -> None:
    assert DivergenceGuard().find_diverged(ROSTER, a_reading()) == []
    assert (
        DivergenceGuard().find_diverged(
            make_entity_index(()), BodyStates(np.zeros((0, 13)), np.zeros(0), np.zeros(0))
        )
        == []
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", range(13))
def test_watch_finds_who_has_a_number_that_is_not_finite(column: int, value: float) -> None:
    reading = a_reading()
    reading.base[1, column] = value

    assert DivergenceGuard().find_diverged(ROSTER, reading) == ["box"]


@pytest.mark.parametrize(("joint", "name"), [(0, "a"), (1, "a"), (2, "b"), (3, "b")])
def test_watch_finds_whose_joints_are_not_finite(joint: int, name: str) -> None:
    places, speeds = a_reading(), a_reading()
    places.joint_positions[joint] = np.nan
    speeds.joint_velocities[joint] = np.inf

    assert DivergenceGuard().find_diverged(ROSTER, places) == [name]
    assert DivergenceGuard().find_diverged(ROSTER, speeds) == [name]


@pytest.mark.parametrize(
    ("x", "is_bad"), [(MAX_COORDINATE_M, False), (-1.1 * MAX_COORDINATE_M, True)]
)
def test_watch_finds_who_left_the_world(x: float, *, is_bad: bool) -> None:
    reading = a_reading()
    reading.base[2, 0] = x

    assert DivergenceGuard().find_diverged(ROSTER, reading) == (["b"] if is_bad else [])


def test_watch_says_nothing_of_who_is_frozen_already() -> None:
    watch, reading = DivergenceGuard(), a_reading()
    watch.freeze(ENTITIES[0])
    reading.base[0, 0] = np.nan

    assert watch.find_diverged(ROSTER, reading) == []
    assert watch.is_frozen("a")


def test_watch_remembers_where_an_entity_was_last_good() -> None:
    watch, reading = DivergenceGuard(), a_reading()
    reading.base[2, 7:] = 3.0
    watch.remember(ROSTER, reading)

    stand = watch.last_valid_state(ENTITIES[2])

    assert stand.base == pytest.approx(on_ground(12.0))
    assert stand.positions.tolist() == [2.0, 3.0]


@pytest.mark.parametrize("case", ["never read", "spawned since", "name used again", "reset"])
def test_watch_takes_the_spawn_where_an_entity_was_never_good(case: str) -> None:
    watch = DivergenceGuard()
    if case == "spawned since":
        watch.remember(
            make_entity_index(ENTITIES[:1]), BodyStates(np.zeros((1, 13)), np.ones(2), np.ones(2))
        )
    elif case != "never read":
        watch.remember(ROSTER, a_reading())
    if case == "name used again":
        watch.forget("b")
    if case == "reset":
        watch.forget_all()

    stand = watch.last_valid_state(ENTITIES[2])

    assert stand.base == pytest.approx(on_ground(2.0))
    assert stand.positions.tolist() == [0.0, 0.0]


def test_reading_has_the_joints_of_a_frozen_entity_as_they_froze() -> None:
    watch = DivergenceGuard()
    watch.remember(ROSTER, a_reading())
    watch.freeze(ENTITIES[2])
    later = replace(a_reading(), joint_positions=np.zeros(4))

    assert watch.remember(ROSTER, later).joint_positions.tolist() == [0.0, 0.0, 2.0, 3.0]


def test_of_two_that_go_bad_together_the_faster_is_frozen() -> None:
    watch, reading = DivergenceGuard(), a_reading()
    reading.joint_velocities[2] = -9.0
    reading.base[0, 8] = 5.0
    watch.remember(ROSTER, reading)

    assert watch.find_culprits(ENTITIES, 0) == {"b"}


def test_who_goes_bad_again_within_a_second_is_frozen() -> None:
    watch, reading = DivergenceGuard(), a_reading()
    reading.base[2, 8] = 5.0
    watch.remember(ROSTER, reading)
    watch.find_culprits(ENTITIES, 0)

    assert watch.find_culprits(ENTITIES[:2], PROBATION_NS - 1) == {"a", "box"}
    assert watch.find_culprits(ENTITIES[:1], 2 * PROBATION_NS - 1) == {"a"}


def test_what_cannot_move_is_never_frozen() -> None:
    wall = an_entity("wall", a_box(is_static=True))

    assert DivergenceGuard().find_culprits([wall], 0) == set()
    assert DivergenceGuard().find_culprits([wall, ENTITIES[0]], 0) == {"a"}
    assert can_move(an_arm("revolute"))
    assert not can_move(an_arm("fixed"))


def test_thawed_entity_is_frozen_no_more() -> None:
    watch = DivergenceGuard()
    stand = watch.freeze(ENTITIES[0])

    assert watch.unfreeze("a") is stand
    assert watch.unfreeze("a") is None
    assert not watch.is_frozen("a")


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
def test_still_model_has_its_joints_fixed_where_they_are(
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


def test_still_model_has_no_drive_and_follows_nothing() -> None:
    model = make_frozen_model(CART, np.zeros(2))

    assert model.drive is None
    assert model.is_static
    assert all(joint.mimic is None for joint in model.joints)
    assert model.joints[0].origin == Origin(CART.joints[0].origin.position)
