"""`zensim pause`, `play`, `stop`, `reset`, `features`."""

from enum import IntEnum
from typing import Annotated

import msgspec
import typer

from zensim.proto.messages.simulation_messages import Feature, ResetScope, State
from zensim.spawner.cli.session import AsJson, Connect, Timeout, WorldName, client_for

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def pause(
    *, timeout: Timeout = 10.0, connect: Connect = "", world_name: WorldName = "default"
) -> None:
    """Let time stand."""
    _set_state("pause", State.PAUSED, connect, world_name, timeout)


@app.command()
def play(
    *, timeout: Timeout = 10.0, connect: Connect = "", world_name: WorldName = "default"
) -> None:
    """Let time run."""
    _set_state("play", State.PLAYING, connect, world_name, timeout)


@app.command()
def stop(
    *, timeout: Timeout = 10.0, connect: Connect = "", world_name: WorldName = "default"
) -> None:
    """Let time stand at the start: what was spawned goes."""
    _set_state("stop", State.STOPPED, connect, world_name, timeout)


def _set_state(verb: str, state: State, connect: str, world: str, timeout_s: float) -> None:
    with client_for(verb, connect, world, timeout_s) as client:
        # Whoever wants what already is has what he wants.
        if client.simulation_state() != state:
            client.set_simulation_state(state)
        typer.echo(f"{state.name.lower()} at {client.info().sim_time_s:.3f} s")


@app.command()
def reset(
    *,
    time: Annotated[bool, typer.Option("--time", help="Simulation time only.")] = False,
    state: Annotated[bool, typer.Option("--state", help="Poses and joints only.")] = False,
    spawned: Annotated[bool, typer.Option("--spawned", help="Spawned entities only.")] = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Go back to the start; all of it unless parts are named, which add up."""
    wanted = {ResetScope.TIME: time, ResetScope.STATE: state, ResetScope.SPAWNED: spawned}
    scope = sum(bit for bit, is_wanted in wanted.items() if is_wanted)
    with client_for("reset", connect, world_name, timeout) as client:
        client.reset(scope or ResetScope.DEFAULT)
        info = client.info()
        typer.echo(f"reset: time {info.sim_time_s:.3f} s, epoch {info.epoch}")


@app.command()
def features(
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """List what the server can do, in the words of simulation_interfaces."""
    with client_for("features", connect, world_name, timeout) as client:
        found = client.features()
    names = [_name_of(Feature, number) for number in found.features]
    if as_json:
        facts = {
            "features": names,
            "spawn_formats": found.spawn_formats,
            "custom_info": found.custom_info,
        }
        typer.echo(msgspec.json.encode(facts).decode())
        return
    typer.echo("\n".join(names))
    typer.echo(f"spawn formats: {', '.join(found.spawn_formats)}", err=True)
    typer.echo(found.custom_info, err=True)


def _name_of(kind: type[IntEnum], number: int) -> str:
    return kind(number).name if number in set(kind) else str(number)
