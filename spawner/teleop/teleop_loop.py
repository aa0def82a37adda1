"""Drives robots from a terminal: publishes while a key or stick acts, and a stop after it."""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Final

import msgspec

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.raw_terminal import RawTerminal, SignalPipe, wait_for_input
from zensim.proto.terminal_keys import KeyParser
from zensim.spawner.teleop.drive_twists import DriveStyle, make_twist
from zensim.spawner.teleop.gamepad import read_gamepad
from zensim.spawner.teleop.key_bindings import Direction
from zensim.spawner.teleop.teleop_state import Ending, TeleopState

PERIOD_S: Final = 0.05
"""Period of commands while a robot moves; a key that is pressed or released acts at once."""
STOPS: Final = 5
"""Times that a stop is published: a congested network drops messages."""
SEND_S: Final = 0.05
"""Time for the session to send what was published, before a signal suspends this process."""


class TeleopRobot(msgspec.Struct, frozen=True):
    """A robot that is driven."""

    namespace: str
    send: Callable[[bytes], object]
    """Publishes a velocity command."""
    style: DriveStyle


class TeleopLoop:
    """Reads terminal, gamepad and signals, and publishes the commands of the robots."""

    def __init__(
        self,
        terminal: RawTerminal,
        signals: SignalPipe,
        robots: Sequence[TeleopRobot],
        state: TeleopState,
        gamepad: int | None,
    ) -> None:
        """Take the parts.

        Args:
            terminal: Of the keys; it is put back at the end.
            signals: Those that end or suspend this process.
            robots: Driven alike.
            state: What the user commands.
            gamepad: Descriptor, which is closed at the end; None = none.
        """
        self._terminal = terminal
        self._signals = signals
        self._robots = robots
        self._state = state
        self._gamepad = gamepad
        self._parser = KeyParser()
        self._sent = Direction()
        self._due_s = 0.0
        self._stops_left = 0
        self._line = ""

    def run(self) -> Ending:
        """Drive until a key, a signal, or the loss of terminal or focus ends it; return which."""
        with ExitStack() as ending:
            ending.callback(self._close_gamepad)
            ending.callback(self._terminal.leave)
            ending.callback(self._stop_robots)
            self._terminal.enter(reports_keys=True)
            while not self._state.ending:
                self._read_inputs()
                self._publish(time.monotonic())
                self._show()
        return self._state.ending

    def _read_inputs(self) -> None:
        sources = [self._terminal.descriptor, self._signals.descriptor]
        if self._gamepad is not None:
            sources.append(self._gamepad)
        ready = wait_for_input(sources, min(PERIOD_S, self._due_s - time.monotonic()))
        if self._signals.descriptor in ready:
            self._handle_signals()
        if self._terminal.descriptor in ready:
            self._read_keys()
        elif self._parser.has_pending:
            self._state.handle_keys(self._parser.flush(), time.monotonic())
        if self._gamepad is not None and self._gamepad in ready:
            self._read_gamepad(self._gamepad)

    def _read_keys(self) -> None:
        data = self._terminal.read()
        if data is None:
            self._state.ending = "terminal"
            return
        self._state.handle_keys(self._parser.feed(data), time.monotonic())
        if self._state.take_suspension():
            self._suspend()

    def _read_gamepad(self, descriptor: int) -> None:
        data = read_gamepad(descriptor)
        if data is None:
            self._state.lose_pad()
            self._close_gamepad()
        else:
            self._state.handle_pad(data)

    def _handle_signals(self) -> None:
        for number in self._signals.take():
            if self._signals.suspends(number):
                self._suspend()
            else:
                self._state.ending = "signal"

    def _suspend(self) -> None:
        """Stop the robots, stop this process, and go on when it is continued."""
        self._state.stop()
        self._stop_robots()
        time.sleep(SEND_S)
        self._terminal.leave()
        self._signals.suspend()
        self._terminal.enter(reports_keys=True)
        self._line = ""

    def _publish(self, now_s: float) -> None:
        direction = self._state.find_direction(now_s)
        is_new = direction != self._sent
        if not is_new and now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S
        if direction:
            self._stops_left = STOPS
        elif not self._stops_left:
            return
        else:
            self._stops_left -= 1
        self._sent = direction
        for robot in self._robots:
            twist = make_twist(direction, self._state.speeds, robot.style)
            robot.send(encode(twist, Format.CDR))

    def _stop_robots(self) -> None:
        payload = encode(Twist(), Format.CDR)
        self._sent, self._stops_left = Direction(), 0
        with ExitStack() as stops:  # each robot gets its own, though that of another fails
            for robot in self._robots:
                for _ in range(STOPS):
                    stops.callback(robot.send, payload)

    def _show(self) -> None:
        speeds, moves = self._state.speeds, self._sent
        line = (
            f"{speeds.linear:.2f} m/s  {speeds.angular:.2f} rad/s   "
            f"ahead {moves.ahead:+.1f}  left {moves.left:+.1f}  turn {moves.turn:+.1f}"
        )
        if line != self._line:
            self._line = line
            self._terminal.show(line)

    def _close_gamepad(self) -> None:
        descriptor, self._gamepad = self._gamepad, None
        if descriptor is not None:
            with suppress(OSError):
                os.close(descriptor)
