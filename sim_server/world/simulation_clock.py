"""Simulation time, the state machine with its allowed transitions, and events to publish."""

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import Event, EventKind, StateName
from zensim.sim_server.errors import IncorrectState

STATE_NAMES: dict[State, StateName] = {
    State.STOPPED: "stopped",
    State.PLAYING: "playing",
    State.PAUSED: "paused",
    State.QUITTING: "quitting",
    State.NO_WORLD: "no_world",
    State.LOADING_WORLD: "loading_world",
}
STATE_EVENTS: dict[State, EventKind] = {
    State.STOPPED: "stopped",
    State.PLAYING: "played",
    State.PAUSED: "paused",
    State.QUITTING: "quitting",
    State.NO_WORLD: "unloaded",
    State.LOADING_WORLD: "loading",
}
"""The event of each change of state."""
ALLOWED_TRANSITIONS: dict[State, frozenset[State]] = {
    State.STOPPED: frozenset({State.PLAYING, State.PAUSED, State.QUITTING}),
    State.PLAYING: frozenset({State.STOPPED, State.PAUSED, State.QUITTING}),
    State.PAUSED: frozenset({State.STOPPED, State.PLAYING, State.QUITTING}),
    State.QUITTING: frozenset(),
    State.NO_WORLD: frozenset({State.QUITTING}),
    State.LOADING_WORLD: frozenset({State.QUITTING}),
}
"""States that may be requested, by state. Source: simulation_interfaces/msg/SimulationState."""


def explain_refused_transition(wanted: int, present: State) -> str:
    """Explain why a state is not reachable now, and which states are."""
    if wanted in (State.NO_WORLD, State.LOADING_WORLD):
        return f"state {STATE_NAMES[State(wanted)]} is reached by unload_world and load_world only"
    named = STATE_NAMES[State(wanted)] if wanted in set(State) else f"{wanted}, which is no state"
    offered = ", ".join(
        f"{state.value} ({STATE_NAMES[state]})" for state in sorted(ALLOWED_TRANSITIONS[present])
    )
    if present == State.NO_WORLD:
        offered = f"load_world ('zensim world load NAME') first, or {offered}"
    return (
        f"the simulation is {STATE_NAMES[present]} and cannot become {named}; "
        f"use {offered or 'none'}"
    )


class SimulationClock:
    """Steps, epoch, state, and events to publish."""

    def __init__(self, *, step_ns: int) -> None:
        self.step_ns = step_ns
        self.state = State.PLAYING
        self.epoch = 0
        self.steps = 0
        self._events: list[Event] = []

    @property
    def time_ns(self) -> int:
        """Simulation time [ns]."""
        return self.steps * self.step_ns

    @property
    def state_name(self) -> StateName:
        """Name of the state."""
        return STATE_NAMES[self.state]

    def change_state(self, state: State) -> None:
        """Enter a state."""
        self.state = state
        self.add_event(STATE_EVENTS[state])

    def start_epoch(self, state: State, *, step_ns: int) -> None:
        """Start at time 0 of a new epoch, in another world or in none."""
        self.steps, self.epoch, self.step_ns = 0, self.epoch + 1, step_ns
        self.state = state
        self.add_event("unloaded" if state == State.NO_WORLD else "loaded")

    def pause(self) -> None:
        """Enter the state PAUSED."""
        self.change_state(State.PAUSED)

    def require_paused(self) -> None:
        """Check that the simulation is paused.

        Raises:
            IncorrectState: The simulation plays, or has no world.
        """
        if self.state != State.PAUSED:
            raise IncorrectState(f"the simulation is {self.state_name}; pause it before stepping")

    def take_events(self, max_events: int | None = None) -> list[Event]:
        """Take the oldest events that were not taken yet, all by default."""
        events, self._events = (
            self._events[:max_events],
            [] if max_events is None else self._events[max_events:],
        )
        return events

    def warn(self, entity: str, message: str) -> None:
        """Publish a warning about an entity."""
        self.add_event("warning", entity=entity, message=message)

    def add_event(
        self, kind: EventKind, *, entity: str = "", agent: str = "", message: str = ""
    ) -> None:
        """Add an event to publish, stamped with the current step."""
        self._events.append(Event(kind, entity, agent, self.steps, self.epoch, message))
