"""`zensim`: one command over all programs; each is imported only when it is called.

An agent's host has neither pybullet nor viser: nothing here may import them.
"""

import importlib
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from zensim.proto.process_limits import die_with_supervisor

VERBS: dict[str, tuple[str, str]] = {
    "up": (
        "zensim.deploy.cli.up_commands",
        "Run a world, its robots, their agents and the page, all on this machine.",
    ),
    "serve": ("zensim.sim_server.cli", "Run a world and serve it on the network."),
    "router": (
        "zensim.deploy.cli.router_commands",
        "Run the router alone, for servers and agents to join.",
    ),
    "spawn": ("zensim.spawner.cli.spawn_commands", "Put one robot into the world."),
    "fleet": ("zensim.spawner.cli.spawn_commands", "Put many robots into the world."),
    "agent": ("zensim.robot_agent.cli", "Drive robots: cmd_vel in, odom and tf out."),
    "drive": ("zensim.spawner.cli.topic_commands", "Send a robot velocity commands."),
    "echo": ("zensim.spawner.cli.topic_commands", "Print what is published on a key."),
    "hz": (
        "zensim.spawner.cli.topic_commands",
        "Measure how often something is published on a key.",
    ),
    "list": ("zensim.spawner.cli.list_commands", "List the entities of the world."),
    "inspect": ("zensim.spawner.cli.entity_commands", "Show one entity."),
    "delete": ("zensim.spawner.cli.entity_commands", "Take entities out of the world."),
    "state": ("zensim.spawner.cli.state_commands", "Tell where an entity is, or put it somewhere."),
    "info": ("zensim.spawner.cli.info_commands", "Tell what an entity is, or say it."),
    "pause": ("zensim.spawner.cli.simulation_commands", "Let time stand."),
    "play": ("zensim.spawner.cli.simulation_commands", "Let time run."),
    "stop": (
        "zensim.spawner.cli.simulation_commands",
        "Let time stand at the start: what was spawned goes.",
    ),
    "step": ("zensim.spawner.cli.simulation_commands", "Make steps of a paused world."),
    "run-to": (
        "zensim.spawner.cli.simulation_commands",
        "Make steps until a simulation time is reached.",
    ),
    "speed": ("zensim.spawner.cli.simulation_commands", "Choose the real-time factor to hold."),
    "reset": ("zensim.spawner.cli.simulation_commands", "Go back to the start."),
    "world": ("zensim.spawner.cli.world_commands", "Load, list or unload worlds."),
    "features": ("zensim.spawner.cli.simulation_commands", "List what the server can do."),
    "doctor": ("zensim.spawner.cli.doctor_commands", "Say what is wrong when nothing answers."),
    "view": ("zensim.spawner.cli.view_commands", "Show the world on a 3D page."),
    "journal": (
        "zensim.deploy.cli.journal_commands",
        "Show, verify or export what a server keeps.",
    ),
    "model": (
        "zensim.deploy.cli.model_commands",
        "Show what a description says, without any server.",
    ),
}
"""Verb to the module of its typer app, and the line that help shows without importing it."""


def build(called: str) -> typer.Typer:
    """Make the command line with one verb loaded; of the others only the help line is there."""
    app = typer.Typer(
        add_completion=True,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        help="Many robots in one simulated world, over Zenoh, without ROS or Gazebo.",
    )
    app.callback(invoke_without_command=True)(_root_options)
    for verb, (module, line) in VERBS.items():
        if verb == called:
            _add_verb(app, module, verb, line)
        else:
            app.command(verb, help=line)(_not_loaded)
    return app


def _add_verb(app: typer.Typer, module: str, verb: str, line: str) -> None:
    """Add a command of a module; a module whose app has the verb's name is a group of commands."""
    found: typer.Typer = importlib.import_module(module).app
    if found.info.name == verb:
        app.add_typer(found, name=verb, help=line)
        return
    for command in found.registered_commands:
        name = command.name or (command.callback.__name__ if command.callback else "")
        if name == verb:
            app.registered_commands.append(command)
            return
    raise LookupError(f"{module} has no command '{verb}'")


def _not_loaded() -> None:
    """Stand in for a verb that was not called."""


def _root_options(
    *, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
) -> None:
    if version:
        # Slow to load, and no other command needs it.
        from importlib.metadata import version as installed_version

        typer.echo(f"zensim {installed_version('zensim')}")
        raise typer.Exit


def _find_verb(arguments: Sequence[str], environment: Mapping[str, str]) -> str:
    """Find the verb among the arguments, or on the line that a shell wants completed."""
    line = environment.get("_TYPER_COMPLETE_ARGS") or environment.get("COMP_WORDS")
    if "_ZENSIM_COMPLETE" in environment and line:
        arguments = line.split()[1:]
    return next((word for word in arguments if not word.startswith("-")), "")


def main() -> None:
    """Run the command line."""
    die_with_supervisor(os.environ)
    build(_find_verb(sys.argv[1:], os.environ))(prog_name="zensim")
