"""Gamepads: events of the joystick interface, from a real FIFO or file."""

import os
from pathlib import Path

import pytest

from zensim.spawner.teleop.gamepad import (
    AXIS,
    BUTTON,
    EVENT,
    FULL,
    LEFT_X,
    LEFT_Y,
    PAD_Y,
    RIGHT_X,
    STOP_BUTTON,
    PadState,
    open_gamepad,
    read_gamepad,
)
from zensim.spawner.teleop.key_bindings import STILL, Direction


def axis(number: int, share: float) -> bytes:
    return EVENT.pack(0, round(share * FULL), AXIS, number)


def button(number: int, *, is_down: bool = True) -> bytes:
    return EVENT.pack(0, int(is_down), BUTTON, number)


def state(kind: int, number: int, value: int) -> bytes:
    """What Linux sends for each axis and button when it is opened, and after lost events."""
    return EVENT.pack(0, value, kind | 0x80, number)


def test_stick_ahead_is_ahead() -> None:
    pad = PadState()

    pad.feed(axis(LEFT_Y, -1.0))

    assert pad.find_direction(is_holonomic=False) == Direction(ahead=1.0)


@pytest.mark.parametrize(
    ("is_holonomic", "direction"), [(False, Direction(turn=1.0)), (True, Direction(left=1.0))]
)
def test_left_stick_turns_or_moves_sideways(*, is_holonomic: bool, direction: Direction) -> None:
    pad = PadState()

    pad.feed(axis(LEFT_X, -1.0))

    assert pad.find_direction(is_holonomic=is_holonomic) == direction


def test_right_stick_turns() -> None:
    pad = PadState()

    pad.feed(axis(RIGHT_X, 1.0))

    assert pad.find_direction(is_holonomic=True) == Direction(turn=-1.0)


def test_cross_moves_as_the_stick_does() -> None:
    pad = PadState()

    pad.feed(axis(PAD_Y, 1.0))

    assert pad.find_direction(is_holonomic=False) == Direction(ahead=-1.0)


def test_stick_nearly_at_rest_is_at_rest() -> None:
    pad = PadState()

    pad.feed(axis(LEFT_Y, 0.09) + axis(LEFT_X, -0.09))

    assert pad.find_direction(is_holonomic=False) == STILL


def test_states_from_before_it_was_opened_do_nothing() -> None:
    pad = PadState()

    pad.feed(state(AXIS, LEFT_Y, -FULL))

    assert pad.find_direction(is_holonomic=False) == STILL


def test_stick_that_was_held_when_it_was_opened_acts_after_it_was_at_rest() -> None:
    pad = PadState()
    pad.feed(state(AXIS, LEFT_Y, -FULL))

    pad.feed(axis(LEFT_Y, 0.0))
    pad.find_direction(is_holonomic=False)
    pad.feed(axis(LEFT_Y, -1.0))

    assert pad.find_direction(is_holonomic=False) == Direction(ahead=1.0)


@pytest.mark.parametrize(("share", "ahead"), [(0.0, 0.0), (1.0, -1.0)])
def test_states_after_lost_events_replace_what_was_known(share: float, ahead: float) -> None:
    pad = PadState(enable_button=5)
    pad.feed(button(5) + axis(LEFT_Y, -1.0))
    before = pad.find_direction(is_holonomic=False)

    pressed = pad.feed(state(BUTTON, 5, 1) + state(AXIS, LEFT_Y, round(share * FULL)))

    assert before == Direction(ahead=1.0)
    assert pad.find_direction(is_holonomic=False) == Direction(ahead=ahead)
    assert pressed == []


def test_button_whose_release_was_lost_is_not_held() -> None:
    pad = PadState(enable_button=5)
    pad.feed(button(5) + axis(LEFT_Y, -1.0))

    pad.feed(state(BUTTON, 5, 0) + state(AXIS, LEFT_Y, -FULL))

    assert pad.find_direction(is_holonomic=False) == STILL


def test_events_may_be_cut_anywhere() -> None:
    pad, data = PadState(), axis(LEFT_Y, -1.0) + button(3)

    pressed = [one for byte in data for one in pad.feed(bytes([byte]))]

    assert pressed == [3]
    assert pad.find_direction(is_holonomic=False) == Direction(ahead=1.0)


def test_stop_button_stops_until_the_sticks_were_at_rest() -> None:
    pad = PadState()
    pad.feed(axis(LEFT_Y, -1.0) + button(STOP_BUTTON))
    stopped = pad.find_direction(is_holonomic=False)

    pad.feed(axis(LEFT_Y, 0.0))
    pad.find_direction(is_holonomic=False)
    pad.feed(axis(LEFT_Y, -1.0))

    assert stopped == STILL
    assert pad.find_direction(is_holonomic=False) == Direction(ahead=1.0)


def test_sticks_act_only_while_the_enable_button_is_held() -> None:
    pad = PadState(enable_button=5)
    pad.feed(axis(LEFT_Y, -1.0))
    before = pad.find_direction(is_holonomic=False)
    pad.feed(button(5))
    held = pad.find_direction(is_holonomic=False)
    pad.feed(button(5, is_down=False))

    assert (before, held) == (STILL, Direction(ahead=1.0))
    assert pad.find_direction(is_holonomic=False) == STILL


def test_fifo_is_read_until_its_writer_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "js0"
    os.mkfifo(path)
    descriptor = open_gamepad(path)
    try:
        with path.open("wb") as writer:
            silent = read_gamepad(descriptor)
            writer.write(axis(LEFT_Y, -1.0))
            writer.flush()
            sent = read_gamepad(descriptor)
        gone = read_gamepad(descriptor)
    finally:
        os.close(descriptor)

    assert (silent, sent, gone) == (b"", axis(LEFT_Y, -1.0), None)
