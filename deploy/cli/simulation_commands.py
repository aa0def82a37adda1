"""`zensim pause`, `play`, `stop`, `reset`, `features`, `stats`, `step`, `run-to` and `rtf`."""

import math
import sys
from typing import Annotated

import msgspec
import typer

from zensim.deploy.cli.command_session import open_client, print_json
from zensim.deploy.cli.terminal_output import step_progress
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.simulation_messages import Feature, ResetScope, State
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.options.command_options import ClientOptions, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.verbosity import print_note
from zensim.spawner.client.sim_client import SimClient, StepGoalInterrupted

app = make_app()

MAX_SIM_TIME_S = 1e9
"""Longest simulation time [s]: about half of what the seconds of a message can hold."""


@app.command()
def pause(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """Pause the simulation."""
    with open_client("pause", server) as client:
        _set_state(client, State.PAUSED, as_json=as_json)


@app.command()
def play(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """Start or resume the simulation."""
    with open_client("play", server) as client:
        _set_state(client, State.PLAYING, as_json=as_json)


@app.command()
def stop(
    *,
    yes: Annotated[
        bool, flag("--yes", "-y", help="Delete spawned entities without confirmation.")
    ] = False,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Reset the simulation, delete spawned entities, and stop.

    To stop time only, use 'zensim pause'.
    """
    with open_client("stop", server) as client, exit_on_failure("stop", DeletionRefused):
        spawned = sum(1 for one in client.models().entities if one.namespace)
        if spawned and not yes:
            _confirm_deletion(spawned)
        _set_state(client, State.STOPPED, as_json=as_json)
        if spawned:
            print_note("stop", f"deleted the spawned entities, {spawned} with topics")


class DeletionRefused(Exception):
    """Entities would be deleted, and the user did not agree."""


def _confirm_deletion(count: int) -> None:
    text = f"'zensim stop' deletes all spawned entities, {count} with topics"
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise DeletionRefused(f"{text}; 'zensim pause' stops time only, --yes deletes them")
    try:
        is_confirmed = typer.confirm(f"{text}. Continue?", err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
    if not is_confirmed:
        raise DeletionRefused("nothing was changed; 'zensim pause' stops time only")


def _set_state(client: SimClient, state: State, *, as_json: bool) -> None:
    # The service refuses a transition to the current state.
    if client.simulation_state() != state:
        client.set_simulation_state(state)
    name, sim_time_s = state.name.lower(), client.info_when_restored().sim_time_s
    if as_json:
        print_json({"state": name, "sim_time_s": sim_time_s})
    else:
        print_lines(f"{name} at {sim_time_s:.3f} s")


@app.command()
def reset(
    *,
    time: Annotated[bool, flag("--time", help="Reset simulation time.")] = False,
    state: Annotated[bool, flag("--state", help="Reset poses, velocities and joints.")] = False,
    spawned: Annotated[bool, flag("--spawned", help="Delete spawned entities.")] = False,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Reset time, entity states and spawned entities; all of them if no option is given."""
    selected = {ResetScope.TIME: time, ResetScope.STATE: state, ResetScope.SPAWNED: spawned}
    scope = sum(bit for bit, is_selected in selected.items() if is_selected)
    with open_client("reset", server) as client:
        before = client.info_when_restored().entities
        client.reset(scope or ResetScope.DEFAULT)
        info = client.info_when_restored()
    deleted = max(0, before - info.entities)
    if as_json:
        print_json({"sim_time_s": info.sim_time_s, "epoch": info.epoch, "deleted": deleted})
        return
    fate = f", {deleted} entities deleted" if deleted else ""
    print_lines(f"reset: time {info.sim_time_s:.3f} s, epoch {info.epoch}{fate}")


@app.command()
def features(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """List the features of the server, by their names in simulation_interfaces."""
    with open_client("features", server) as client:
        reply = client.features()
    names = [Feature(one).name if one in set(Feature) else str(one) for one in reply.features]
    if as_json:
        print_json(
            {
                "features": names,
                "spawn_formats": reply.spawn_formats,
                "custom_info": reply.custom_info,
            }
        )
        return
    print_lines("\n".join(names))
    print_note("features", f"spawn formats: {', '.join(reply.spawn_formats)}; {reply.custom_info}")


@app.command()
def stats(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """Print what the server has counted since its start, and its times of the last second."""
    with open_client("stats", server) as client:
        found = client.stats()
    if as_json:
        print_json(found)
        return
    for name, value in msgspec.to_builtins(found).items():
        _print_figures(name, value)


def _print_figures(name: str, value: object) -> None:
    """Print a figure, or a row for each one in it."""
    match value:
        case {"wall_s": _, **others}:
            # The host's clock has any origin: it only means something for two readings.
            _print_figures(name, others)
        case dict() if value:
            for part, one in value.items():
                _print_figures(f"{name}.{part}", one)
        case dict() | list() | tuple():
            print_lines(f"{name:<24} {', '.join(map(str, value)) or '-'}")
        case float():
            print_lines(f"{name:<24} {value:.6g}")
        case _:
            print_lines(f"{name:<24} {value}")


@app.command()
def step(
    steps: Annotated[int, typer.Argument(metavar="N", help="Number of steps.")] = 1,
    *,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Advance a paused simulation by a number of steps; Ctrl-C cancels."""
    with open_client("step", server) as client:
        completed = _simulate_steps("step", client, steps)
        _print_steps(client, completed, as_json=as_json)


@app.command("run-to")
def run_to(
    time: Annotated[float, typer.Argument(metavar="TIME", help=r"Simulation time \[s].")],
    *,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Advance a paused simulation to a given time; Ctrl-C cancels."""
    with exit_on_failure("run-to"):
        time_ns = _to_nanoseconds(time)
    with open_client("run-to", server) as client:
        steps = client.steps_until(time_ns)
        # A goal reports progress and can be canceled; the server refuses a time in the past.
        if steps > 0:
            completed = _simulate_steps("run-to", client, steps)
        else:
            completed = client.run_to(time_ns).completed_steps if steps < 0 else 0
        _print_steps(client, completed, as_json=as_json)


FactorArgument = Annotated[
    float | None,
    typer.Argument(
        metavar="FACTOR",
        help="Target real-time factor; 0 = as fast as possible. Without it, only print.",
    ),
]


@app.command(context_settings={"ignore_unknown_options": True})  # -1 is a number
def rtf(
    factor: FactorArgument = None, *, as_json: JsonOption = False, server: ClientOptions
) -> None:
    """Set the target real-time factor, and print target and measured factor."""
    _set_factor(factor, server, as_json=as_json)


def _set_factor(factor: float | None, server: ClientOptions, *, as_json: bool) -> None:
    with open_client("rtf", server) as client:
        if factor is not None:
            client.set_speed(factor)
        info = client.info_when_restored()
    target, measured = info.target_real_time_factor, info.real_time_factor
    if as_json:
        print_json({"target_real_time_factor": target, "real_time_factor": measured})
        return
    goal = f"{target:g}" if target else "as fast as possible"
    print_lines(f"real-time factor {measured:.3f}, target {goal}")


def _simulate_steps(verb: str, client: SimClient, steps: int) -> int:
    """Advance with a progress bar; an interrupt prints the number of completed steps."""
    try:
        with step_progress(steps) as on_progress:
            response = client.simulate_steps(steps, on_progress=on_progress)
    except StepGoalInterrupted as interrupt:
        result = (
            "the server did not reply; it may continue to step"
            if interrupt.completed_steps is None
            else f"canceled after {interrupt.completed_steps} of {steps} steps"
        )
        print_lines(f"zensim {verb}: {result}", err=True)
        raise
    if response.result.error_message:
        print_note(verb, response.result.error_message)
    return response.completed_steps


def _print_steps(client: SimClient, completed: int, *, as_json: bool) -> None:
    sim_time_s = client.info_when_restored().sim_time_s
    if as_json:
        print_json({"steps": completed, "sim_time_s": sim_time_s})
    else:
        print_lines(f"{completed} steps, now {sim_time_s:.3f} s")


def _to_nanoseconds(time_s: float) -> int:
    if not (math.isfinite(time_s) and 0.0 <= time_s <= MAX_SIM_TIME_S):
        raise ValueError(f"time must be 0 to {MAX_SIM_TIME_S:g} s, got {time_s:g}")
    return round(time_s * NANOSECONDS)
