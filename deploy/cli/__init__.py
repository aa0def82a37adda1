"""`zensim`: the command line; a verb's module is imported only when the verb is called.

The host of an agent has neither pybullet nor viser, so nothing here may import them. Help and
version need no typer either, whose import takes longer than they do.
"""

import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypeVar

from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.setting_variables import has_variables

if TYPE_CHECKING:
    import typer

Options = TypeVar("Options")


class Verb(NamedTuple):
    """One command or group of commands."""

    panel: str
    """Title of its section in the help text."""
    module: str
    """Module of its typer app, in this folder."""
    summary: str


VERBS: dict[str, Verb] = {
    "up": Verb(
        "Programs", "up_commands", "Start a server, robots, agents and the viewer on this host."
    ),
    "down": Verb("Programs", "down_commands", "End what 'zensim up' runs on this host."),
    "serve": Verb("Programs", "serve_commands", "Start a simulation server."),
    "router": Verb("Programs", "router_commands", "Start a Zenoh router."),
    "token": Verb(
        "Programs",
        "token_commands",
        "Create, list, revoke and show join tokens of a secured server.",
    ),
    "join": Verb(
        "Programs", "join_commands", "Keep a join token for later connections to its server."
    ),
    "agent": Verb(
        "Programs", "agent_commands", "Drive robots: subscribe to cmd_vel, publish odom and tf."
    ),
    "sensors": Verb(
        "Programs",
        "sensor_program",
        "List sensors, or run a process that publishes lidars and cameras.",
    ),
    "view": Verb("Programs", "page_program", "Serve a web page that shows the world in 3D."),
    "spawn": Verb("Entities", "spawn_commands", "Spawn one robot or object."),
    "fleet": Verb("Entities", "spawn_commands", "Spawn several robots of one model."),
    "list": Verb("Entities", "entity_commands", "List entities."),
    "inspect": Verb("Entities", "entity_commands", "Show the details of one entity."),
    "delete": Verb("Entities", "entity_commands", "Delete entities."),
    "set": Verb(
        "Entities",
        "set_commands",
        "Set pose, velocity, category, tags or description of an entity.",
    ),
    "map": Verb("Simulation", "map_commands", "Write a map of the world for Nav2's map_server."),
    "pause": Verb("Simulation", "simulation_commands", "Pause the simulation."),
    "play": Verb("Simulation", "simulation_commands", "Start or resume the simulation."),
    "stop": Verb(
        "Simulation",
        "simulation_commands",
        "Reset the simulation, delete spawned entities, and stop.",
    ),
    "reset": Verb(
        "Simulation", "simulation_commands", "Reset time, entity states and spawned entities."
    ),
    "step": Verb(
        "Simulation", "simulation_commands", "Advance a paused simulation by a number of steps."
    ),
    "run-to": Verb(
        "Simulation", "simulation_commands", "Advance a paused simulation to a given time."
    ),
    "rtf": Verb("Simulation", "simulation_commands", "Get or set the target real-time factor."),
    "world": Verb("Simulation", "inspect_commands", "Load, unload, list and inspect worlds."),
    "drive": Verb("Topics", "topic_commands", "Publish velocity commands to a robot."),
    "teleop": Verb("Topics", "teleop_commands", "Drive robots by keyboard and gamepad."),
    "topic": Verb(
        "Topics", "topic_group_commands", "List, inspect, print, measure and publish topics."
    ),
    "echo": Verb("Topics", "topic_commands", "Print the messages of a topic."),
    "hz": Verb("Topics", "topic_commands", "Measure the message rate of a topic."),
    "foxglove": Verb("Programs", "foxglove_commands", "Serve the topics of a world to Foxglove."),
    "vda5050": Verb(
        "Programs", "vda_commands", "Serve robots as VDA 5050 vehicles to a fleet manager, by MQTT."
    ),
    "record": Verb("Recordings", "record_commands", "Record topics to MCAP files."),
    "replay": Verb("Recordings", "replay_commands", "Publish a recording again, with a clock."),
    "bag": Verb("Recordings", "bag_commands", "Inspect and recover recordings."),
    "resim": Verb(
        "Recordings",
        "resim_commands",
        "Run a recording again in the engine, and compare the states.",
    ),
    "features": Verb("Diagnostics", "simulation_commands", "List the features of the server."),
    "top": Verb(
        "Diagnostics",
        "top_commands",
        "Show robots and processes: rates, real-time factor, CPU time, memory.",
    ),
    "stats": Verb(
        "Diagnostics", "simulation_commands", "Print the counts and times of the server."
    ),
    "doctor": Verb("Diagnostics", "doctor_commands", "Diagnose connection problems."),
    "model": Verb(
        "Diagnostics",
        "model_commands",
        "Parse a robot description and print the result, without a server.",
    ),
    "check": Verb(
        "Diagnostics",
        "check_commands",
        "Spawn and drive the robots of a folder, and print what they do.",
    ),
    "test": Verb(
        "Scenarios", "scenario_test_commands", "Run scenario files and report their checks."
    ),
    "sweep": Verb(
        "Scenarios", "sweep_commands", "Run a scenario with many values, seeds and repeats."
    ),
    "scenario": Verb(
        "Scenarios",
        "scenario_commands",
        "Check scenario files, print their schema, list the shipped ones.",
    ),
    "export": Verb("Scenarios", "export_commands", "Write a running world as a scenario file."),
    "journal": Verb("Diagnostics", "journal_commands", "Show, verify or export a server journal."),
    "config": Verb(
        "Diagnostics",
        "config_commands",
        "Show the settings of a command, and where they come from.",
    ),
    "version": Verb("Diagnostics", "version_commands", "Print the versions of all parts."),
}

