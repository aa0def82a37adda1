"""Server loop: requests, commands, physics and telemetry in this order, at the target speed."""

import logging
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode
from zensim.proto.keys import parse_agent
from zensim.proto.messages.agent_messages import DriveCommand, DriveState, TwistCommands
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.network_protocols import Sample, ServiceCall
from zensim.proto.program_status import ProgramStatus
from zensim.proto.topic_catalog import AUDIT, CLOCK, CONTACTS, EVENTS, INPUTS, STATS, STEPS_PROGRESS
from zensim.sim_server.errors import SimError
from zensim.sim_server.input_log.log_writer import InputLog
from zensim.sim_server.journal_protocol import ChangeJournal
from zensim.sim_server.pacing.command_timeouts import CommandReceipt, CommandTimeouts
from zensim.sim_server.pacing.joined_clients import JoinedState
from zensim.sim_server.pacing.lockstep import SentStates
from zensim.sim_server.pacing.resting_agents import RestingAgents
from zensim.sim_server.runtime.audit_trail import AuditedUsers, AuditTrail
from zensim.sim_server.runtime.contact_telemetry import ContactTelemetry, TouchingSensors
from zensim.sim_server.runtime.loop_channels import Inbox, WorldPublisher
from zensim.sim_server.runtime.request_authorization import RequestAuthorization
from zensim.sim_server.runtime.request_counts import RequestCounts
from zensim.sim_server.runtime.request_dispatcher import RequestDispatcher
from zensim.sim_server.runtime.request_queue import (
    REQUEST_FEE_NS,
    RequestBudget,
    RequestBusy,
    RequestQueue,
)
from zensim.sim_server.runtime.sensor_sessions import SensorSessions
from zensim.sim_server.runtime.world_map import make_world_map
from zensim.sim_server.runtime.world_telemetry import DueTimes, WorldTelemetry
from zensim.sim_server.service_parts import ServerParts, ShareGrace
from zensim.sim_server.services.service_registry import ServiceHandlers

if TYPE_CHECKING:
    from zensim.sim_server.runtime.node_answers import NodeAnswers

MIN_STATE_INTERVAL_NS = 2_000_000
"""Least wall time between two states when the loop does not wait for commands."""
TAKEOVER_NS = 2_000_000
"""Time a robot that a silent pool keeps its robots from others: these need as long to begin on a
busy machine, and are silent meanwhile."""
REPEAT_PAUSED_NS = 1_000_000_000
"""Wall time after which a state that nothing waits for is published again while paused."""
RESEND_AFTER_NS = 20_000_000
"""Wall time after which a state is published again to an agent that has not replied."""
LOG = logging.getLogger(__name__)
SavedSessions = tuple[tuple[int, int], int, SentStates]
"""Version and orders of the last states that were published, and these states."""
POLL_S = 0.0003
"""Pause of a loop that waits for agents, or for a step for a while after a request."""
BUSY_NS = 100_000_000
"""Time of `POLL_S` after a call: calls in turn do not wait, and single ones wake the loop less."""
IDLE_POLL_S = 0.001
EAGER_NS, EAGER_POLL_S = 20_000_000, 0.0001
"""Time of fast polling of requests after a requested step, and its period."""
SETTLE_S = 0.001
"""Most time that the loop waits for replies to leave before it goes on with a step."""
MAX_BUSY_REFUSALS = 512
"""Refusals of excess requests in a second; more end without a value, which costs less."""
MAX_TURN_REFUSALS = 64
"""The same in a turn, so that a thousand requests at once do not delay a step."""
MAX_EVENTS_PER_TURN = 128
"""Events published per turn; spawning many robots makes more than fit between two steps."""
MAX_DRAIN_NS = 10_000_000_000
"""Longest time that the end of a server waits for requests that are not finished."""
MAX_LAG_NS = 50_000_000
"""Most that the loop catches up; beyond that the deadline moves."""
SavedLoop = tuple[DueTimes, TouchingSensors, SavedSessions]
"""State of a `ServerLoop` beside its world."""


