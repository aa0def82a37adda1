"""The agent process: connects, claims robots, drives them at each drive state and does the housekeeping."""

import logging
import math
import signal
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from typing import Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.bus import BusConfig, open_bus_with_retry
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.network_protocols import AgentNetwork
from zensim.proto.process_limits import set_niceness
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.stop_signal import STOP_SIGNALS, StopFlag
from zensim.proto.topic_catalog import DRIVE_COMMAND, DRIVE_STATE
from zensim.robot_agent.agent_config import AgentConfig, AgentProcessConfig, override_rates
from zensim.robot_agent.agent_timing import (
    MAX_COMMAND_PAUSE_S,
    MAX_PAUSE_S,
    LateCommandWindow,
    PollSchedule,
    ProcessPriority,
)
from zensim.robot_agent.claim_client import (
    ClaimSettings,
    NamedClaimClient,
    ShareClaimClient,
    ShareSettings,
)
from zensim.robot_agent.drive_state_decoder import StateOrder
from zensim.robot_agent.robots import IndividualRobots

ANNOUNCE_PERIOD_S = 0.2
LOG_PERIOD_S = 1.0


class HousekeepingTarget(Protocol):
    """Robots that are looked after."""

    def answer(self) -> None:
        """Tell last values to those who have asked."""

    def announce(self) -> None:
        """Publish what never changes to those who have begun to listen."""

    def log_malformed(self) -> None:
        """Log which commands were malformed."""


class Housekeeping:
    """Answers questions, greets new listeners, and says what was malformed."""

    def __init__(self, kept: HousekeepingTarget) -> None:
        self._target = kept
        self._announce_s = self._log_s = 0.0

    def poll(self, now_s: float) -> None:
        """Answer, and do what else is due."""
        self._target.answer()
        if now_s >= self._announce_s:
            self._announce_s = now_s + ANNOUNCE_PERIOD_S
            self._target.announce()
        if now_s >= self._log_s:
            self._log_s = now_s + LOG_PERIOD_S
            self._target.log_malformed()


LOG = logging.getLogger("zensim.agent")
HOUSEKEEPING_PERIOD_S = 0.02
"""Pause between looks for anything else: none of it is urgent, and each look costs."""


MAX_LOGGED_CLAIMS = 20
"""Of more at once, only the number is told."""


class ClaimClient(Protocol):
    """Asks for entities; `NamedClaimClient` by name, `ShareClaimClient` for a share."""

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Ask if it is time to."""

    def retry_soon(self) -> None:
        """Ask soon: something has changed."""

    def reclaim(self, entities: tuple[str, ...]) -> None:
        """Learn that entities were lost."""


class RobotSet(HousekeepingTarget, Protocol):
    """The robots that are held; `IndividualRobots` has them one by one, `PooledRobots` in arrays."""

    newest_claim: int

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Hold what was claimed."""

    def release_all_except(self, claims: bytes) -> tuple[str, ...]:
        """Let go all others, and name them."""

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held."""

    def reset(self) -> None:
        """Start all robots again."""

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive by one control period."""

    def revise(self) -> DriveCommand | None:
        """Answer the last state anew if a command that came since changes the answer."""

    def publish(self) -> None:
        """Publish what the last state made due."""


