"""The end of driving, where the last stop cannot be published."""

import os
from typing import TYPE_CHECKING, cast

import pytest

from zensim.spawner.teleop.drive_twists import DriveStyle
from zensim.spawner.teleop.teleop_loop import TeleopLoop, TeleopRobot
from zensim.spawner.teleop.teleop_state import TeleopSettings, TeleopState

if TYPE_CHECKING:
    from zensim.proto.raw_terminal import RawTerminal, SignalPipe


class ClosedPublisher:
    """A publisher of a session that is closed."""

    def send(self, payload: bytes) -> None:
        raise RuntimeError(f"the session is closed: {len(payload)} bytes")


class CountingPublisher:
    """Counts messages."""

    def __init__(self) -> None:
        self.count = 0

    def send(self, payload: bytes) -> None:
        assert payload
        self.count += 1


class FakeTerminal:
    """Whether the terminal is raw."""

    def __init__(self) -> None:
        self.is_raw = False

    def enter(self, *, reports_keys: bool) -> None:
        self.is_raw = reports_keys

    def leave(self) -> None:
        self.is_raw = False


def test_terminal_is_put_back_and_other_robots_stop_if_a_stop_fails() -> None:
    terminal, working = FakeTerminal(), CountingPublisher()
    reader, gamepad = os.pipe()
    style = DriveStyle()
    state = TeleopState(TeleopSettings(), [style])
    state.ending = "keys"
    robots = [
        TeleopRobot("r1", ClosedPublisher().send, style),
        TeleopRobot("r2", working.send, style),
    ]
    loop = TeleopLoop(
        cast("RawTerminal", terminal), cast("SignalPipe", None), robots, state, gamepad
    )

    with pytest.raises(RuntimeError):
        loop.run()

    os.close(reader)
    assert not terminal.is_raw
    assert working.count > 0
    with pytest.raises(OSError, match="descriptor"):
        os.fstat(gamepad)
