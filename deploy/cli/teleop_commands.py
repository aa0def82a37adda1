"""`zensim teleop`: drive robots by keyboard and gamepad."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import typer

from zensim.deploy.cli.command_session import complete_robots, open_client
from zensim.deploy.cli.driven_robots import find_problem, select_robots, wait_for_subscriber
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.options.command_options import ConnectionOptions, JsonOption, parse_choice
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.raw_terminal import RawTerminal, open_signals
from zensim.proto.security.role_checks import require_access
from zensim.proto.security.roles import Operation
from zensim.proto.topic_catalog import CMD_VEL
from zensim.proto.verbosity import CURRENT, print_announcement, print_note
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.teleop.drive_twists import Speeds, find_drive_style
from zensim.spawner.teleop.gamepad import find_gamepad, open_gamepad
from zensim.spawner.teleop.key_bindings import HELP
from zensim.spawner.teleop.teleop_loop import TeleopLoop, TeleopRobot
from zensim.spawner.teleop.teleop_state import Ending, FocusLoss, TeleopSettings, TeleopState

app = make_app()

FOCUS_LOSS: tuple[FocusLoss, ...] = get_args(FocusLoss)


@dataclass(frozen=True, kw_only=True)
class TeleopOptions(ConnectionOptions):
    """All options of `zensim teleop`."""

    robots: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ROBOT",
            help="Names of robots, or patterns such as 'r*'; the only robot if left out.",
            autocompletion=complete_robots,
        ),
    ] = None
    speed: Annotated[
        float, typer.Option("--speed", metavar="M/S", help=r"Speed ahead and sideways \[m/s].")
    ] = 0.5
    turn: Annotated[
        float,
        typer.Option(
            "--turn",
            metavar="RAD/S",
            help=r"Turn rate \[rad/s]; for robots commanded by steering angle, the angle \[rad].",
        ),
    ] = 1.0
    hold: Annotated[
        float,
        typer.Option(
            "--hold",
            min=0.05,
            max=5.0,
            metavar="SECONDS",
            help=r"How long a key press acts until the terminal repeats it \[s].",
        ),
    ] = 0.6
    gamepad: Annotated[
        str,
        typer.Option(
            "--gamepad", metavar="auto|off|DEVICE", help="Gamepad, such as /dev/input/js0."
        ),
    ] = "auto"
    enable_button: Annotated[
        int | None,
        typer.Option(
            "--enable-button",
            min=0,
            metavar="N",
            help="Button of the gamepad without which its sticks do nothing.",
            show_default="none",
        ),
    ] = None
    focus_loss: Annotated[
        str,
        typer.Option(
            "--focus-loss",
            metavar="end|stop|ignore",
            help="When the terminal loses the focus: end, stop the robots, or go on.",
        ),
    ] = "end"
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim teleop r1
  zensim teleop 'r*' --speed 0.3
  zensim teleop r1 --gamepad /dev/input/js0 --enable-button 5 --focus-loss ignore"""
)
def teleop(given: TeleopOptions) -> None:
    """Drive robots by keyboard and gamepad; Ctrl-C stops them and ends."""
    with open_client("teleop", given) as client:
        settings = _make_settings(given)
        terminal = RawTerminal()
        robots = _advertise(client, given.robots or ())
        state = TeleopState(settings, [robot.style for robot in robots])
        _announce(given, robots)
        # Opened last: its events count from now on.
        gamepad = _open_gamepad(given.gamepad)
        with open_signals() as signals:
            ending = TeleopLoop(terminal, signals, robots, state, gamepad).run()
        _report_end(ending)


def _make_settings(given: TeleopOptions) -> TeleopSettings:
    for option, value in (("--speed", given.speed), ("--turn", given.turn)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{option} must be positive, got {value:g}")
    return TeleopSettings(
        speeds=Speeds(given.speed, given.turn),
        first_hold_s=given.hold,
        focus_loss=parse_choice("--focus-loss", given.focus_loss, FOCUS_LOSS),
        enable_button=given.enable_button,
    )


def _advertise(client: SimClient, patterns: list[str] | tuple[str, ...]) -> list[TeleopRobot]:
    """Declare the publishers of the chosen robots.

    Raises:
        NoSuchRobot: See `select_robots`.
        NoSubscriber: Nothing follows the commands of one of them.
    """
    models = client.models()
    chosen = select_robots(models, [pattern.strip("/") for pattern in patterns])
    wanted = [CMD_VEL.key(robot.namespace) for robot in chosen]
    require_access(client.bus, client.world, Operation.PUBLISH, *wanted)
    return [_advertise_robot(client, models, robot) for robot in chosen]


def _advertise_robot(
    client: SimClient, models: GetModelsResponse, robot: EntityModel
) -> TeleopRobot:
    publisher = client.bus.advertise(CMD_VEL.key(robot.namespace), CMD_VEL.encoding)
    is_matched = bool(robot.agent) and wait_for_subscriber(publisher)
    problem = find_problem(models, robot.namespace, is_matched=is_matched)
    if problem is not None:
        raise problem
    style = find_drive_style(models.models[robot.model].drive)
    return TeleopRobot(robot.namespace, publisher.send, style)


def _open_gamepad(choice: str) -> int | None:
    """Open the gamepad of the option; None if there is none to open."""
    if choice == "off":
        return None
    path = find_gamepad() if choice == "auto" else Path(choice)
    if path is None:
        return None
    descriptor = open_gamepad(path)
    print_note("teleop", f"gamepad {path}")
    return descriptor


def _announce(given: TeleopOptions, robots: list[TeleopRobot]) -> None:
    names = [robot.namespace for robot in robots]
    facts = {"robots": names, "speed": given.speed, "turn": given.turn}
    print_announcement("teleop", f"drives {', '.join(names)}", facts, as_json=given.as_json)
    if not (given.as_json or CURRENT.is_quiet):
        print_lines("\n".join(HELP), err=True)


def _report_end(ending: Ending) -> None:
    if ending == "focus":
        print_note("teleop", "ended: the terminal lost the focus; --focus-loss stop waits for it")
    if ending in ("keys", "signal"):
        raise KeyboardInterrupt