class AgentSessions:
    """Publish drive states, apply drive commands, and wait for agents in lockstep."""

    def __init__(
        self,
        parts: ServerParts,
        inbox: Inbox,
        publisher: WorldPublisher,
        sensor_sessions: SensorSessions,
    ) -> None:
        self._world = parts.world
        self._pacing = parts.pacing
        self._lockstep = parts.pacing.lockstep
        self._commands = parts.pacing.loop_stats.commands
        self._agents = parts.agents
        self._bonds = parts.bonds
        self._inbox = inbox
        self._publisher = publisher
        self._sensor_sessions = sensor_sessions
        self._published_version = self._version
        self._published_twists = 0
        """Count of orders of twists in the last states."""
        self._published_ns = -MIN_STATE_INTERVAL_NS
        self._has_unsent_states = False
        """Whether an agent did not get the state of the last control step."""
        self._awaited_since_ns: dict[str, int] = {}
        """Wall time of a state that an agent has not replied to, by agent."""
        self._command_timeouts = CommandTimeouts()
        self._resting = RestingAgents()
        self._withholding: set[str] = set()
        """Agents that withhold messages from subscribers by wildcard."""

    def serve(self) -> None:
        """Handle liveliness changes, then apply drive commands."""
        for agent, is_alive in self._inbox.take_agents():
            self._on_agent_liveliness(agent, is_alive=is_alive)
        for bond, is_alive in self._inbox.take_bonds():
            self._on_bond_liveliness(bond, is_alive=is_alive)
        for client, is_alive in self._inbox.take_clients():
            self._on_client_liveliness(client, is_alive=is_alive)
        for sample in self._inbox.take_twists():
            self._order_twists(sample)
        for sample in self._inbox.take_commands():
            self._command(sample)

    def stop_silent_agents(self, now_ns: int) -> None:
        """Stop the robots of agents that have sent no command for `COMMAND_TIMEOUT_NS`."""
        time_ns = self._world.clock.time_ns
        while (silent := self._command_timeouts.find_silent(time_ns, now_ns)) is not None:
            agent, known_claims = silent
            self._command_timeouts.forget(agent)
            claimed = self._world.claimed_by_agent().get(agent)
            if claimed is None:
                continue
            if claimed.claims == known_claims:
                self._world.stop_silent(agent)
                lasts_ns = TAKEOVER_NS * len(claimed.rows)
                grace = ShareGrace(time_ns, now_ns, lasts_ns)
                self._agents.graces.setdefault(agent, grace)
            else:
                # Commands of before do not fit new claims.
                self._note_command(agent, claimed.claims, now_ns)

    def publish_states(self) -> None:
        """Publish the state of a control step to every agent.

        When simulation time runs faster than wall time, agents that have not replied are left out;
        else those that rest.
        """
        now_ns = self._pacing.now_ns()
        runs_fast = self._is_unpaced
        if runs_fast and now_ns - self._published_ns < MIN_STATE_INTERVAL_NS:
            self._has_unsent_states = True
            return
        self._published_ns = now_ns
        busy = self._find_busy_agents(now_ns) if runs_fast else frozenset()
        left_out = busy or self._find_resting_agents(now_ns)
        self._has_unsent_states = bool(left_out)
        for agent, state in self._world.drive_states(left_out):
            self._publish_state(agent, state)
        if not busy:
            self._world.commanded_twists.note_published()
        self._published_version = self._version
        self._published_twists = self._world.commanded_twists.changes

    def wake_joined_clients(self) -> None:
        """Wake the clients that have joined at their control steps."""
        pacing, clock = self._pacing, self._world.clock
        if len(pacing.joined):
            state = JoinedState(clock.epoch, clock.steps, is_awaited=pacing.is_awaited)
            pacing.step_goals.note_late(pacing.joined.wake(state, pacing.now_ns()))

    def publish_changed_claims(self) -> None:
        """Publish states to agents whose claims or epoch have changed since the last state."""
        if self._has_unsent_states and self._world.clock.state != State.PLAYING:
            self.publish_states()
        if self._published_version == self._version:
            return
        for agent, state in self._world.drive_states():
            if not self._lockstep.has_sent(agent, state):
                self._publish_state(agent, state)
        self._published_version = self._version

    def publish_ordered_twists(self) -> None:
        """Publish states with new orders before requested steps: they count from this step on."""
        changes = self._world.commanded_twists.changes
        if self._published_twists == changes or not self._pacing.step_goals.has_steps_left:
            return
        for agent, state in self._world.drive_states():
            if state.twists:
                self._publish_state(agent, state)
        self._world.commanded_twists.note_published()
        self._published_twists = changes

    def publish_unanswered(self) -> None:
        """Publish states again before requested steps, which wait for the replies.

        Else whether an agent obeys from the first step on depends on when it got its claims. In a
        world that is paused, an agent may have got the state before them.
        """
        agents = self._lockstep.unanswered
        if agents and not self._pacing.step_goals.has_steps_left:
            agents = self._find_unanswered_for_long(agents)
        for agent, state in self._world.drive_states() if agents else ():
            if agent in agents:
                self._publish_state(agent, state)

    def _find_unanswered_for_long(self, agents: Iterable[str]) -> frozenset[str]:
        if self._world.clock.state == State.PLAYING:
            return frozenset()
        end_ns = self._pacing.now_ns() - REPEAT_PAUSED_NS
        return frozenset(one for one in agents if self._awaited_since_ns.get(one, 0) < end_ns)

    def save(self) -> SavedSessions:
        """Take what tells which states agents have."""
        return self._published_version, self._published_twists, self._lockstep.save()

    def load(self, saved: SavedSessions) -> None:
        """Replace what `save` took."""
        self._published_version, self._published_twists, sent = saved
        self._lockstep.load(sent)

    def must_wait(self) -> bool:
        """Whether the next step must wait; apply the settings of lockstep to late clients."""
        if not self._lockstep.is_waiting:
            return False
        late = self._lockstep.find_late(self._pacing.now_ns())
        if late and not self._lockstep.has_timeout:
            self._publish_again(late)
        elif late:
            self._miss(late)
        return self._lockstep.is_waiting

    @property
    def _is_unpaced(self) -> bool:
        return not self._pacing.is_paced and self._world.clock.state == State.PLAYING

    @property
    def _version(self) -> tuple[int, int]:
        return self._world.clock.epoch, self._world.claims.changes

    def _find_busy_agents(self, now_ns: int) -> frozenset[str]:
        """Find the agents that have not replied to their last state."""
        sent = self._awaited_since_ns.items()
        return frozenset(agent for agent, sent_ns in sent if now_ns - sent_ns < RESEND_AFTER_NS)

    def _find_resting_agents(self, now_ns: int) -> frozenset[str]:
        """Find the agents that need no state: only while time runs, and no order has changed."""
        world, pacing = self._world, self._pacing
        if pacing.is_awaited or not pacing.is_paced or world.clock.state != State.PLAYING:
            return frozenset()
        has_orders = self._published_twists != world.commanded_twists.changes
        if has_orders or world.injected_faults.topic_faults:
            return frozenset()
        return self._resting.find(time_ns=world.clock.time_ns, now_ns=now_ns, version=self._version)

    def _publish_state(self, agent: str, state: DriveState) -> None:
        sent = msgspec.structs.replace(
            state, newest_claim=self._world.claims.newest, is_awaited=self._pacing.is_awaited
        )
        form = self._agents.state_formats.get(agent, Format.MSGPACK)
        self._publisher.publish_drive_state(agent, sent, form)
        if sent.claims:
            self._commands.note_sent(agent, (sent.epoch, sent.step))
        self._awaited_since_ns[agent] = self._pacing.now_ns()
        if agent not in self._command_timeouts and agent not in self._world.claims.silent:
            self._note_command(agent, sent.claims, self._pacing.now_ns())
        if not sent.claims:
            self._lockstep.forget(agent)
        elif not self._lockstep.record_sent(agent, sent, self._pacing.now_ns()):
            self._pacing.step_goals.note_late((agent,))

    def _note_command(self, agent: str, claims: bytes, now_ns: int) -> None:
        last = CommandReceipt(self._world.clock.time_ns, now_ns, claims)
        self._command_timeouts.note(agent, last)

    def _publish_again(self, late: tuple[str, ...]) -> None:
        """Publish states again: a congested network drops messages."""
        for agent, state in self._world.drive_states():
            if agent in late:
                self._publish_state(agent, state)
        self._sensor_sessions.publish_again(late)

    def _miss(self, late: tuple[str, ...]) -> None:
        settings, step = self._lockstep.settings, self._world.clock.steps
        for client in late:
            text = f"{client!r} did not reply to step {step} within {settings.lockstep_timeout:g} s"
            LOG.warning("missed client=%s step=%d %s", client, step, self._lockstep.rule)
            event = Event("missed", "", client, step, self._world.clock.epoch, text)
            self._publisher.publish(EVENTS, event)
        if self._lockstep.ends_when_late:
            self._abort_and_pause(f"{text}; check that it runs, then play again")
        else:
            self._pacing.step_goals.note_late(late)

    def _abort_and_pause(self, reason: str) -> None:
        self._pacing.step_goals.abort(reason)
        if self._world.clock.state == State.PLAYING:
            self._world.clock.pause()

    def _on_agent_liveliness(self, agent: str, *, is_alive: bool) -> None:
        if is_alive:
            self._agents.alive.add(agent)
            return
        self._agents.alive.discard(agent)
        self._agents.pool_limits.pop(agent, None)
        self._agents.settled_shares.pop(agent, None)
        self._agents.graces.pop(agent, None)
        self._agents.state_formats.pop(agent, None)
        self._world.release(agent)
        self._lockstep.forget(agent)
        self._awaited_since_ns.pop(agent, None)
        self._command_timeouts.forget(agent)
        self._resting.forget(agent)
        self._commands.forget(agent)
        self._withholding.discard(agent)
        self._publisher.forget_agent(agent)

    def _on_bond_liveliness(self, bond: str, *, is_alive: bool) -> None:
        if is_alive:
            self._bonds.alive.add(bond)
        else:
            self._bonds.end(bond)

    def _on_client_liveliness(self, client: str, *, is_alive: bool) -> None:
        lease, clock = self._pacing.lease, self._world.clock
        if is_alive:
            lease.alive.add(client)
            return
        self._world.commanded_twists.end_client(client)
        self._pacing.joined.end(client)
        if (former := lease.end(client)) is None:
            return
        self._pacing.step_goals.abort(f"client {client!r} is gone")
        self._pacing.target_real_time_factor = former.real_time_factor
        is_changed = former.state != clock.state
        if is_changed and {former.state, clock.state} <= {State.PLAYING, State.PAUSED}:
            clock.change_state(former.state)

    def _order_twists(self, sample: Sample) -> None:
        try:
            commands = decode(TwistCommands, sample.payload, sample.encoding)
            self._world.commanded_twists.order(self._world.entities.index, commands)
        except MalformedPayload as error:
            self._world.claims.rejected["malformed"] += 1
            LOG.debug("twists dropped reason=%s", error)

    def _command(self, sample: Sample) -> None:
        agent = parse_agent(sample.key)
        self._awaited_since_ns.pop(agent, None)
        try:
            command = decode(DriveCommand, sample.payload, sample.encoding)
        except MalformedPayload as error:
            self._world.claims.rejected["malformed"] += 1
            LOG.debug("drive command dropped agent=%s reason=%s", agent, error)
            return
        self.answer(agent, command)

    def answer(self, agent: str, command: DriveCommand) -> None:
        """Apply the command of an agent, if it may be applied to its last state."""
        if not self._lockstep.record_answer(agent, command):
            self._world.claims.rejected["step"] += 1
        elif self._world.command(agent, command):
            self._warn_of_withheld(agent, command.withheld_hz)
            now_ns = self._pacing.now_ns()
            self._note_command(agent, command.claims, now_ns)
            self._resting.note(
                agent,
                command.rest_ns,
                time_ns=self._world.clock.time_ns,
                now_ns=now_ns,
                version=self._version,
            )
            self._agents.graces.pop(agent, None)
            self._commands.note_taken(agent, (command.epoch, command.step))
            self._world.record_ready_time(agent, now_ns)

    def _warn_of_withheld(self, agent: str, withheld_hz: int) -> None:
        """Warn once each time that an agent begins to withhold messages."""
        if not withheld_hz:
            self._withholding.discard(agent)
        elif agent not in self._withholding:
            self._withholding.add(agent)
            message = (
                f"agent '{agent}' withholds {withheld_hz} messages a second from subscribers by "
                "wildcard; subscribe to fewer robots"
            )
            self._world.clock.add_event("warning", agent=agent, message=message)


