"""What keys and a gamepad command."""

import pytest

from tests.spawner.teleop.test_gamepad import axis, button
from zensim.proto.terminal_keys import KeyEvent, KeyParser
from zensim.spawner.teleop.drive_twists import DriveStyle, Speeds
from zensim.spawner.teleop.gamepad import FASTER_BUTTON, LEFT_X, LEFT_Y
from zensim.spawner.teleop.key_bindings import (
    AHEAD,
    BACK,
    MOTION_OF_KEY,
    SPEED_OF_KEY,
    STILL,
    TURN_RIGHT,
    Direction,
)
from zensim.spawner.teleop.teleop_state import FocusLoss, TeleopSettings, TeleopState


def a_state(
    style: DriveStyle | None = None, *, focus_loss: FocusLoss = "end", speeds: Speeds | None = None
) -> TeleopState:
    settings = TeleopSettings(focus_loss=focus_loss, speeds=speeds or Speeds())
    return TeleopState(settings, [style or DriveStyle()])


@pytest.mark.parametrize(("key", "direction"), MOTION_OF_KEY.items())
def test_key_commands_its_direction(key: str, direction: Direction) -> None:
    state = a_state()

    state.handle_keys([KeyEvent(key)], 0.0)

    assert state.find_direction(0.0) == direction


@pytest.mark.parametrize("key", [" ", "k", "escape", "unknown", "y"])
def test_any_other_key_stops(key: str) -> None:
    state = a_state()

    state.handle_keys([KeyEvent("w"), KeyEvent(key)], 0.0)

    assert state.find_direction(0.0) == STILL
    assert not state.ending


@pytest.mark.parametrize(("key", "factors"), SPEED_OF_KEY.items())
def test_speed_key_changes_speeds_and_does_not_stop(key: str, factors: tuple[float, float]) -> None:
    state = a_state(speeds=Speeds(1.0, 1.0))

    state.handle_keys([KeyEvent("w"), KeyEvent(key), KeyEvent(key, "release")], 0.0)

    assert state.speeds == Speeds(*factors)
    assert state.find_direction(0.0) == AHEAD


@pytest.mark.parametrize(
    "after",
    [
        pytest.param(b"\x1b[119;5:3u", id="ctrl"),
        pytest.param(b"\x1b[119;3:3u", id="alt"),
        pytest.param(b"\x1b[119;6:3u", id="ctrl and shift"),
    ],
)
def test_key_is_released_after_another_modifier_was_pressed(after: bytes) -> None:
    state, parser = a_state(), KeyParser()

    state.handle_keys(parser.feed(b"\x1b[119;1:1u"), 0.0)
    held = state.find_direction(0.1)
    state.handle_keys(parser.feed(after), 0.2)

    assert (held, state.find_direction(0.2)) == (AHEAD, STILL)


def test_suspend_key_asks_for_it_once_and_stops() -> None:
    state = a_state()

    state.handle_keys([KeyEvent("w"), KeyEvent("ctrl+z")], 0.0)

    assert (state.find_direction(0.0), state.ending) == (STILL, "")
    assert (state.take_suspension(), state.take_suspension()) == (True, False)


@pytest.mark.parametrize("key", ["ctrl+c", "ctrl+d"])
def test_end_key_stops_and_ends(key: str) -> None:
    state = a_state()

    state.handle_keys([KeyEvent("w"), KeyEvent(key)], 0.0)

    assert (state.ending, state.find_direction(0.0)) == ("keys", STILL)


@pytest.mark.parametrize(
    ("choice", "ending", "direction"),
    [("end", "focus", STILL), ("stop", "", STILL), ("ignore", "", AHEAD)],
)
def test_loss_of_focus_does_what_was_chosen(
    choice: FocusLoss, ending: str, direction: Direction
) -> None:
    state = a_state(focus_loss=choice)

    state.handle_keys([KeyEvent("w"), KeyEvent("focus_out"), KeyEvent("focus_in")], 0.0)

    assert (state.ending, state.find_direction(0.0)) == (ending, direction)


def test_gamepad_commands_while_no_key_does() -> None:
    state = a_state()
    state.handle_pad(axis(LEFT_Y, 1.0))
    of_pad = state.find_direction(0.0)

    state.handle_keys([KeyEvent("d")], 0.0)

    assert (of_pad, state.find_direction(0.0)) == (BACK, TURN_RIGHT)


def test_holonomic_robot_moves_sideways_by_the_left_stick() -> None:
    state = a_state(DriveStyle(is_holonomic=True))

    state.handle_pad(axis(LEFT_X, 1.0))

    assert state.find_direction(0.0) == Direction(left=-1.0)


def test_shoulder_button_changes_speeds() -> None:
    state = a_state(speeds=Speeds(1.0, 2.0))

    state.handle_pad(button(FASTER_BUTTON))

    assert state.speeds == Speeds(1.1, 2.2)


def test_lost_gamepad_commands_nothing() -> None:
    state = a_state()
    state.handle_pad(axis(LEFT_Y, -1.0))

    state.lose_pad()

    assert state.find_direction(0.0) == STILL


def test_space_stops_a_deflected_stick() -> None:
    state = a_state()
    state.handle_pad(axis(LEFT_Y, -1.0))

    state.handle_keys([KeyEvent(" ")], 0.0)

    assert state.find_direction(0.0) == STILL
