"""`zensim step`, `run-to`, `speed`."""

import math
from typing import Annotated

import msgspec
import typer

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.simulation_messages import SimulateStepsResponse
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.spawner.cli.progress import step_progress
from zensim.spawner.cli.session import AsJson, Connect, Timeout, WorldName, client_for
from zensim.spawner.client import SimClient
from zensim.spawner.goals import GoalInterrupted

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

LONGEST_S = 1e9
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
    with client_for("step", connect, world_name, timeout) as client:
        made = _make("step", client, steps)
        _tell(client, made, as_json=as_json)


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
        time_ns = _nanoseconds(time)
    with client_for("run-to", connect, world_name, timeout) as client:
        steps = client.steps_until(time_ns)
        # A goal has progress and can be ended; a time that is past is refused by the server.
        if steps > 0:
            made = _make("run-to", client, steps)
        else:
            made = client.run_to(time_ns).completed_steps if steps < 0 else 0
        _tell(client, made, as_json=as_json)


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
    with client_for("speed", connect, world_name, timeout) as client:
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


def _make(verb: str, client: SimClient, steps: int) -> int:
    """Make steps and show their progress; an interrupt says how many were made."""
    try:
        with step_progress(steps) as on_progress:
            answer = client.simulate_steps(steps, on_progress=on_progress)
    except GoalInterrupted as interrupt:
        came = f"canceled after {interrupt.made} of {steps} steps"
        silent = "the server did not answer; it may go on stepping"
        typer.echo(f"zensim {verb}: {silent if interrupt.made is None else came}", err=True)
        raise
    _note(verb, answer)
    return answer.completed_steps


def _note(verb: str, answer: SimulateStepsResponse) -> None:
    if answer.result.error_message:
        typer.echo(f"zensim {verb}: note: {answer.result.error_message}", err=True)


def _tell(client: SimClient, made: int, *, as_json: bool) -> None:
    sim_time_s = client.info().sim_time_s
    if as_json:
        typer.echo(msgspec.json.encode({"steps": made, "sim_time_s": sim_time_s}).decode())
    else:
        typer.echo(f"{made} steps, now {sim_time_s:.3f} s")


def _nanoseconds(time_s: float) -> int:
    if not (math.isfinite(time_s) and 0.0 <= time_s <= LONGEST_S):
        raise ValueError(f"{time_s:g} s is out of range; use 0 to {LONGEST_S:g}")
    return round(time_s * NANOSECONDS)