class Agent:
    """One process's part in the world; it moves only when polled."""

    def __init__(self, network: AgentNetwork, config: AgentConfig) -> None:
        world, agent = config.world, config.agent
        self.malformed = 0
        """Drive states that were not understood."""
        self._network = network
        self._config = config
        # A claim is bound to the token, which has to be up before.
        self._token = network.token(keys.alive_agent(world, agent))
        self._servers = network.watch_tokens(keys.alive_server(world))
        # What comes is matched against all that its session has declared: 0.2 ms a message with a
        # thousand publishers. States come with commands, so that one link keeps their order.
        self._rx_session = network if config.pool_limit is None else network.open_session()
        self._states = self._rx_session.subscribe(DRIVE_STATE.key(world, agent))
        self._commands = network.advertise(DRIVE_COMMAND.key(world, agent), DRIVE_COMMAND.encoding)
        self._graph = RosGraph(network, config.ros)
        self._claim_client = _make_claim_client(network, config)
        self._robots = _make_robot_set(network, config, self._graph, self._rx_session)
        self._state_order = StateOrder()
        self._housekeeping = Housekeeping(self._robots)
        self._priority = ProcessPriority(set_niceness)
        self._poll_schedule = PollSchedule(
            MAX_COMMAND_PAUSE_S if config.pool_limit is None else MAX_PAUSE_S
        )
        self._late_command_window = LateCommandWindow()
        self._housekeeping_s = self._now_s = -math.inf

    def close(self) -> None:
        """Withdraw what is not withdrawn with the session."""
        self._graph.close()
        if self._rx_session is not self._network:
            self._rx_session.close()

    def pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s] before the next poll."""
        return self._poll_schedule.pause_s(now_s)

    def poll(self, now_s: float) -> bool:
        """Do what there is to do; tell whether there was a drive state.

        Args:
            now_s: Wall time, from any beginning.

        Raises:
            ServiceError: See `NamedClaimClient.poll`, as for the others.
            NoServer: See there.
            TimeoutError: See there.
            MalformedPayload: See there.
        """
        self._now_s = now_s
        if now_s >= self._housekeeping_s:
            self._housekeeping_s = now_s + HOUSEKEEPING_PERIOD_S
            self._do_housekeeping(now_s)
        return self._drive()

    def _do_housekeeping(self, now_s: float) -> None:
        self._watch_server()
        claims = self._claim_client.poll(now_s)
        if claims:
            self._add_claims(claims)
        self._housekeeping.poll(now_s)

    def _watch_server(self) -> None:
        for _, is_alive in self._servers.take():
            if is_alive:
                self._claim_client.retry_soon()
                continue
            self._state_order.forget()
            self._handle_lost(self._robots.release_all_except(b""), "the server is gone")

    def _add_claims(self, claims: tuple[Claim, ...]) -> None:
        self._robots.add_claims(override_rates(claims, self._config.rates))
        if len(claims) > MAX_LOGGED_CLAIMS:
            LOG.info("claimed agent=%s entities=%d", self._config.agent, len(claims))
            return
        for claim in claims:
            LOG.info(
                "claimed agent=%s entity=%s namespace=%s claim=%d",
                self._config.agent,
                claim.entity,
                claim.namespace,
                claim.claim,
            )

    def _drive(self) -> bool:
        sample = self._states.newest()
        if sample is None:
            self._revise()
            return False
        try:
            state = decode(DriveState, sample.payload, sample.encoding)
            self._poll_schedule.note_state(self._now_s, is_awaited=state.is_awaited)
            self._priority.note_state(self._now_s, state)
            self._follow(state)
        except MalformedPayload as error:
            self.malformed += 1
            if self.malformed == 1:
                LOG.warning("drive_state agent=%s reason=%r", self._config.agent, str(error))
        return True

    def _follow(self, state: DriveState) -> None:
        # An older state does not speak of the newest claim.
        if state.newest_claim < self._robots.newest_claim or not self._robots.holds(state.claims):
            return
        order = self._state_order.place(state.epoch, state.step)
        if order == "stale":
            return
        if order == "reset":
            self._robots.reset()
        self._handle_lost(self._robots.release_all_except(state.claims), "the entity is gone")
        if not state.claims:
            return
        payload = encode(self._robots.advance(state), Format.MSGPACK)
        self._late_command_window.note_state(state, self._now_s)
        if state.is_awaited:
            # One link keeps the order: who sees the command has seen what the state made due.
            self._robots.publish()
            self._commands.send(payload)
        else:
            self._commands.send(payload)
            self._robots.publish()

    def _revise(self) -> None:
        """Let a command that has come since the last state take effect before the next one."""
        if not self._late_command_window.is_open(self._now_s):
            return
        if (command := self._robots.revise()) is not None:
            self._commands.send(encode(command, Format.MSGPACK))
            self._late_command_window.close()

    def _handle_lost(self, entities: tuple[str, ...], reason: str) -> None:
        if not entities:
            return
        self._claim_client.reclaim(entities)
        if len(entities) > MAX_LOGGED_CLAIMS:
            LOG.info(
                "lost agent=%s entities=%d reason=%r", self._config.agent, len(entities), reason
            )
            return
        for entity in entities:
            LOG.info("lost agent=%s entity=%s reason=%r", self._config.agent, entity, reason)


def run_agent(
    network: AgentNetwork,
    config: AgentConfig,
    should_stop: Callable[[], bool],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Hold and drive entities until told to stop, or until they cannot be had.

    Raises:
        ServiceError: See `NamedClaimClient.poll`, as for the others.
        NoServer: See there.
        TimeoutError: See there.
        MalformedPayload: See there.
    """
    with closing(Agent(network, config)) as agent:
        while not should_stop():
            agent.poll(clock())
            sleep(agent.pause_s(clock()))


