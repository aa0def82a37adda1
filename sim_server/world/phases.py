"""What the simulation does: in words, as events, and what may follow what."""

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import EventKind, StateName

NAMES: dict[State, StateName] = {
    State.STOPPED: "stopped",
    State.PLAYING: "playing",
    State.PAUSED: "paused",
    State.QUITTING: "quitting",
    State.NO_WORLD: "no_world",
    State.LOADING_WORLD: "loading_world",
}
ENTERED: dict[State, EventKind] = {
    State.STOPPED: "stopped",
    State.PLAYING: "played",
    State.PAUSED: "paused",
    State.QUITTING: "quitting",
    State.NO_WORLD: "unloaded",
    State.LOADING_WORLD: "loading",
}
"""What everybody is told."""
LEADS_TO: dict[State, frozenset[State]] = {
    State.STOPPED: frozenset({State.PLAYING, State.PAUSED, State.QUITTING}),
    State.PLAYING: frozenset({State.STOPPED, State.PAUSED, State.QUITTING}),
    State.PAUSED: frozenset({State.STOPPED, State.PLAYING, State.QUITTING}),
    State.QUITTING: frozenset(),
    State.NO_WORLD: frozenset({State.QUITTING}),
    State.LOADING_WORLD: frozenset({State.QUITTING}),
}
"""What may be asked for, by state. Source: simulation_interfaces/msg/SimulationState."""


def why_not(wanted: int, present: State) -> str:
    """Say why a state cannot be had now, and what can."""
    if wanted in (State.NO_WORLD, State.LOADING_WORLD):
        return f"state {NAMES[State(wanted)]} is reached by unload_world and load_world only"
    named = NAMES[State(wanted)] if wanted in set(State) else f"{wanted}, which is no state"
    offered = ", ".join(f"{state.value} ({NAMES[state]})" for state in sorted(LEADS_TO[present]))
    if present == State.NO_WORLD:
        offered += ", or load_world first"
    return f"the simulation is {NAMES[present]} and cannot become {named}; use {offered or 'none'}"
