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
"""What everybody is told."""
ALLOWED_TRANSITIONS: dict[State, frozenset[State]] = {
    State.STOPPED: frozenset({State.PLAYING, State.PAUSED, State.QUITTING}),
    State.PLAYING: frozenset({State.STOPPED, State.PAUSED, State.QUITTING}),
    State.PAUSED: frozenset({State.STOPPED, State.PLAYING, State.QUITTING}),
    State.QUITTING: frozenset(),
    State.NO_WORLD: frozenset({State.QUITTING}),
    State.LOADING_WORLD: frozenset({State.QUITTING}),
}
"""What may be asked for, by state. Source: simulation_interfaces/msg/SimulationState."""


def explain_refused_transition(wanted: int, present: State) -> str:
    """Say why a state cannot be had now, and what can."""
    if wanted in (State.NO_WORLD, State.LOADING_WORLD):
        return f"state {STATE_NAMES[State(wanted)]} is reached by unload_world and load_world only"
    named = STATE_NAMES[State(wanted)] if wanted in set(State) else f"{wanted}, which is no state"
    offered = ", ".join(
        f"{state.value} ({STATE_NAMES[state]})" for state in sorted(ALLOWED_TRANSITIONS[present])
    )
    if present == State.NO_WORLD:
        offered += ", or load_world first"
    return f"the simulation is {STATE_NAMES[present]} and cannot become {named}; use {offered or 'none'}"


class SimulationClock:
    """Steps, epoch and state, and the events since they were taken last."""

    def __init__(self, *, step_ns: int) -> None:
        self.step_ns = step_ns
        self.state = State.PLAYING
        self.epoch = 0
        self.steps = 0
        self._events: list[Event] = []

    @property
    def time_ns(self) -> int:
        """Simulation time."""
        return self.steps * self.step_ns

    @property
    def state_name(self) -> StateName:
        """The state in a word."""
        return STATE_NAMES[self.state]

    def change_state(self, state: State) -> None:
        """Let time run or stand, or get ready to end."""
        self.state = state
        self._add_event(STATE_EVENTS[state])

    def play(self) -> None:
        """Let time run."""
        self.change_state(State.PLAYING)

    def pause(self) -> None:
        """Let time stand."""
        self.change_state(State.PAUSED)

    def require_paused(self) -> None:
        """Refuse unless paused.

        Raises:
            IncorrectState: The simulation plays, or has no world.
        """
        if self.state != State.PAUSED:
            raise IncorrectState(f"the simulation is {self.state_name}; pause it before stepping")

    def take_events(self, most: int | None = None) -> list[Event]:
        """Take what has happened since the last time, the beginning of it if it is much."""
        events, self._events = self._events[:most], [] if most is None else self._events[most:]
        return events

    def warn(self, entity: str, message: str) -> None:
        """Tell everybody of something odd that was accepted."""
        self._add_event("warning", entity=entity, message=message)

    def _add_event(
        self, kind: EventKind, *, entity: str = "", agent: str = "", message: str = ""
    ) -> None:
        self._events.append(Event(kind, entity, agent, self.steps, self.epoch, message))
