"""`zensim pause`, `play`, `stop`, `reset`, `features`, `step`, `run-to` and `speed`."""

import math
from enum import IntEnum
from typing import Annotated

import msgspec
import typer

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.simulation_messages import (
    Feature,
    ResetScope,
    SimulateStepsResponse,
    State,
)
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.spawner.cli.command_session import AsJson, Connect, Timeout, WorldName, open_client
from zensim.spawner.cli.terminal_output import step_progress
from zensim.spawner.client.sim_client import SimClient, StepGoalInterrupted

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
    with open_client(verb, connect, world, timeout_s) as client:
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
    with open_client("reset", connect, world_name, timeout) as client:
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
    with open_client("features", connect, world_name, timeout) as client:
        found = client.features()
    names = [_enum_name(Feature, number) for number in found.features]
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


def _enum_name(kind: type[IntEnum], number: int) -> str:
    return kind(number).name if number in set(kind) else str(number)


MAX_SIM_TIME_S = 1e9
"""As far as a message can tell a time, roughly half of it."""


@app.command()
def step(
    steps: Annotated[int, typer.Argument(metavar="N", help="How many.")] = 1,
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Make steps of a paused world; Ctrl-C ends them."""
    with open_client("step", connect, world_name, timeout) as client:
        made = _simulate_steps("step", client, steps)
        _print_steps(client, made, as_json=as_json)


@app.command("run-to")
def run_to(
    time: Annotated[float, typer.Argument(metavar="T", help="Simulation time [s].")],
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Make steps of a paused world until a simulation time is reached; Ctrl-C ends them."""
    with exit_on_failure("run-to"):
        time_ns = _to_nanoseconds(time)
    with open_client("run-to", connect, world_name, timeout) as client:
        steps = client.steps_until(time_ns)
        # A goal has progress and can be ended; a time that is past is refused by the server.
        if steps > 0:
            made = _simulate_steps("run-to", client, steps)
        else:
            made = client.run_to(time_ns).completed_steps if steps < 0 else 0
        _print_steps(client, made, as_json=as_json)


@app.command()
def speed(
    factor: Annotated[
        float | None,
        typer.Argument(metavar="FACTOR", help="Simulated seconds a second; 0 = flat out."),
    ] = None,
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Choose the real-time factor to hold, or tell it when none is given."""
    with open_client("speed", connect, world_name, timeout) as client:
        if factor is not None:
            client.set_speed(factor)
        info = client.info()
        target, measured = info.target_real_time_factor, info.real_time_factor
        if as_json:
            facts = {"target_real_time_factor": target, "real_time_factor": measured}
            typer.echo(msgspec.json.encode(facts).decode())
            return
        wanted = f"{target:g}" if target else "flat out"
        typer.echo(f"speed {wanted}, now {measured:.3f}")


def _simulate_steps(verb: str, client: SimClient, steps: int) -> int:
    """Make steps and show their progress; an interrupt says how many were made."""
    try:
        with step_progress(steps) as on_progress:
            answer = client.simulate_steps(steps, on_progress=on_progress)
    except StepGoalInterrupted as interrupt:
        came = f"canceled after {interrupt.made} of {steps} steps"
        silent = "the server did not answer; it may go on stepping"
        typer.echo(f"zensim {verb}: {silent if interrupt.made is None else came}", err=True)
        raise
    _print_note(verb, answer)
    return answer.completed_steps


def _print_note(verb: str, answer: SimulateStepsResponse) -> None:
    if answer.result.error_message:
        typer.echo(f"zensim {verb}: note: {answer.result.error_message}", err=True)


def _print_steps(client: SimClient, made: int, *, as_json: bool) -> None:
    sim_time_s = client.info().sim_time_s
    if as_json:
        typer.echo(msgspec.json.encode({"steps": made, "sim_time_s": sim_time_s}).decode())
    else:
        typer.echo(f"{made} steps, now {sim_time_s:.3f} s")


def _to_nanoseconds(time_s: float) -> int:
    if not (math.isfinite(time_s) and 0.0 <= time_s <= MAX_SIM_TIME_S):
        raise ValueError(f"{time_s:g} s is out of range; use 0 to {MAX_SIM_TIME_S:g}")
    return round(time_s * NANOSECONDS)
