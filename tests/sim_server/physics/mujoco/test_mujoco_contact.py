"""Frictions, priorities, and correction of sliding contacts."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import cast

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.model_messages import Contact
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.mujoco.mujoco_contact import (
    RIGID_IMPEDANCE,
    TANGENT_ROWS,
    FrictionRows,
    LiftIteration,
    MjPlacedContacts,
    find_sliding_rows,
    is_deep,
    make_contact_parameters,
    make_geom_friction,
    may_slide,
    predict_lifts,
    read_contact_points,
)


@pytest.mark.parametrize(("one", "other"), [(0.3, 1.0), (0.0, 0.2), (0.5, 0.6), (1.0, 2.0)])
def test_lesser_friction_has_the_higher_priority(one: float, other: float) -> None:
    lesser, greater = (
        make_geom_friction(one, is_static=False),
        make_geom_friction(other, is_static=False),
    )

    assert lesser.priority > greater.priority


@pytest.mark.parametrize("ground", [1.0, 100.0])
@pytest.mark.parametrize("friction", [0.0, 1.0, 50.0, 1e9])
def test_friction_of_rough_ground_does_not_count(ground: float, friction: float) -> None:
    assert (
        make_geom_friction(friction, is_static=False).priority
        > make_geom_friction(ground, is_static=True).priority
    )


def test_friction_of_smooth_ground_counts() -> None:
    assert (
        make_geom_friction(0.2, is_static=True).priority
        > make_geom_friction(0.5, is_static=False).priority
    )
    assert make_geom_friction(0.2, is_static=True).friction == 0.2


def test_compliant_part_has_priority_at_equal_friction() -> None:
    assert (
        make_geom_friction(0.5, is_static=False, is_soft=True).priority
        > make_geom_friction(0.5, is_static=False).priority
    )
    assert (
        make_geom_friction(0.5, is_static=False, is_soft=True).priority
        < make_geom_friction(0.4999, is_static=False).priority
    )


def test_contact_without_friction_is_one_row() -> None:
    assert make_geom_friction(0.0, is_static=False).rows == 1
    assert make_geom_friction(0.1, is_static=False).rows == 3


def one_contact(friction: float = 0.5) -> FrictionRows:
    normals = np.array([1], np.int32)
    return FrictionRows(normals, normals + TANGENT_ROWS, np.array([[friction], [friction]]))


@dataclass
class Contacts:
    """As in MuJoCo: one without friction, one not solved, and two with friction."""

    dim: npt.NDArray[np.int32] = field(default_factory=lambda: np.array([1, 3, 3, 3], np.int32))
    efc_address: npt.NDArray[np.int32] = field(
        default_factory=lambda: np.array([0, -1, 1, 4], np.int32)
    )
    geom: npt.NDArray[np.int32] = field(default_factory=lambda: np.zeros((4, 2), np.int32))
    dist: FloatArray = field(default_factory=lambda: np.zeros(4))
    frame: FloatArray = field(default_factory=lambda: np.zeros((4, 9)))
    friction: FloatArray = field(default_factory=lambda: np.full((4, 5), 0.5))


def test_contacts_slide_when_friction_times_slip_is_noticeable() -> None:
    slow = [0.0, 0.0, 1e-6]
    fast = [0.0, 0.3, 0.4]

    rows = find_sliding_rows(Contacts(), np.array([9.0, *slow, *fast]))

    assert rows is not None
    assert rows.normals.tolist() == [4]
    assert find_sliding_rows(Contacts(), np.array([9.0, *slow, *slow])) is None


def test_steep_contacts_slide_when_they_slip_faster_than_sticking_ones_creep() -> None:
    creeping, sliding = [0.0, 0.002, 0.0], [0.0, 0.003, 0.0]
    contacts = Contacts(friction=np.full((4, 5), 10.0))

    rows = find_sliding_rows(contacts, np.array([9.0, *creeping, *sliding]))

    assert rows is not None
    assert rows.normals.tolist() == [4]


@given(
    st.lists(st.floats(-2e-5, 2e-5), min_size=7, max_size=7), st.sampled_from([0.5, 0.7, 1.0, 2.0])
)
def test_rows_that_cannot_slide_have_no_contact_that_does(
    velocities: list[float], friction: float
) -> None:
    contacts = Contacts(friction=np.full((4, 5), friction))
    rows = np.array(velocities)

    found = find_sliding_rows(contacts, rows)

    assert found is None or may_slide(rows, friction)


def test_rows_at_rest_cannot_slide() -> None:
    assert not may_slide(np.full(7, 6.9e-6), 1.0)
    assert may_slide(np.full(7, 6.9e-6), 2.0)
    assert not may_slide(np.zeros(0), 1.0)


@pytest.mark.parametrize(("depth", "is_limited"), [(-0.009, False), (-0.011, True), (0.5, False)])
def test_deep_penetrations_are_those_whose_recovery_is_limited(
    depth: float,
    is_limited: bool,  # noqa: FBT001
) -> None:
    assert is_deep(np.array([0.1, depth]), 0.01) == is_limited
    assert not is_deep(np.zeros(0), 0.01)


def test_lift_is_predicted_from_the_slip_after_the_step() -> None:
    now, later = np.array([9.0, 0.0, 0.3, 0.4]), np.array([9.0, 0.0, 0.15, 0.2])

    assert predict_lifts(one_contact(), now, later).tolist() == [0.125]


def test_no_lift_is_predicted_when_the_slip_reverses() -> None:
    now = np.array([0.0, 0.0, 0.3, 0.4])

    assert predict_lifts(one_contact(), now, -now).tolist() == [0.0]


def test_lift_of_a_contact_is_subtracted_from_its_normal() -> None:
    wanted = np.array([7.0, 5.0, -3.0, 4.0])

    LiftIteration(one_contact(), wanted, np.array([0.2]), dt_s=0.1).correct(wanted)

    assert wanted.tolist() == [7.0, 3.0, -3.0, 4.0]


def test_iteration_ends_when_the_slip_is_as_assumed() -> None:
    iteration = LiftIteration(one_contact(), np.zeros(4), np.array([0.25]), dt_s=0.1)

    assert not iteration.refine(np.array([0.0, 0.0, 0.3, 0.4])).any()
    assert iteration.refine(np.array([0.0, 0.0, 0.3, 0.41])).all()


@pytest.mark.parametrize("gain", [0.0, 0.5, 0.89])
def test_iteration_solves_linear_feedback_in_three_solves(gain: float) -> None:
    wanted, dt_s = np.zeros(4), 0.1
    iteration = LiftIteration(one_contact(friction=1.0), wanted, np.array([0.5]), dt_s=dt_s)
    is_done = []

    for _ in range(3):
        wanted[:] = 0.0
        iteration.correct(wanted)
        subtracted = -wanted[1] * dt_s
        is_done.append(
            not iteration.refine(np.array([0.0, 0.0, 0.1 + gain * subtracted, 0.0])).any()
        )

    assert is_done[-1]


def test_compliant_contact_is_at_least_as_compliant_as_a_rigid_one() -> None:
    hard = make_contact_parameters(Contact(stiffness=1e9, damping=1e9), 0.004, 1.0, 1.0)

    assert hard.impedance == make_contact_parameters(Contact(), 0.004, 1.0, 1.0).impedance


@pytest.mark.parametrize("inverse_mass", [0.1, 1.0, 10.0])
def test_links_of_a_robot_have_equally_compliant_contacts(inverse_mass: float) -> None:
    impedance = make_contact_parameters(Contact(), 0.004, inverse_mass, 10.0).impedance

    compliance = (1.0 - impedance) / impedance * inverse_mass
    assert compliance == pytest.approx((1.0 - RIGID_IMPEDANCE) / RIGID_IMPEDANCE / 10.0)


@pytest.mark.parametrize("friction", [10.0, 20.0, 1e5])
def test_friction_is_at_most_10(friction: float) -> None:
    assert make_geom_friction(friction, is_static=False).friction == 10.0


def test_contacts_have_place_normal_depth_and_force() -> None:
    frame = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    contacts = SimpleNamespace(
        dist=np.array([-0.01, 0.002]),
        frame=np.array([frame, frame]),
        pos=np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        efc_address=np.array([0, -1]),
        dim=np.array([3, 3]),
    )

    found = read_contact_points(cast("MjPlacedContacts", contacts), np.array([10.0, 2.0, -1.0]))

    assert found.tolist() == [
        [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.01, 2.0, -1.0, 10.0],
        [4.0, 5.0, 6.0, 0.0, 0.0, 1.0, -0.002, 0.0, 0.0, 0.0],
    ]
