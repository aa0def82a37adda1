"""Drive states, cut and put in order."""

import msgspec
import pytest

from tests.robot_agent.models import AT_REST, a_state
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.robot_agent.drive_state_decoder import DriveStateLayout, RobotState, StateOrder


def test_layout_cuts_a_state_robot_by_robot() -> None:
    state = msgspec.structs.replace(
        a_state(5, (1, 2)),
        joint_positions=a_state(0, positions=(1.0, 2.0, 3.0)).joint_positions,
        joint_velocities=a_state(0, positions=(4.0, 5.0, 6.0)).joint_positions,
    )

    assert DriveStateLayout((1, 2)).split(state) == [
        RobotState(50_000_000, AT_REST, (1.0,), (4.0,)),
        RobotState(50_000_000, AT_REST, (2.0, 3.0), (5.0, 6.0)),
    ]


def test_layout_cuts_nothing_when_there_are_no_robots() -> None:
    assert DriveStateLayout(()).split(a_state(0, (), positions=(), velocities=())) == []


@pytest.mark.parametrize("field", ["base", "joint_positions", "joint_velocities"])
def test_layout_refuses_a_state_that_does_not_fit(field: str) -> None:
    state = a_state(5)
    short = msgspec.structs.replace(state, **{field: getattr(state, field)[:-1]})

    with pytest.raises(MalformedPayload):
        DriveStateLayout((2,)).split(short)


def test_timeline_goes_on_with_each_step() -> None:
    timeline = StateOrder()

    assert [timeline.place(0, step) for step in (7, 10, 10)] == ["next"] * 3


def test_timeline_has_no_reset_at_its_first_state() -> None:
    assert StateOrder().place(4, 0) == "next"


def test_timeline_calls_a_step_back_stale() -> None:
    timeline = StateOrder()
    timeline.place(1, 10)

    assert timeline.place(1, 9) == "stale"
    assert timeline.place(0, 11) == "stale"
    assert timeline.place(1, 11) == "next"


def test_timeline_goes_back_with_a_higher_epoch() -> None:
    timeline = StateOrder()
    timeline.place(0, 10)

    assert timeline.place(1, 0) == "reset"
    assert timeline.place(1, 1) == "next"


def test_timeline_takes_anything_after_it_forgot() -> None:
    timeline = StateOrder()
    timeline.place(3, 10)

    timeline.forget()

    assert timeline.place(0, 0) == "next"
