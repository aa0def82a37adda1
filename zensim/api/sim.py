"""Sim: a simulation on a server."""

from collections.abc import Iterator
from contextlib import contextmanager

from zensim.api.argument_checks import check_whole
from zensim.api.call_deadline import limited
from zensim.api.server_access import ServerAccess
from zensim.api.simulation import Simulation
from zensim.api.world_access import api_errors
from zensim.api.world_page import WorldPage
from zensim.api.world_session import STEP_TIMEOUT_S
from zensim.api.world_state import WorldState
from zensim.proto.messages.agent_messages import TwistCommands

FULL_ROLE = "full"
PAGE_TIMEOUT_S = 30.0
MAX_PORT = 65_535


class Sim(Simulation):
    """A simulated world on a server; `connect` and `launch` make it."""

    def __init__(self, access: ServerAccess) -> None:
        self._access = access
        self._pages: list[WorldPage] = []
        super().__init__(access)
        access.role = self._info.role

    @property
    def endpoint(self) -> str:
        """Endpoint of the server, as `connect` takes it."""
        return self._access.bus.endpoint

    @property
    def role(self) -> str:
        """Role of this client's user on a secured server, as `operator`; `full` on others."""
        return self._access.role or FULL_ROLE

    @property
    def rtf(self) -> float:
        """Real-time factor of the last second; 0 while paused."""
        return self._session.state().snapshot.real_time_factor

    @property
    def is_connected(self) -> bool:
        """Whether the server publishes or replies."""
        return self._access.is_connected

    def steps(self, seconds: float | None = None, rate: float | None = None) -> Iterator[float]:
        """See `Simulation.steps`; a world that plays is paused until the loop ends."""
        was_paused = self.is_paused
        if not was_paused:
            self._pause_at_control_step()
        try:
            yield from super().steps(seconds, rate)
        finally:
            if not was_paused:
                self._access.end_lease()

    def _pause_at_control_step(self) -> None:
        """Become the client that steps, which pauses a world that plays."""
        with api_errors():
            state = self._access.advance(1, None, STEP_TIMEOUT_S)
        if left := -state.snapshot.step % self._session.control_steps:
            self._session.advance(left)

    @contextmanager
    def join_lockstep(
        self, rate: float | None = None, *, timeout_s: float = STEP_TIMEOUT_S
    ) -> Iterator[Iterator[float]]:
        """Control robots in a world that others step, or that plays: it awaits this program.

        What is ordered in a control step acts in the next one. Where agents are awaited, in
        lockstep and in requested steps, so is this program, with their timeout; else nothing waits.

        Args:
            rate: Of its control steps [Hz]; must divide the control rate, which is the default.
            timeout_s: Wall time until the next control step.

        Yields:
            An iterator over its control steps: simulation time [s].

        Raises:
            Timeout: No control step came in time, as in a paused world that nobody steps.
        """
        self._session.check_open()
        with limited(timeout_s):
            steps = self._count_steps(rate)
        self._session.is_joined = True
        try:
            yield self._follow_steps(steps, timeout_s)
        finally:
            self._session.is_joined = False
            self._session.take_orders()
            self._access.end_lease()

    def _follow_steps(self, steps: int, timeout_s: float) -> Iterator[float]:
        def join(twists: TwistCommands | None) -> WorldState:
            with limited(timeout_s):
                return self._access.join(steps, twists, timeout_s)

        while self._session.is_joined:
            self._session.follow(join, steps * self.step_period)
            yield self.time

    def set_speed(self, factor: float) -> None:
        """Set the target real-time factor; 0 = as fast as possible, else 0.01 to 1000."""
        self._session.check_open()
        with api_errors():
            self._session.client.set_speed(factor)

    def show(self, port: int = 0, *, timeout_s: float = PAGE_TIMEOUT_S) -> WorldPage:
        """Serve a 3D page of the world on this host; notebooks show it where it is the last value.

        Args:
            port: TCP port; 0 = any free.
            timeout_s: Wall time of its start.

        Raises:
            Error: It cannot be served, for example without the extra `viewer`.
            Timeout: It was not served in time.
        """
        self._session.check_open()
        check_whole("port", port, 0, MAX_PORT)
        page = WorldPage(self.endpoint, self._access.world_name, port, timeout_s)
        self._pages.append(page)
        return page

    def close(self) -> None:
        """See `Simulation.close`."""
        while self._pages:
            self._pages.pop().close()
        super().close()
