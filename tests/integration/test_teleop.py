"""`zensim teleop` in a pseudo-terminal, with a real server and agent: robots stop on every path."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.integration.processes import Server, eventually, running, serving, wait_for_agents
from tests.integration.terminals import Terminal, on_terminal
from tests.spawner.teleop.test_gamepad import axis
from zensim.proto.codec.message_codec import decode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import Odometry, Twist
from zensim.spawner.teleop.gamepad import LEFT_Y

WITHIN_S = 20.0
ENTERED = "\x1b[?1004h"
LEFT_AGAIN = "\x1b[?1004l"
ROBOTS = {"r1": "box_bot", "r2": "box_bot", "car": "car_bot", "omni": "omni_bot"}


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as server:
        for place, (name, model) in enumerate(ROBOTS.items()):
            server.zensim("spawn", model, "-n", name, "-y", str(3 * place))
        with running("agent", "--pool", "0", "--connect", server.endpoint):
            wait_for_agents(server, tuple(ROBOTS))
            yield server


class Commands:
    """The twists that a robot is sent."""

    def __init__(self, server: Server, robot: str) -> None:
        self._subscription = server.bus.subscribe(f"{robot}/cmd_vel", 4096)
        self.twists: list[Twist] = []

    def update(self) -> list[Twist]:
        for sample in self._subscription.take():
            self.twists.append(decode(Twist, sample.payload, sample.encoding))
        return self.twists

    def wait_for(self, accepts: Callable[[Twist], bool]) -> Twist:
        """Wait until the newest command is accepted."""
        eventually(
            lambda: bool(self.update()) and accepts(self.twists[-1]), WITHIN_S, "the command"
        )
        return self.twists[-1]

    def wait_for_stop(self) -> None:
        self.wait_for(lambda twist: twist == Twist())


def is_motion(twist: Twist) -> bool:
    return twist != Twist()


@contextmanager
def teleop(server: Server, *arguments: str) -> Iterator[Terminal]:
    with on_terminal(server, "teleop", *arguments) as terminal:
        terminal.wait_for(ENTERED)
        yield terminal


@contextmanager
def moving(server: Server, *arguments: str) -> Iterator[tuple[Terminal, Commands]]:
    """Drive r1 ahead by a key that its terminal reports as held, as long as it repeats."""
    commands = Commands(server, "r1")
    with teleop(server, "r1", "--hold", "5", *arguments) as terminal:
        terminal.type("w")
        commands.wait_for(is_motion)
        yield terminal, commands


def test_key_moves_the_robot_and_stops_it_when_it_is_not_repeated(server: Server) -> None:
    commands = Commands(server, "r1")
    with teleop(server, "r1", "--speed", "0.3") as terminal:
        terminal.type("w")
        moved = commands.wait_for(is_motion)
        commands.wait_for_stop()

    assert moved.linear.x == 0.3


@pytest.mark.parametrize(
    ("keys", "status"),
    [("\x1b[99;5u", ExitCode.INTERRUPTED), ("\x1b[O", ExitCode.OK)],
    ids=["ctrl-c reported as a key", "focus lost"],
)
def test_robot_stops_when_keys_end_it(server: Server, keys: str, status: ExitCode) -> None:
    with moving(server) as (terminal, commands):
        terminal.type(keys)

        assert terminal.status() == status
        commands.wait_for_stop()
        terminal.wait_for(LEFT_AGAIN)


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_robot_stops_when_a_signal_ends_it(server: Server, name: str) -> None:
    with moving(server) as (terminal, commands):
        terminal.process.send_signal(signal.Signals[name])

        assert terminal.status() == ExitCode.INTERRUPTED
        commands.wait_for_stop()
        terminal.wait_for(LEFT_AGAIN)


def test_robot_stops_when_the_terminal_is_closed(server: Server) -> None:
    with moving(server) as (terminal, commands):
        terminal.close()

        commands.wait_for_stop()
        assert terminal.process.wait(WITHIN_S) == ExitCode.OK


def test_robot_stops_when_it_is_suspended_and_moves_again_after_it(server: Server) -> None:
    with moving(server) as (terminal, commands):
        terminal.process.send_signal(signal.SIGTSTP)
        commands.wait_for_stop()
        terminal.wait_for(LEFT_AGAIN)
        terminal.process.send_signal(signal.SIGCONT)

        terminal.type("w")
        commands.wait_for(is_motion)


def test_robot_stops_when_the_program_is_killed(server: Server) -> None:
    odometry = server.bus.subscribe("r1/odom")

    def speed() -> float | None:
        sample = odometry.newest()
        if sample is None:
            return None
        return decode(Odometry, sample.payload, sample.encoding).twist.twist.linear.x

    with moving(server) as (terminal, _):
        eventually(lambda: (speed() or 0.0) > 0.3, WITHIN_S, "motion")
        terminal.process.kill()

        eventually(lambda: abs(found) < 0.01 if (found := speed()) is not None else None, WITHIN_S)


def test_robots_stop_and_wait_for_the_focus_where_that_was_chosen(server: Server) -> None:
    with moving(server, "--focus-loss", "stop") as (terminal, commands):
        terminal.type("\x1b[O")
        commands.wait_for_stop()
        terminal.type("\x1b[Iw")

        commands.wait_for(is_motion)


def test_released_key_stops_at_once_where_the_terminal_reports_it(server: Server) -> None:
    commands = Commands(server, "r1")
    with teleop(server, "r1") as terminal:
        terminal.type("\x1b[119;1:1u")
        commands.wait_for(is_motion)
        terminal.type("\x1b[119;1:3u")

        commands.wait_for_stop()


def test_pattern_drives_all_robots_that_it_fits(server: Server) -> None:
    both, other = [Commands(server, name) for name in ("r1", "r2")], Commands(server, "car")
    with teleop(server, "r*", "--hold", "5") as terminal:
        terminal.type("a")
        for one in both:
            assert one.wait_for(is_motion).angular.z == 1.0
        terminal.type("\x03")
        assert terminal.status() == ExitCode.INTERRUPTED

    for one in both:
        one.wait_for_stop()
    assert other.update() == []


def test_holonomic_robot_moves_sideways(server: Server) -> None:
    commands = Commands(server, "omni")
    with teleop(server, "omni") as terminal:
        terminal.type("A")

        assert commands.wait_for(is_motion).linear.y == 0.5


def test_steered_robot_is_steered_within_its_limit_while_it_moves(server: Server) -> None:
    commands = Commands(server, "car")
    with teleop(server, "car", "--hold", "5", "--turn", "1.5") as terminal:
        terminal.type("w")
        commands.wait_for(is_motion)
        terminal.type("a")
        steered = commands.wait_for(lambda twist: bool(twist.angular.z))

        assert steered.linear.x == 0.5
        assert 0.0 < steered.angular.z < 1.5


def test_gamepad_drives_until_it_is_gone(server: Server, tmp_path: Path) -> None:
    device = tmp_path / "js0"
    os.mkfifo(device)
    commands = Commands(server, "r1")
    # Open for both, so that neither side waits for the other.
    writer = os.open(device, os.O_RDWR)
    try:
        with teleop(server, "r1", "--gamepad", str(device)) as terminal:
            os.write(writer, axis(LEFT_Y, -1.0))
            moved = commands.wait_for(is_motion)
            os.close(writer)
            writer = -1
            commands.wait_for_stop()
            terminal.type("w")
            commands.wait_for(is_motion)
    finally:
        if writer >= 0:
            os.close(writer)

    assert moved.linear.x == 0.5


def test_unknown_robot_is_refused_with_names_like_it(server: Server) -> None:
    with on_terminal(server, "teleop", "cra") as terminal:
        assert terminal.status() == ExitCode.NOT_FOUND
        terminal.wait_for("the robots are car, ")


def test_which_robot_is_asked_where_there_are_several(server: Server) -> None:
    with on_terminal(server, "teleop") as terminal:
        assert terminal.status() == ExitCode.NOT_FOUND


def test_input_that_is_no_terminal_is_refused(server: Server) -> None:
    done = server.zensim("teleop", "r1")

    assert done.returncode == ExitCode.USAGE
    assert "zensim drive" in done.stderr
