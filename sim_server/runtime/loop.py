"""Server loop: requests, commands, physics and telemetry in this order, at the target speed."""

import logging
from collections.abc import Callable
from functools import partial
from typing import Protocol

from zensim.proto import keys
from zensim.proto.messages.simulation_messages import State
from zensim.proto.topic_catalog import EVENTS, STATS, STEPS_PROGRESS
from zensim.sim_server.journal_protocol import ChangeJournal
from zensim.sim_server.runtime.agent_sessions import AgentSessions
from zensim.sim_server.runtime.loop_channels import Inbox, WorldPublisher
from zensim.sim_server.runtime.request_dispatcher import RequestDispatcher
from zensim.sim_server.runtime.world_telemetry import WorldTelemetry
from zensim.sim_server.service_parts import ServerParts
from zensim.sim_server.services.service_registry import ServiceHandlers

LOG = logging.getLogger(__name__)

POLL_S = 0.0003
IDLE_POLL_S = 0.001
MAX_EVENTS_PER_TURN = 128
"""Events published per turn; spawning many robots makes more than fit between two steps."""
MAX_LAG_NS = 50_000_000
"""Most that the loop catches up; beyond that the deadline moves."""


class LoopClock(Protocol):
    """Wall time, and CPU time of the thread."""

    def now_ns(self) -> int:
        """Read monotonic wall time."""

    def used_ns(self) -> int:
        """Read the CPU time of this thread."""

    def sleep(self, seconds: float) -> None:
        """Sleep for a wall time."""


class ServerLoop:
    """Loop of one world."""

    def __init__(
        self,
        parts: ServerParts,
        inbox: Inbox,
        publisher: WorldPublisher,
        clock: LoopClock,
        journal: ChangeJournal | None = None,
    ) -> None:
        self._world, self._pacing = parts.world, parts.pacing
        self._descriptions = parts.descriptions
        self._loop_stats = parts.pacing.loop_stats
        self._inbox = inbox
        self._publisher = publisher
        self._clock = clock
        self._deadline_ns = clock.now_ns()
        self._paced_ns = 0
        self._factor = parts.pacing.target_real_time_factor
        self._telemetry = WorldTelemetry(parts.world, parts.pacing)
        self._dispatcher = RequestDispatcher(
            ServiceHandlers(parts),
            self._telemetry,
            self._loop_stats,
            partial(keys.service, parts.world.name),
            journal,
        )
        self._agent_sessions = AgentSessions(
            parts.world, parts.pacing, parts.agents, parts.bonds, inbox, publisher
        )

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Run until `should_stop`, or until a request to quit has its reply."""
        while not (should_stop() or self._has_quit):
            self.turn()

    @property
    def _has_quit(self) -> bool:
        return self._world.clock.state == State.QUITTING and not self._dispatcher.has_unsent_replies

    def turn(self) -> None:
        """Serve the input received, then step if one is due, else sleep."""
        began_ns, self._paced_ns = self._clock.used_ns(), 0
        self.serve()
        if self._agent_sessions.must_wait():
            self._clock.sleep(POLL_S)
        else:
            self._finish_goals()
            self._advance(self._clock.now_ns())
        self.publish()
        busy_ns = self._clock.used_ns() - began_ns
        self._loop_stats.note_turn(busy_ns=busy_ns, paced_ns=self._paced_ns)

    def serve(self) -> None:
        """Handle liveliness changes, drive commands and requests."""
        self._pacing.due_ns = self._deadline_ns
        # Calls are taken before tokens and handled after them: an agent declares its token first.
        calls = self._inbox.take_calls()
        self._agent_sessions.serve()
        for call in calls:
            self._dispatcher.take(call)
        self._descriptions.has_new = self._descriptions.provider.poll()
        self._dispatcher.reply_to_ready()
        self._agent_sessions.publish_changed_claims()

    def tick(self, now_ns: int) -> None:
        """Advance by one step; publish drive states if it is a control step."""
        self._world.step()
        took_ns = self._clock.now_ns() - now_ns
        self._loop_stats.note_step(
            simulated_ns=self._world.clock.step_ns,
            took_ns=took_ns,
            late_ns=max(0, now_ns - self._deadline_ns),
        )
        if self._world.is_control_step:
            self._agent_sessions.publish_states()

    def publish(self) -> None:
        """Publish events, progress, statistics and the topics that are due."""
        for event in self._world.clock.take_events(MAX_EVENTS_PER_TURN):
            LOG.info(
                "event kind=%s entity=%s agent=%s message=%s",
                event.kind,
                event.entity,
                event.agent,
                event.message,
            )
            self._publisher.publish(EVENTS, event)
        now_ns = self._clock.now_ns()
        self._publish_progress(now_ns)
        if self._loop_stats.close_window(now_ns) and self._publisher.is_wanted(STATS):
            self._publisher.publish(STATS, self._telemetry.stats())
        for topic in self._telemetry.due(now_ns):
            if self._publisher.is_wanted(topic):
                self._publisher.publish(topic, self._telemetry.message(topic))

    def _advance(self, now_ns: int) -> None:
        self._apply_speed_change(now_ns)
        if self._pacing.step_goals.has_steps_left:
            self._make_requested_step(now_ns)
        elif self._world.clock.state != State.PLAYING:
            self._deadline_ns = now_ns
            self._clock.sleep(IDLE_POLL_S)
        elif now_ns >= self._deadline_ns:
            self.tick(now_ns)
            self._set_deadline()
        else:
            self._clock.sleep(min(POLL_S, (self._deadline_ns - now_ns) * 1e-9))

    def _apply_speed_change(self, now_ns: int) -> None:
        """Restart pacing when the target speed has changed: the old deadline may be far away."""
        if self._factor != self._pacing.target_real_time_factor:
            self._factor = self._pacing.target_real_time_factor
            self._deadline_ns = now_ns

    def _set_deadline(self) -> None:
        now_ns = self._clock.now_ns()
        if self._factor <= 0.0:
            self._deadline_ns = now_ns
            return
        self._paced_ns = round(self._world.clock.step_ns / self._factor)
        self._deadline_ns += self._paced_ns
        if (lag_ns := now_ns - self._deadline_ns) > MAX_LAG_NS:
            self._loop_stats.slipped_ns += lag_ns
            self._deadline_ns, self._paced_ns = now_ns, 0

    def _make_requested_step(self, now_ns: int) -> None:
        self._deadline_ns = now_ns
        self.tick(now_ns)
        self._pacing.step_goals.note_step()
        if not self._pacing.lockstep.is_waiting:
            self._finish_goals()

    def _finish_goals(self) -> None:
        """End the goals whose steps are made, and reply to their calls."""
        if not self._pacing.step_goals:
            return
        if self._world.clock.state not in (State.PAUSED, State.PLAYING):
            self._pacing.step_goals.abort(f"the simulation is {self._world.clock.state_name}")
        self._pacing.step_goals.finish_completed()
        # Progress first: no progress message follows the reply.
        self._publish_progress(self._clock.now_ns())
        self._dispatcher.reply_to_ready()

    def _publish_progress(self, now_ns: int) -> None:
        for progress in self._pacing.step_goals.due_progress(now_ns):
            self._publisher.publish(STEPS_PROGRESS, progress)
