"""Which keys act, with and without reports of releases."""

import pytest

from zensim.proto.terminal_keys import KeyEvent
from zensim.spawner.teleop.held_keys import FIRST_HOLD_S, REPEAT_HOLD_S, SILENCE_S, HeldKeys
from zensim.spawner.teleop.key_bindings import AHEAD, LEFT, STILL, TURN_LEFT, Direction


def press(key: str) -> KeyEvent:
    return KeyEvent(key)


def test_press_acts_until_the_first_repeat_would_come() -> None:
    keys = HeldKeys()

    keys.handle(press("w"), 1.0)

    assert keys.find_direction(1.0 + FIRST_HOLD_S) == AHEAD
    assert keys.find_direction(1.01 + FIRST_HOLD_S) == STILL


def test_held_key_acts_for_a_few_repeats_after_the_last() -> None:
    keys = HeldKeys()
    keys.handle(press("w"), 0.0)

    for number in range(20):
        keys.handle(press("w"), 0.5 + number * 0.033)

    last_s = 0.5 + 19 * 0.033
    assert keys.find_direction(last_s + REPEAT_HOLD_S - 0.001) == AHEAD
    assert keys.find_direction(last_s + REPEAT_HOLD_S + 0.001) == STILL


def test_another_key_replaces_the_first_where_releases_are_unknown() -> None:
    keys = HeldKeys()
    keys.handle(press("w"), 0.0)

    keys.handle(press("a"), 0.1)

    assert keys.find_direction(0.1) == TURN_LEFT


def test_steered_robot_keeps_moving_while_it_is_steered() -> None:
    keys = HeldKeys(is_steered=True)
    keys.handle(press("w"), 0.0)

    keys.handle(press("a"), 0.1)
    steered = keys.find_direction(0.1)
    keys.handle(press("w"), 0.2)

    assert steered == Direction(ahead=1.0, turn=1.0)
    assert keys.find_direction(0.2) == AHEAD


def test_steered_robot_at_rest_only_turns_its_wheels() -> None:
    keys = HeldKeys(is_steered=True)

    keys.handle(press("a"), 0.0)

    assert keys.find_direction(0.0) == TURN_LEFT


def test_keys_with_releases_add_up_until_they_are_released() -> None:
    keys = HeldKeys()
    keys.handle(KeyEvent("w", has_release=True), 0.0)
    keys.handle(KeyEvent("a", has_release=True), 0.1)

    both = keys.find_direction(0.2)
    keys.handle(KeyEvent("w", "release", has_release=True), 0.3)

    assert both == Direction(ahead=1.0, turn=1.0)
    assert keys.find_direction(0.3) == TURN_LEFT


def test_first_arrow_is_released_although_its_press_said_nothing_of_releases() -> None:
    keys = HeldKeys()
    keys.handle(press("up"), 0.0)

    keys.handle(KeyEvent("up", "release", has_release=True), 0.1)

    assert keys.find_direction(0.1) == STILL


def test_letter_is_released_after_shift_was() -> None:
    keys = HeldKeys()
    keys.handle(KeyEvent("A", has_release=True), 0.0)
    held = keys.find_direction(0.1)

    keys.handle(KeyEvent("a", "release", has_release=True), 0.2)

    assert held == LEFT
    assert keys.find_direction(0.2) == STILL


@pytest.mark.parametrize(
    ("pressed", "released"),
    [("shift+up", "up"), ("up", "shift+up"), ("<", ","), (",", "<"), (">", "."), ("d", "D")],
)
def test_key_is_released_after_shift_has_changed(pressed: str, released: str) -> None:
    keys = HeldKeys()
    keys.handle(KeyEvent(pressed, has_release=True), 0.0)

    keys.handle(KeyEvent(released, "release", has_release=True), 0.2)

    assert keys.find_direction(0.2) == STILL


def test_keys_without_any_event_stop_acting() -> None:
    keys = HeldKeys()
    keys.handle(KeyEvent("w", has_release=True), 0.0)

    assert keys.find_direction(SILENCE_S) == AHEAD
    assert keys.find_direction(SILENCE_S + 0.01) == STILL


@pytest.mark.parametrize("has_release", [False, True])
def test_release_of_all_keys_stops(*, has_release: bool) -> None:
    keys = HeldKeys()
    keys.handle(KeyEvent("w", has_release=has_release), 0.0)

    keys.release_all()

    assert keys.find_direction(0.0) == STILL
