"""Agent sessions: drive states, drive commands, liveliness, waiting in lockstep."""

import logging

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.keys import parse_agent
from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import EVENTS
from zensim.sim_server.runtime.loop_channels import Inbox, WorldPublisher
from zensim.sim_server.service_parts import Agents, Bonds, Pacing
from zensim.sim_server.world.simulated_world import World

MIN_STATE_INTERVAL_NS = 2_000_000
"""Least wall time between two states when the loop does not wait for commands."""
RESEND_AFTER_NS = 20_000_000
"""Wall time after which a state is published again to an agent that has not replied."""
LOG = logging.getLogger(__name__)


class AgentSessions:
    """Publish drive states, apply drive commands, and wait for agents in lockstep."""

    def __init__(
        self,
        world: World,
        pacing: Pacing,
        agents: Agents,
        bonds: Bonds,
        inbox: Inbox,
        publisher: WorldPublisher,
    ) -> None:
        self._world = world
        self._pacing = pacing
        self._lockstep = pacing.lockstep
        self._agents = agents
        self._bonds = bonds
        self._inbox = inbox
        self._publisher = publisher
        self._published_version = self._version
        self._published_ns = -MIN_STATE_INTERVAL_NS
        self._has_unsent_states = False
        """Whether an agent did not get the state of the last control step."""
        self._awaited_since_ns: dict[str, int] = {}
        """By agent: wall time of a state that it has not replied to."""

    def serve(self) -> None:
        """Handle liveliness changes, then apply drive commands."""
        for agent, is_alive in self._inbox.take_agents():
            self._on_agent_liveliness(agent, is_alive=is_alive)
        for bond, is_alive in self._inbox.take_bonds():
            self._on_bond_liveliness(bond, is_alive=is_alive)
        for sample in self._inbox.take_commands():
            self._command(sample)

    def publish_states(self) -> None:
        """Publish the state of a control step to every agent.

        When simulation time runs faster than wall time, agents that have not replied are left out.
        """
        now_ns = self._pacing.now_ns()
        runs_fast = self._is_unpaced
        if runs_fast and now_ns - self._published_ns < MIN_STATE_INTERVAL_NS:
            self._has_unsent_states = True
            return
        self._published_ns = now_ns
        busy = self._find_busy_agents(now_ns) if runs_fast else frozenset()
        self._has_unsent_states = bool(busy)
        for agent, state in self._world.drive_states(busy):
            self._publish_state(agent, state)
        self._published_version = self._version

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

    def must_wait(self) -> bool:
        """Whether the next step must wait; apply `LockstepSettings.on_miss` to late agents."""
        if not self._lockstep.is_waiting:
            return False
        late = self._lockstep.find_late(self._pacing.now_ns())
        if late and self._lockstep.settings.on_miss == "wait":
            self._publish_again(late)
        elif late:
            self._miss(late)
        return self._lockstep.is_waiting

    @property
    def _is_awaited(self) -> bool:
        return self._lockstep.settings.is_on or len(self._pacing.step_goals) > 0

    @property
    def _is_unpaced(self) -> bool:
        is_paced = 0.0 < self._pacing.target_real_time_factor <= 1.0
        return not (is_paced or self._is_awaited) and self._world.clock.state == State.PLAYING

    @property
    def _version(self) -> tuple[int, int]:
        return self._world.clock.epoch, self._world.claims.changes

    def _find_busy_agents(self, now_ns: int) -> frozenset[str]:
        """Find the agents that have not replied to their last state."""
        sent = self._awaited_since_ns.items()
        return frozenset(agent for agent, sent_ns in sent if now_ns - sent_ns < RESEND_AFTER_NS)

    def _publish_state(self, agent: str, state: DriveState) -> None:
        sent = msgspec.structs.replace(
            state,
            newest_claim=self._world.claims.newest,
            is_awaited=self._is_awaited,
        )
        self._publisher.publish_drive_state(agent, sent)
        self._awaited_since_ns[agent] = self._pacing.now_ns()
        if not sent.claims:
            self._lockstep.forget(agent)
        elif not self._lockstep.record_sent(agent, sent, self._pacing.now_ns()):
            self._pacing.step_goals.note_late((agent,))

    def _publish_again(self, late: tuple[str, ...]) -> None:
        """Publish states again: a congested network drops messages."""
        for agent, state in self._world.drive_states():
            if agent in late:
                self._publish_state(agent, state)

    def _miss(self, late: tuple[str, ...]) -> None:
        settings, step = self._lockstep.settings, self._world.clock.steps
        for agent in late:
            text = f"agent '{agent}' did not reply to step {step} within {settings.timeout_s:g} s"
            LOG.warning("missed agent=%s step=%d on_miss=%s", agent, step, settings.on_miss)
            event = Event("missed", "", agent, step, self._world.clock.epoch, text)
            self._publisher.publish(EVENTS, event)
        if settings.on_miss == "fail":
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
        self._world.release(agent)
        self._lockstep.forget(agent)
        self._awaited_since_ns.pop(agent, None)
        self._publisher.forget_agent(agent)

    def _on_bond_liveliness(self, bond: str, *, is_alive: bool) -> None:
        if is_alive:
            self._bonds.alive.add(bond)
        else:
            self._bonds.end(bond)

    def _command(self, sample: Sample) -> None:
        agent = parse_agent(sample.key)
        self._awaited_since_ns.pop(agent, None)
        try:
            command = decode(DriveCommand, sample.payload, sample.encoding)
        except MalformedPayload as error:
            self._world.claims.dropped += 1
            LOG.debug("drive command dropped agent=%s reason=%s", agent, error)
            return
        if not self._lockstep.record_answer(agent, command):
            self._world.claims.dropped += 1
        elif self._world.command(agent, command):
            self._world.record_ready_time(agent, self._pacing.now_ns())