GROUPS = frozenset({"token", "world", "topic", "bag", "scenario", "config"})
"""Verbs that need a second word, so that they have no settings; known without their modules."""

HELP_HEAD = """Usage: zensim [OPTIONS] COMMAND [ARGS]...

Multi-robot simulation over Zenoh, without ROS or Gazebo.
"""
HELP_OPTIONS = (
    ("--version", "Print the version and exit."),
    ("--install-completion", "Install completion for the current shell."),
    ("--show-completion", "Print the completion script of the current shell."),
    ("-h, --help", "Print this text and exit."),
)
HELP_END = "Run 'zensim COMMAND --help' for the options of a command."
NAME_WIDTH = 22


def format_help() -> str:
    """Format the help text of `zensim`: options, then each verb in its section."""
    lines = [HELP_HEAD, "Options:", *(_format_row(*row) for row in HELP_OPTIONS)]
    for panel in dict.fromkeys(verb.panel for verb in VERBS.values()):
        rows = (
            _format_row(name, verb.summary) for name, verb in VERBS.items() if verb.panel == panel
        )
        lines += ["", f"{panel}:", *rows]
    return "\n".join([*lines, "", HELP_END])


def _format_row(name: str, summary: str) -> str:
    return f"  {name:<{NAME_WIDTH}}{summary}"


def print_version() -> None:
    """Print the version of the installed package."""
    # Slow to import, and needed here only.
    from importlib.metadata import version

    print(f"zensim {version('zensim')}")


def build(called: str) -> "typer.Typer":
    """Build the command line with one verb loaded; the others have their help line only."""
    import typer

    from zensim.deploy.cli.command_settings import SettingsGroup

    class RootGroup(SettingsGroup):
        """The verbs, with the help text of this module."""

        def format_help(self, *_: object) -> None:
            # Printed at once, as typer does: it drops the text of a call without arguments.
            print(format_help())

    def root_options(
        *,
        version: Annotated[
            bool, typer.Option("--version", metavar="", help="Print the version and exit.")
        ] = False,
    ) -> None:
        if version:
            print_version()
            raise typer.Exit

    app = typer.Typer(
        add_completion=True,
        cls=RootGroup,
        context_settings={"help_option_names": ["-h", "--help"]},
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    app.callback(invoke_without_command=True)(root_options)
    for name, verb in VERBS.items():
        if name == called:
            _add_verb(app, name, verb)
        else:
            app.command(name, help=verb.summary, rich_help_panel=verb.panel)(_not_loaded)
    return app


def _add_verb(app: "typer.Typer", name: str, verb: Verb) -> None:
    """Add a command of a module; an app that has the name of the verb is a group of commands."""
    loaded: typer.Typer = importlib.import_module(f"{__name__}.{verb.module}").app
    if loaded.info.name == name:
        app.add_typer(loaded, name=name, help=verb.summary, rich_help_panel=verb.panel)
        return
    for command in loaded.registered_commands:
        callback_name = command.callback.__name__ if command.callback else ""
        if (command.name or callback_name) == name:
            app.registered_commands.append(command)
            return
    raise LookupError(f"{verb.module} has no command '{name}'")


def _not_loaded() -> None:
    """Stand in for a verb that was not called."""


def _find_verb(arguments: Sequence[str], environment: Mapping[str, str]) -> str:
    """Find the verb in the arguments, or in the line to complete if a shell requests completion."""
    line = environment.get("_TYPER_COMPLETE_ARGS") or environment.get("COMP_WORDS")
    if "_ZENSIM_COMPLETE" in environment and line:
        arguments = line.split()[1:]
    return next((word for word in arguments if not word.startswith("-")), "")


def main() -> None:
    """Run the command line."""
    die_with_supervisor(os.environ)
    arguments = sys.argv[1:]
    if "_ZENSIM_COMPLETE" not in os.environ and arguments == ["--version"]:
        print_version()
    elif "_ZENSIM_COMPLETE" not in os.environ and arguments in ([], ["--help"], ["-h"]):
        print(format_help())
        sys.exit(0 if arguments else 2)
    elif "_ZENSIM_COMPLETE" in os.environ or not _run_plainly(arguments):
        from zensim.proto.exit_codes import exit_on_closed_pipe

        with exit_on_closed_pipe():
            build(_find_verb(arguments, os.environ))(prog_name="zensim")


def _run_plainly(arguments: Sequence[str]) -> bool:
    """Run a command if its options can be parsed without typer; say whether it ran."""
    if not arguments or has_variables(arguments[0], os.environ):
        return False
    if arguments[:1] == ["model"]:
        from zensim.deploy.cli.model_commands import ModelOptions, print_model

        return _run_with_options(ModelOptions, print_model, arguments[1:])
    if arguments[:1] == ["record"]:
        from zensim.deploy.cli.record_commands import RecordOptions, record_topics

        # The libraries by which typer converts values have a fifth of its memory.
        return _run_with_options(RecordOptions, record_topics, arguments[1:])
    return False


def _run_with_options(
    group: type[Options], run: Callable[[Options], None], words: Sequence[str]
) -> bool:
    from zensim.proto.options.option_groups import name_group
    from zensim.proto.options.plain_options import parse_plain_options
    from zensim.proto.verbosity import CURRENT

    given = parse_plain_options(group, words, os.environ)
    if given is not None:
        CURRENT.options, CURRENT.is_json = name_group(group), getattr(given, "as_json", False)
        run(given)
    return given is not None
