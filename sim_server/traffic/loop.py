"""The loop: requests, commands, physics, telemetry, in this order; paced to a real-time factor.

One thread owns world and engine. While it waits for the next step's deadline it polls its inbox, so
that a request between steps is answered at once. So it does while it waits for agents.
"""

import logging
from collections.abc import Callable
from typing import Protocol

from zensim.proto.messages.simulation_messages import State
from zensim.sim_server.desk import Desk
from zensim.sim_server.traffic.driving import Driving
from zensim.sim_server.traffic.inbox import Inbox
from zensim.sim_server.traffic.outlets import Outlet
from zensim.sim_server.traffic.requests import Requests
from zensim.sim_server.traffic.telemetry import Telemetry

LOG = logging.getLogger(__name__)

POLL_S = 0.0003
IDLE_POLL_S = 0.001
EVENTS = 128
"""That are told at a turn: a fleet brings more, and steps come between."""
MAX_LAG_NS = 50_000_000
"""How far the loop may run behind and still catch up; beyond, the deadline slips."""


class Clock(Protocol):
    """Wall time, and the thread's share of it."""

    def now_ns(self) -> int:
        """Monotonic time."""

    def used_ns(self) -> int:
        """CPU time of this thread."""

    def sleep(self, seconds: float) -> None:
        """Wait."""


class Loop:
    """Drives one world."""

    def __init__(self, desk: Desk, inbox: Inbox, outlet: Outlet, clock: Clock) -> None:
        self._desk = desk
        self._world = desk.world
        self._meter = desk.meter
        self._inbox = inbox
        self._outlet = outlet
        self._clock = clock
        self._telemetry = Telemetry(desk)
        self._deadline_ns = clock.now_ns()
        self._paced_ns = 0
        self._factor = desk.target_real_time_factor
        self._requests = Requests(desk, self._telemetry)
        self._driving = Driving(desk, inbox, outlet)

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Go on until told to stop, or to quit by a request: its reply has gone out by then."""
        while not (should_stop() or self._has_quit):
            self.turn()

    @property
    def _has_quit(self) -> bool:
        return self._world.state == State.QUITTING and not self._requests.has_replies

    def turn(self) -> None:
        """Serve what has come, then step if it is time, else wait a little."""
        began_ns, self._paced_ns = self._clock.used_ns(), 0
        self.serve()
        if self._driving.must_wait():
            self._clock.sleep(POLL_S)
        else:
            self._finish_goals()
            self._advance(self._clock.now_ns())
        self.publish()
        busy_ns = self._clock.used_ns() - began_ns
        self._meter.note_turn(busy_ns=busy_ns, paced_ns=self._paced_ns)

    def serve(self) -> None:
        """Take in everything that has come."""
        self._desk.due_ns = self._deadline_ns
        # Calls are taken before tokens and answered after them: an agent's token comes first.
        calls = self._inbox.take_calls()
        self._driving.serve()
        for call in calls:
            self._requests.take(call)
        self._desk.has_read = self._desk.descriptions.poll()
        self._requests.carry_on()
        self._driving.tell_changes()

    def tick(self, now_ns: int) -> None:
        """Advance by one step and tell the agents."""
        self._world.step()
        took_ns = self._clock.now_ns() - now_ns
        self._meter.note_step(
            simulated_ns=self._world.step_ns,
            took_ns=took_ns,
            late_ns=max(0, now_ns - self._deadline_ns),
        )
        if self._world.is_control_step:
            self._driving.tell()

    def publish(self) -> None:
        """Tell everybody what is due."""
        for event in self._world.take_events(EVENTS):
            LOG.info(
                "event kind=%s entity=%s agent=%s message=%s",
                event.kind,
                event.entity,
                event.agent,
                event.message,
            )
            self._outlet.tell("events", event)
        now_ns = self._clock.now_ns()
        self._publish_progress(now_ns)
        if self._meter.close_window(now_ns) and self._outlet.is_wanted("stats"):
            self._outlet.tell("stats", self._telemetry.stats())
        for topic in self._telemetry.due(now_ns):
            if self._outlet.is_wanted(topic):
                self._outlet.tell(topic, self._telemetry.message(topic))

    def _advance(self, now_ns: int) -> None:
        self._heed_speed(now_ns)
        if self._desk.stepping.wants_step:
            self._requested_step(now_ns)
        elif self._world.state != State.PLAYING:
            self._deadline_ns = now_ns
            self._clock.sleep(IDLE_POLL_S)
        elif now_ns >= self._deadline_ns:
            self.tick(now_ns)
            self._set_deadline()
        else:
            self._clock.sleep(min(POLL_S, (self._deadline_ns - now_ns) * 1e-9))

    def _heed_speed(self, now_ns: int) -> None:
        """Begin to pace anew when the speed was changed: the old deadline may be far off."""
        if self._factor != self._desk.target_real_time_factor:
            self._factor = self._desk.target_real_time_factor
            self._deadline_ns = now_ns

    def _set_deadline(self) -> None:
        now_ns = self._clock.now_ns()
        if self._factor <= 0.0:
            self._deadline_ns = now_ns
            return
        self._paced_ns = round(self._world.step_ns / self._factor)
        self._deadline_ns += self._paced_ns
        if (lag_ns := now_ns - self._deadline_ns) > MAX_LAG_NS:
            self._meter.slipped_ns += lag_ns
            self._deadline_ns, self._paced_ns = now_ns, 0

    def _requested_step(self, now_ns: int) -> None:
        self._deadline_ns = now_ns
        self.tick(now_ns)
        self._desk.stepping.note_step()
        if not self._desk.lockstep.is_waiting:
            self._finish_goals()

    def _finish_goals(self) -> None:
        """End the goals whose steps are made and whose agents have answered; answer for them."""
        if not self._desk.stepping:
            return
        if self._world.state not in (State.PAUSED, State.PLAYING):
            self._desk.stepping.abort(f"the simulation is {self._world.state_name}")
        self._desk.stepping.settle()
        # Progress first: who hears of the end may then be sure that nothing more comes.
        self._publish_progress(self._clock.now_ns())
        self._requests.carry_on()

    def _publish_progress(self, now_ns: int) -> None:
        for progress in self._desk.stepping.due_progress(now_ns):
            self._outlet.tell("simulate_steps_feedback", progress)
