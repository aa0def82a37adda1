"""A world's time and state, and what everybody is told of it."""

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import Event, EventKind, StateName
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.world.phases import ENTERED, NAMES


class Chronicle:
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
        return NAMES[self.state]

    def enter(self, state: State) -> None:
        """Let time run or stand, or get ready to end."""
        self.state = state
        self._tell(ENTERED[state])

    def play(self) -> None:
        """Let time run."""
        self.enter(State.PLAYING)

    def pause(self) -> None:
        """Let time stand."""
        self.enter(State.PAUSED)

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
        self._tell("warning", entity=entity, message=message)

    def _tell(
        self, kind: EventKind, *, entity: str = "", agent: str = "", message: str = ""
    ) -> None:
        self._events.append(Event(kind, entity, agent, self.steps, self.epoch, message))