def _make_robot_set(
    network: AgentNetwork, config: AgentConfig, graph: RosGraph, ears: AgentNetwork
) -> RobotSet:
    timeout_ns = round(config.cmd_vel_timeout_s * NANOSECONDS)
    if config.pool_limit is None:
        return IndividualRobots(network, timeout_ns, graph)
    # Numpy and what is made of arrays are half of what an agent has to load, and 10 MB.
    from zensim.robot_agent.pool.pooled_robots import PooledRobots  # noqa: PLC0415

    return PooledRobots(network, timeout_ns, graph, ears)


def _make_claim_client(network: AgentNetwork, config: AgentConfig) -> ClaimClient:
    if config.pool_limit is None:
        wish = ClaimSettings(
            world=config.world,
            agent=config.agent,
            entities=config.entities,
            on_release=config.on_release,
            wait_s=config.wait_s,
        )
        return NamedClaimClient(network, wish)
    share = ShareSettings(
        world=config.world,
        agent=config.agent,
        limit=config.pool_limit,
        on_release=config.on_release,
        wait_s=config.wait_s,
    )
    return ShareClaimClient(network, share)


MAX_ENTITY_CHARACTERS = 48
"""Of its name, in a made-up name of an agent."""


def run_agent_process(start: AgentProcessConfig) -> None:
    """Stay until stopped, which is how an agent ends well; one without a name makes one up.

    Raises:
        Unreachable: Nobody listens at the endpoint.
        ServiceError: See `run_agent`, as for the others.
    """
    logging.basicConfig(
        level=logging.WARNING if start.is_quiet else logging.INFO,
        format="%(levelname)s %(name)s %(message)s",
        stream=sys.stderr,
    )
    config = start.config
    # Opening does not return to Python; until there is a token to withdraw, a signal just ends it.
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    deadline_s = time.monotonic() + config.wait_s
    with open_bus_with_retry(BusConfig(connect=(start.endpoint,)), config.wait_s) as bus:
        left_s = max(0.0, deadline_s - time.monotonic())
        name = config.agent or _make_agent_name(config)
        # An interrupt in what Python calls by itself is lost: the flag is looked at, too.
        with suppress(KeyboardInterrupt):
            stop = StopFlag(is_armed=False)
            run_agent(bus, msgspec.structs.replace(config, agent=name, wait_s=left_s), stop)


def _make_agent_name(config: AgentConfig) -> str:
    entity = config.entities[0] if config.entities else "pool"
    return f"agent_{entity[:MAX_ENTITY_CHARACTERS]}_{uuid.uuid4().hex[:4]}"
