"""Drive states by robots and in order."""

import msgspec
import pytest

from tests.robot_agent.models import AT_REST, a_state
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.robot_agent.drive_state_decoder import DriveStateLayout, RobotState, StateOrder


def test_layout_splits_a_state_by_robots() -> None:
    state = msgspec.structs.replace(
        a_state(5, (1, 2)),
        joint_positions=a_state(0, positions=(1.0, 2.0, 3.0)).joint_positions,
        joint_velocities=a_state(0, positions=(4.0, 5.0, 6.0)).joint_positions,
    )

    assert DriveStateLayout((1, 2)).split(state) == [
        RobotState(50_000_000, AT_REST, (1.0,), (4.0,)),
        RobotState(50_000_000, AT_REST, (2.0, 3.0), (5.0, 6.0)),
    ]


def test_layout_splits_the_efforts_if_there_are_any() -> None:
    efforts = a_state(0, positions=(7.0, 8.0, 9.0)).joint_positions
    state = msgspec.structs.replace(
        a_state(5, (1, 2), positions=(0.0,) * 3, velocities=(0.0,) * 3), joint_efforts=efforts
    )
    state = msgspec.structs.replace(
        state,
        joint_positions=state.joint_positions[: len(efforts)],
        joint_velocities=state.joint_velocities[: len(efforts)],
    )

    assert [one.efforts for one in DriveStateLayout((1, 2)).split(state)] == [(7.0,), (8.0, 9.0)]


def test_layout_without_robots_splits_an_empty_state() -> None:
    assert DriveStateLayout(()).split(a_state(0, (), positions=(), velocities=())) == []


@pytest.mark.parametrize("field", ["base", "joint_positions", "joint_velocities", "joint_efforts"])
def test_layout_rejects_a_state_of_another_size(field: str) -> None:
    state = msgspec.structs.replace(a_state(5), joint_efforts=a_state(5).joint_positions)
    short = msgspec.structs.replace(state, **{field: getattr(state, field)[:-1]})

    with pytest.raises(MalformedPayload):
        DriveStateLayout((2,)).split(short)


def test_order_is_next_with_each_step() -> None:
    timeline = StateOrder()

    assert [timeline.classify(0, step) for step in (7, 10, 10)] == ["next"] * 3


def test_order_is_next_at_the_first_state() -> None:
    assert StateOrder().classify(4, 0) == "next"


def test_order_is_stale_for_an_older_step() -> None:
    timeline = StateOrder()
    timeline.classify(1, 10)

    assert timeline.classify(1, 9) == "stale"
    assert timeline.classify(0, 11) == "stale"
    assert timeline.classify(1, 11) == "next"


def test_order_is_reset_with_a_higher_epoch() -> None:
    timeline = StateOrder()
    timeline.classify(0, 10)

    assert timeline.classify(1, 0) == "reset"
    assert timeline.classify(1, 1) == "next"


def test_order_accepts_any_state_after_forget() -> None:
    timeline = StateOrder()
    timeline.classify(3, 10)

    timeline.forget()

    assert timeline.classify(0, 0) == "next"