class LoopClock(Protocol):
    """Wall time, and CPU time of the thread."""

    def now_ns(self) -> int:
        """Read monotonic wall time."""

    def used_ns(self) -> int:
        """Read the CPU time of this thread."""

    def sleep(self, seconds: float) -> None:
        """Sleep for a wall time."""


def _make_authorization(
    parts: ServerParts, users: AuditedUsers | None
) -> RequestAuthorization | None:
    if users is None:
        return None
    audit = AuditTrail(users, parts.pacing.loop_stats, parts.pacing.now_ns)
    return RequestAuthorization(users, parts.world.entities, audit)


class ServerLoop:
    """Loop of one world.

    Attributes:
        telemetry: Messages of the topics of the world.
        world_map: Map of what is fixed.
        agent_sessions: States to agents, and their commands.
    """

    def __init__(
        self,
        parts: ServerParts,
        inbox: Inbox,
        publisher: WorldPublisher,
        clock: LoopClock,
        journal: ChangeJournal | None = None,
        users: AuditedUsers | None = None,
    ) -> None:
        self._world, self._pacing = parts.world, parts.pacing
        self.status = ProgramStatus()
        """Status that notes each turn."""
        self.node_answers: NodeAnswers | None = None
        """ROS nodes in lockstep; None without ROS."""
        self._descriptions = parts.descriptions
        self._loop_stats = parts.pacing.loop_stats
        self._inbox = inbox
        self._publisher = publisher
        self._clock = clock
        self._deadline_ns = clock.now_ns()
        self._stepped_ns, self._called_ns = -EAGER_NS, -BUSY_NS
        """Wall time of the last requested step."""
        self._paced_ns = 0
        self._factor = parts.pacing.target_real_time_factor
        self.world_map = make_world_map(parts, publisher)
        self.telemetry = WorldTelemetry(parts.world, parts.pacing, parts.sensors, self.world_map)
        self._contacts = ContactTelemetry(parts.world, parts.store.vertices)
        self._authorization = _make_authorization(parts, users)
        self._inputs = InputLog(
            parts, partial(publisher.is_wanted, INPUTS), partial(publisher.publish, INPUTS)
        )
        self._dispatcher = self._make_dispatcher(parts, journal)
        self._budget = RequestBudget(clock.used_ns)
        self._busy_refusals = 0
        """Refusals in the present window of statistics."""
        self._requests = RequestQueue(self._budget, inbox.has_reply_backlog)
        self._has_looked_at_all = True
        """Whether all pending requests were looked at since descriptions were parsed."""
        self._sensor_sessions = SensorSessions(parts, inbox, publisher)
        self.agent_sessions = AgentSessions(parts, inbox, publisher, self._sensor_sessions)

    def _make_dispatcher(
        self, parts: ServerParts, journal: ChangeJournal | None
    ) -> RequestDispatcher:
        made = RequestDispatcher(
            ServiceHandlers(parts),
            self.telemetry,
            self._loop_stats,
            partial(keys.service, parts.world.name),
            journal,
            self._authorization,
        )
        made.inputs = self._inputs
        return made

    @property
    def request_counts(self) -> RequestCounts:
        """Counts of handled requests."""
        return self._dispatcher.counts

    def save(self) -> SavedLoop:
        """Take the state beside that of the world; see `load`."""
        return self.telemetry.save(), self._contacts.save(), self.agent_sessions.save()

    def load(self, saved: SavedLoop) -> None:
        """Replace what `save` took; the map is drawn again."""
        due_times, touching, sessions = saved
        self.telemetry.load(due_times)
        self._contacts.load(touching)
        self.agent_sessions.load(sessions)
        self.world_map.restart()

    def make_requested_steps(self, finish_step: Callable[[], None]) -> None:
        """Make all requested steps of a paused world whose agents answer when they are called.

        Args:
            finish_step: Lets them answer the states that were published, after each step.
        """
        goals, clock = self._pacing.step_goals, self._world.clock
        while goals.has_steps_left and clock.state == State.PAUSED:
            self.tick(self._clock.now_ns())
            finish_step()
            goals.note_step()
        goals.finish_completed()

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Run until `should_stop`, or until a request to quit has its reply."""
        while not (should_stop() or self._has_quit):
            self.turn()

    def drain(self, ends_at_once: Callable[[], bool]) -> None:
        """Finish the requests that were accepted, for `MAX_DRAIN_NS` at most; refuse new changes.

        Args:
            ends_at_once: Whether to leave the rest.
        """
        self.status.drain()
        LOG.info("stopping world=%s", self._world.name)
        self._dispatcher.is_draining = True
        end_ns = self._clock.now_ns() + MAX_DRAIN_NS
        while not (self._is_drained or self._has_quit):
            if ends_at_once() or self._clock.now_ns() >= end_ns:
                LOG.warning("stopped with open requests world=%s", self._world.name)
                break
            self.turn()
        self._inbox.settle_replies(SETTLE_S)

    @property
    def _is_drained(self) -> bool:
        return self._requests.is_idle and not self._dispatcher.has_open_requests

    def close(self) -> None:
        """Publish the last inputs; keep what the audit has not kept yet."""
        self._inputs.close()
        if self._authorization is not None:
            self._authorization.audit.close()

    @property
    def _has_quit(self) -> bool:
        return self._world.clock.state == State.QUITTING and not self._dispatcher.has_unsent_replies

    def turn(self) -> None:
        """Serve the input received, then step if one is due, else sleep."""
        began_ns, self._paced_ns = self._clock.used_ns(), 0
        self.status.note_turn()
        self.serve()
        if self.agent_sessions.must_wait():
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
        refusals_left = min(MAX_TURN_REFUSALS, MAX_BUSY_REFUSALS - self._busy_refusals)
        for call in self._inbox.take_calls():
            refusals_left -= self._queue(call, may_refuse=refusals_left > 0)
        self.agent_sessions.serve()
        self._sensor_sessions.serve()
        if self.node_answers is not None:
            self.node_answers.serve()
        if not self._waits_for_deadline:
            self._budget.begin_slice()
        self._handle_requests()
        self._reply_to_pending()
        self.agent_sessions.publish_changed_claims()
        self.agent_sessions.publish_ordered_twists()
        self.agent_sessions.publish_unanswered()

    def _queue(self, call: ServiceCall, *, may_refuse: bool) -> bool:
        """Let a request wait, refuse it or end it without a value; return whether it is refused."""
        if not may_refuse and not self._requests.has_room(call.client):
            self.request_counts.refused_unread += 1
            call.drop()  # unread
            return False
        self._called_ns = self._clock.now_ns()
        try:
            self._requests.add(call)
        except RequestBusy as error:
            self.request_counts.refused_unread += 1
            if not may_refuse:
                call.drop()
                return False
            self._busy_refusals += 1
            self._dispatcher.refuse(call, error)
            return True
        return False

    def _handle_requests(self) -> None:
        while (call := self._requests.take_next()) is not None:
            with self._budget.charge(call.client, REQUEST_FEE_NS):
                self._dispatcher.take(call)

    def _reply_to_pending(self) -> None:
        has_new = self._descriptions.provider.poll()
        self._descriptions.has_new = has_new or not self._has_looked_at_all
        self._has_looked_at_all = self._dispatcher.reply_to_ready(self._budget)
        if (settle_s := self._time_to_settle_s()) > 0.0:
            self._inbox.settle_replies(settle_s)

    def _time_to_settle_s(self) -> float:
        """Find how long to wait for replies to leave: a step that is due does not wait."""
        if not self._waits_for_deadline:
            return SETTLE_S
        return min(SETTLE_S, (self._deadline_ns - self._clock.now_ns()) * 1e-9)

    @property
    def _waits_for_deadline(self) -> bool:
        """Whether requests take time from steps: time runs, and no agent is awaited."""
        is_stepped = self._pacing.lockstep.is_waiting or self._pacing.step_goals.has_steps_left
        return self._world.clock.state == State.PLAYING and not is_stepped

    def tick(self, now_ns: int) -> None:
        """Advance by one step; publish drive states and scene states if it is a control step."""
        self.agent_sessions.stop_silent_agents(now_ns)
        self._world.step()
        took_ns = self._clock.now_ns() - now_ns
        late_ns = max(0, now_ns - self._deadline_ns)
        wall_step_ns = self._wall_step_ns
        spare_ns = wall_step_ns - late_ns - took_ns
        self._budget.begin_step(max(took_ns, wall_step_ns), late_ns, spare_ns)
        self._loop_stats.note_step(
            simulated_ns=self._world.clock.step_ns, took_ns=took_ns, late_ns=late_ns
        )
        if self._world.is_control_step:
            if self._inputs.is_active:
                self._inputs.note_control_step()
            with self._publisher.hold_messages():
                # First the contacts: an agent that replies to a state has them.
                self._publish_contacts()
                self.agent_sessions.publish_states()
                self._sensor_sessions.publish_state()
            self.agent_sessions.wake_joined_clients()
            if self.node_answers is not None and self._pacing.answers.has_topics:
                self._publisher.publish(CLOCK, self.telemetry.clock())
                self.node_answers.note_clock()

    def _publish_contacts(self) -> None:
        wanted = [topic for topic in (CONTACTS, EVENTS) if self._publisher.is_wanted(topic)]
        if wanted and self._contacts.has_sensors:
            try:
                contacts = self._contacts.read()
            except SimError as error:  # the file of a mesh is gone
                LOG.warning("contacts not published reason=%s", error)
                return
            if CONTACTS in wanted:
                self._publisher.publish(CONTACTS, contacts)

    def publish(self) -> None:
        """Publish events, progress, statistics and the topics that are due."""
        self.publish_events(MAX_EVENTS_PER_TURN)
        if self._authorization is not None:
            for record in self._authorization.audit.take():
                self._publisher.publish(AUDIT, record)
        now_ns = self._clock.now_ns()
        self._publish_progress(now_ns)
        if self._loop_stats.close_window(now_ns):
            self._busy_refusals = 0
            if self._publisher.is_wanted(STATS):
                self._publisher.publish(STATS, self.telemetry.stats())
        self._inputs.poll(now_ns)  # before the clock, whose reset ends the file of a recorder
        self.publish_due(now_ns)

    def publish_events(self, most: int | None = None) -> None:
        """Publish events, `most` of them; the others stay."""
        for event in self._world.clock.take_events(most):
            LOG.info(
                "event kind=%s entity=%s agent=%s message=%s",
                event.kind,
                event.entity,
                event.agent,
                event.message,
            )
            self._publisher.publish(EVENTS, event)

    def publish_due(self, now_ns: int) -> None:
        """Publish the topics that are due at a time, and the map if it has changed."""
        for topic in self.telemetry.due(now_ns):
            if self._publisher.is_wanted(topic) and self.telemetry.can_make(topic):
                self._publisher.publish(topic, self.telemetry.message(topic))
        self.world_map.poll(now_ns)

    def _advance(self, now_ns: int) -> None:
        self._apply_speed_change(now_ns)
        if self._pacing.step_goals.has_steps_left:
            self._make_requested_step(now_ns)
        elif self._world.clock.state != State.PLAYING:
            # A client that steps sends its next request soon.
            is_stepped = now_ns - self._stepped_ns < EAGER_NS
            self._deadline_ns = now_ns
            if self._requests.is_idle:
                self._clock.sleep(EAGER_POLL_S if is_stepped else IDLE_POLL_S)
        elif now_ns >= self._deadline_ns:
            self.tick(now_ns)
            self._set_deadline()
        else:
            pause_s = POLL_S if now_ns - self._called_ns < BUSY_NS else IDLE_POLL_S
            self._clock.sleep(min(pause_s, (self._deadline_ns - now_ns) * 1e-9))

    def _apply_speed_change(self, now_ns: int) -> None:
        """Restart pacing when the target speed has changed: the old deadline may be far away."""
        if self._factor != self._pacing.target_real_time_factor:
            self._factor = self._pacing.target_real_time_factor
            self._deadline_ns = now_ns

    @property
    def _wall_step_ns(self) -> int:
        """Wall time of a step at the target speed; 0 if it is as fast as possible."""
        return round(self._world.clock.step_ns / self._factor) if self._factor > 0.0 else 0

    def _set_deadline(self) -> None:
        now_ns = self._clock.now_ns()
        if self._factor <= 0.0:
            self._deadline_ns = now_ns
            return
        self._paced_ns = self._wall_step_ns
        self._deadline_ns += self._paced_ns
        if (lag_ns := now_ns - self._deadline_ns) > MAX_LAG_NS:
            self._loop_stats.slipped_ns += lag_ns
            self._deadline_ns, self._paced_ns = now_ns, 0

    def _make_requested_step(self, now_ns: int) -> None:
        self._deadline_ns = self._stepped_ns = now_ns
        self.tick(now_ns)
        self._pacing.step_goals.note_step()
        if not self._pacing.lockstep.is_waiting or self._pacing.step_goals.ends_eagerly:
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
        self._dispatcher.reply_to_ready(self._budget)
        self._inbox.settle_replies(SETTLE_S)

    def _publish_progress(self, now_ns: int) -> None:
        for progress in self._pacing.step_goals.due_progress(now_ns):
            self._publisher.publish(STEPS_PROGRESS, progress)
