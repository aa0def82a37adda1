"""The agent process: claims robots, drives them at each drive state, does housekeeping."""

import logging
import math
import signal
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, nullcontext, suppress
from typing import Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus_with_retry, receive_in_one_thread
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.json_logs import CONTEXT
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.process_messages import AgentStats
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.metric_families import DurationHistogram, MetricFamily, make_counter, make_gauge
from zensim.proto.network_protocols import AgentNetwork, Subscription
from zensim.proto.poll_schedule import MAX_PAUSE_S, PollSchedule
from zensim.proto.process_limits import set_niceness
from zensim.proto.program_status import CLIENT_TURN_S, ProgramStatus, make_program_status
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.rosout import Rosout
from zensim.proto.served_status import served_status
from zensim.proto.stats_publisher import StatsPublisher, read_process_usage
from zensim.proto.stop_signal import STOP_SIGNALS, StopFlag
from zensim.proto.subscriber_search import SubscriberWatches
from zensim.proto.topic_catalog import AGENT_STATS, CONTACTS, DRIVE_COMMAND, DRIVE_STATE
from zensim.proto.verbosity import configure_logging
from zensim.robot_agent.agent_config import AgentConfig, AgentProcessConfig, override_rates
from zensim.robot_agent.answer_times import EarlyState, LateCommandWindow
from zensim.robot_agent.bumpers import ContactReport, read_contact_report
from zensim.robot_agent.claim_client import (
    ClaimSettings,
    NamedClaimClient,
    ShareClaimClient,
    ShareSettings,
)
from zensim.robot_agent.collected_objects import CollectedObjects
from zensim.robot_agent.drive_state_decoder import CLAIM_BYTES, StateOrder
from zensim.robot_agent.fleet_odometry import FleetOdometryPublisher, MotionRows
from zensim.robot_agent.process_priority import ProcessPriority
from zensim.robot_agent.rest_schedule import RestSchedule
from zensim.robot_agent.robots import IndividualRobots

MAX_COMMAND_PAUSE_S = 0.0035
"""Maximum pause of an agent that applies late commands."""
ANNOUNCE_PERIOD_S = 0.2
LOG_PERIOD_S = 1.0
LOG = logging.getLogger("zensim.agent")
HOUSEKEEPING_PERIOD_S = 0.02
"""Period of everything but driving, which is not urgent."""
SLOW_HOUSEKEEPING_PERIOD_S = 0.1
"""The same with robots where requests end the pause: then only what is due by time is left."""
Answer = tuple[tuple[int, int, bytes, int] | None, bytes]
"""Epoch, step, claims and order of a state that was answered, and the command."""
NO_ANSWER: Answer = None, b""
MAX_LOGGED_CLAIMS = 20
"""Most robots claimed at once that are named; of more only the number is logged."""
REST_POLL_S = 0.01
"""Period of a pool that polls for commands while it needs no states."""
CONTACTS_DEPTH = 64
"""Control steps whose contacts may wait."""
MAX_ENTITY_CHARACTERS = 48
"""Most characters of the entity name in a generated agent name."""


class HousekeepingTarget(Protocol):
    """Robots that need housekeeping."""

    def reply_to_queries(self) -> None:
        """Reply to queries with the last values."""

    def announce(self) -> None:
        """Publish static topics to new subscribers."""

    def log_malformed(self) -> None:
        """Log malformed commands."""


class Housekeeping:
    """Replies to queries, publishes to new subscribers and logs malformed commands."""

    def __init__(self, target: HousekeepingTarget) -> None:
        self._target = target
        self._announce_s = self._log_s = 0.0

    def poll(self, now_s: float) -> None:
        """Reply to queries, and do what else is due."""
        self._target.reply_to_queries()
        if now_s >= self._announce_s:
            self._announce_s = now_s + ANNOUNCE_PERIOD_S
            self._target.announce()
        if now_s >= self._log_s:
            self._log_s = now_s + LOG_PERIOD_S
            self._target.log_malformed()


class RobotSet(HousekeepingTarget, Protocol):
    """The robots of an agent; `IndividualRobots` one by one, `PooledRobots` in arrays."""

    newest_claim: int

    def add_claims(self, claims: Sequence[Claim]) -> None:
        """Add the robots of new claims."""

    def release_all_except(self, claims: bytes) -> tuple[str, ...]:
        """Release all other robots; return their entities."""

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held."""

    def reset(self) -> None:
        """Reset all robots."""

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive each robot by one control period."""

    def repeats(self, state: DriveState) -> bool:
        """Whether a state has the step and claims of the last one that was answered."""

    def repeat(self, state: DriveState) -> DriveCommand:
        """Answer the last state again, with the ordered twists of this one."""

    def revise(self) -> DriveCommand | None:
        """Answer the last state again if a command that came since changes the answer."""

    def is_idle(self) -> bool:
        """Whether no robot has a subscriber, a valid `cmd_vel`, or anything that moves by time."""

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update of a drive counts; what comes now ends a rest."""

    def publish(self) -> None:
        """Publish what is due at the last state."""

    def list_odometry(self) -> Iterable[MotionRows]:
        """List the odometry that was due at the last state."""

    @property
    def wants_contacts(self) -> bool:
        """Whether a contact sensor may have a subscriber."""

    def publish_contacts(self, report: ContactReport) -> None:
        """Publish what contact sensors feel."""


class Agent:
    """The agent of one process; it acts only in `poll`."""

    _answer = NO_ANSWER
    """Answer to the last state."""

    def __init__(self, network: AgentNetwork, config: AgentConfig) -> None:
        world, agent = config.world, config.agent
        self.malformed = 0
        """Number of malformed drive states and contacts."""
        self._network = network
        self._config = config
        # A claim is bound to the token, which must exist before.
        self._token = network.token(keys.alive_agent(world, agent))
        self._servers = network.watch_tokens(keys.alive_server(world))
        # A session matches each message with all its declarations: 0.2 ms with a thousand
        # publishers. States and commands share a session, so that their order is kept.
        self._rx_session = network if config.pool_limit is None else network.open_session()
        self._states = self._rx_session.subscribe(DRIVE_STATE.key(world, agent))
        self._contacts: Subscription | None = None
        """Subscription while a contact sensor has a subscriber."""
        self._commands = network.advertise(DRIVE_COMMAND.key(world, agent), DRIVE_COMMAND.encoding)
        self._graph = RosGraph(network, config.ros)
        self._rosout = Rosout(network, self._graph)
        self._claim_client = _make_claim_client(network, config)
        self._watches = SubscriberWatches(network)
        self._robots = _make_robot_set(
            network, config, self._graph, self._rx_session, self._watches
        )
        self._state_order, self._early_state = StateOrder(), EarlyState()
        self._housekeeping = Housekeeping(self._robots)
        self._answered, self._claims = 0, b""
        self._cycles = DurationHistogram()
        """Wall times from a state to its answer."""
        self._stats = StatsPublisher(
            network, AGENT_STATS, AGENT_STATS.key(world, agent), self.make_stats
        )
        self._odometry = FleetOdometryPublisher(network, world, agent)
        self._priority = ProcessPriority(set_niceness)
        self._objects = None if config.pool_limit is None else CollectedObjects()
        self._poll_schedule = _make_poll_schedule(config, is_woken=network.arrivals is not None)
        self._late_command_window = LateCommandWindow()
        self._rest = RestSchedule()
        self._housekeeping_s = self._now_s = -math.inf

    def close(self) -> None:
        """Undeclare what is not part of the session."""
        self._rosout.close()
        self._stats.close()
        self._odometry.close()
        self._graph.close()
        self._watches.close()
        if self._rx_session is not self._network:
            self._rx_session.close()

    def minimum_pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s] first, whatever arrives."""
        return self._poll_schedule.minimum_pause_s(now_s)

    def pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s] before the next poll."""
        if self._network.arrivals is not None:
            return max(0.0, self._housekeeping_s - now_s)
        return REST_POLL_S if self._rest.is_resting else self._poll_schedule.pause_s(now_s)

    def poll(self, now_s: float) -> bool:
        """Do what is due; return whether there was a drive state.

        Args:
            now_s: Wall time from any origin.

        Raises:
            ServiceError: See `NamedClaimClient.poll`, as for the others.
            NoServer: See there.
            TimeoutError: See there.
            MalformedPayload: See there.
        """
        self._now_s = now_s
        arrivals = self._network.arrivals
        if now_s >= self._housekeeping_s or (arrivals is not None and arrivals.take_requests()):
            is_slow = arrivals is not None and bool(self._claims)
            self._housekeeping_s = now_s + (
                SLOW_HOUSEKEEPING_PERIOD_S if is_slow else HOUSEKEEPING_PERIOD_S
            )
            self._do_housekeeping(now_s)
        with self._network.hold_messages():
            return self._drive()

    def make_stats(self) -> AgentStats:
        """Make the statistics of this process."""
        return AgentStats(
            agent=self._config.agent,
            robots=len(self._claims) // CLAIM_BYTES,
            states=self._answered,
            malformed=self.malformed,
            usage=read_process_usage(),
        )

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List the metrics of this process; another thread calls it."""
        yield make_gauge(
            "zensim_agent_robots", "Robots claimed now.", len(self._claims) // CLAIM_BYTES
        )
        yield make_counter(
            "zensim_agent_commands_total", "Drive states that were answered.", self._answered
        )
        yield make_counter(
            "zensim_agent_malformed_total", "Messages that could not be read.", self.malformed
        )
        yield self._cycles.make_family(
            "zensim_agent_cycle_seconds", "Wall time to handle a drive state."
        )

    def _do_housekeeping(self, now_s: float) -> None:
        self._watch_server()
        claims = self._claim_client.poll(now_s)
        if claims:
            self._add_claims(claims)
        self._housekeeping.poll(now_s)
        self._rosout.poll()
        self._stats.poll(now_s)
        if self._objects is not None:
            self._objects.poll(now_s)
        self._subscribe_to_contacts()

    def _subscribe_to_contacts(self) -> None:
        is_wanted = self._robots.wants_contacts
        if is_wanted and self._contacts is None:
            key = CONTACTS.key(self._config.world)
            self._contacts = self._rx_session.subscribe(key, CONTACTS_DEPTH)
        elif self._contacts is not None and not is_wanted:
            self._contacts.close()
            self._contacts = None

    def _publish_contacts(self) -> None:
        for sample in self._contacts.take() if self._contacts is not None else ():
            contacts = decode(Contacts, sample.payload, sample.encoding)
            self._robots.publish_contacts(read_contact_report(contacts))

    def _watch_server(self) -> None:
        for _, is_alive in self._servers.take():
            if is_alive:
                self._claim_client.retry_soon()
                continue
            self._state_order.forget()
            self._answer = NO_ANSWER
            self._claim_client.forget_call()
            self._early_state.forget()
            self._claims = b""
            self._handle_lost(self._robots.release_all_except(b""), "the server is gone")

    def _add_claims(self, claims: tuple[Claim, ...]) -> None:
        with nullcontext() if self._objects is None else self._objects.adding(self._now_s):
            self._robots.add_claims(override_rates(claims, self._config.rates))
        self._early_state.note_new_claims()
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
        sample = self._states.newest() or self._early_state.take()
        try:
            # The server publishes the contacts of a step before its state.
            self._publish_contacts()
        except MalformedPayload as error:
            self._note_malformed("contacts", error)
        if sample is None:
            self._odometry.send_some()
            self._revise()
            return False
        began_ns = time.perf_counter_ns()
        try:
            state = decode(DriveState, sample.payload, sample.encoding)
            self._poll_schedule.note_state(self._now_s, is_awaited=state.is_awaited)
            self._priority.note_state(self._now_s, state)
            self._early_state.forget()
            if not self._robots.holds(state.claims):
                self._early_state.keep(sample)
            self._follow(state)
        except MalformedPayload as error:
            self._note_malformed("drive_state", error)
        self._cycles.add(time.perf_counter_ns() - began_ns)
        return True

    def _note_malformed(self, subject: str, error: MalformedPayload) -> None:
        self.malformed += 1
        if self.malformed == 1:
            LOG.warning("%s agent=%s reason=%r", subject, self._config.agent, str(error))

    def _follow(self, state: DriveState) -> None:
        # A state from before the newest claim lacks its robot.
        if state.newest_claim < self._robots.newest_claim or not self._robots.holds(state.claims):
            return
        order = self._state_order.classify(state.epoch, state.step)
        if order == "stale":
            return
        if order == "reset":
            self._robots.reset()
        lost = self._robots.release_all_except(state.claims)
        self._claims = state.claims
        self._handle_lost(lost, "the entity is gone")
        if not state.claims:
            return
        key = state.epoch, state.step, state.claims, state.order
        if key == self._answer[0]:
            # The server asks again; commands that came since count from the next state on.
            self._commands.send(self._answer[1])
            return
        if self._robots.repeats(state):
            # The telemetry of this step is published.
            payload = encode(self._robots.repeat(state), Format.MSGPACK)
            self._answer = key, payload
            self._commands.send(payload)
            return
        payload = encode(self._rest_if_idle(state, self._robots.advance(state)), Format.MSGPACK)
        self._answer = key, payload
        self._answered += 1
        self._late_command_window.note_state(state, self._now_s)
        if state.is_awaited:
            # In this order, a receiver of the command has received the telemetry before.
            self._publish(state)
            self._commands.send(payload)
        else:
            self._commands.send(payload)
            # The server should not wait for what is published of its state.
            self._network.send_held()
            self._publish(state)

    def _rest_if_idle(self, state: DriveState, command: DriveCommand) -> DriveCommand:
        """Say in the command how long no state is needed."""
        rest, was_resting = self._rest, self._rest.is_resting
        rest_ns = rest.find_rest_ns(state, command.targets, self._is_idle)
        if rest.is_resting != was_resting:
            self._robots.limit_updates(rest.longest_update_s)
        return msgspec.structs.replace(command, rest_ns=rest_ns) if rest_ns else command

    def _is_idle(self) -> bool:
        return not self._odometry.is_wanted and self._robots.is_idle()

    def _publish(self, state: DriveState) -> None:
        self._robots.publish()
        if self._odometry.is_wanted:
            publish = self._odometry.publish if state.is_awaited else self._odometry.begin
            publish(state, self._robots.list_odometry())

    def _revise(self) -> None:
        """Apply a command that came since the last state before the next state."""
        if not self._late_command_window.is_open(self._now_s):
            return
        if (command := self._robots.revise()) is not None:
            self._rest.wake()
            self._commands.send(encode(command, Format.MSGPACK))
            self._late_command_window.close()

    def _handle_lost(self, entities: tuple[str, ...], reason: str) -> None:
        if not entities:
            return
        self._claim_client.reclaim(entities)
        if self._objects is not None:
            left = len(self._claims) // CLAIM_BYTES
            self._objects.note_gone_robots(len(entities), left, self._now_s)
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
    status: ProgramStatus | None = None,
) -> None:
    """Claim and drive entities until `should_stop`, or until they cannot be claimed.

    What arrives ends a pause where the network signals it; else the agent polls.

    Raises:
        ServiceError: See `NamedClaimClient.poll`, as for the others.
        NoServer: See there.
        TimeoutError: See there.
        MalformedPayload: See there.
    """
    status = status or ProgramStatus()
    with closing(Agent(network, config)) as agent:
        status.sources.append(agent.list_metrics)
        while not should_stop():
            status.note_turn()
            agent.poll(clock())
            now_s = clock()
            if network.arrivals is None:
                sleep(agent.pause_s(now_s))
            else:
                network.arrivals.wait(agent.pause_s(now_s))
                if (rest_s := agent.minimum_pause_s(clock())) > 0.0:
                    sleep(rest_s)


def _make_poll_schedule(config: AgentConfig, *, is_woken: bool) -> PollSchedule:
    if is_woken:
        return PollSchedule(is_woken=True)
    return PollSchedule(MAX_COMMAND_PAUSE_S if config.pool_limit is None else MAX_PAUSE_S)


def _make_robot_set(
    network: AgentNetwork,
    config: AgentConfig,
    graph: RosGraph,
    rx_session: AgentNetwork,
    watches: SubscriberWatches,
) -> RobotSet:
    timeout_ns = round(config.cmd_vel_timeout_s * NANOSECONDS)
    if config.pool_limit is None:
        return IndividualRobots(network, timeout_ns, graph)
    # numpy and the pool take 0.3 s and 10 MB to load, which single agents save.
    from zensim.robot_agent.pool.pooled_robots import PooledRobots  # noqa: PLC0415

    return PooledRobots(network, timeout_ns, graph, rx_session, watches)


def _make_claim_client(
    network: AgentNetwork, config: AgentConfig
) -> NamedClaimClient | ShareClaimClient:
    if config.pool_limit is None:
        settings = ClaimSettings(
            world=config.world,
            agent=config.agent,
            entities=config.entities,
            on_release=config.on_release,
            wait_s=config.wait_s,
        )
        return NamedClaimClient(network, settings)
    share = ShareSettings(
        world=config.world,
        agent=config.agent,
        limit=config.pool_limit,
        on_release=config.on_release,
        wait_s=config.wait_s,
    )
    return ShareClaimClient(network, share)


def run_agent_process(start: AgentProcessConfig) -> None:
    """Run an agent until it is stopped; without a name it generates one.

    Raises:
        EndpointUnreachable: Nothing accepts connections at the endpoint.
        UnusableMetrics: Metrics cannot be served.
        ServiceError: See `run_agent`, as for the others.
    """
    configure_logging(logging.WARNING if start.is_quiet else logging.INFO)
    config = start.config
    # Opening does not return to Python; until a token exists, a signal just ends the process.
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    status = make_program_status(config.world, CLIENT_TURN_S)
    CONTEXT.world = config.world
    receive_in_one_thread()
    deadline_s = time.monotonic() + config.wait_s
    with (
        served_status(start.metrics, status),
        open_bus_with_retry(BusConfig(connect=(start.endpoint,)), config.wait_s) as bus,
    ):
        status.sources.append(bus.traffic.list_metrics)
        left_s = max(0.0, deadline_s - time.monotonic())
        # On a secured server an agent can only be the user of its token.
        name = bus.user or config.agent or _make_agent_name(config)
        # An interrupt in a callback of Python is lost: the flag is read, too.
        with suppress(KeyboardInterrupt):
            stop = StopFlag(is_armed=False, on_stop=status.drain)
            config = msgspec.structs.replace(config, agent=name, wait_s=left_s)
            if config.pool_limit is None:
                # A pool gets many messages between two states, and takes them with the next one.
                bus.watch_arrivals()
            run_agent(bus, config, stop, status=status)


def _make_agent_name(config: AgentConfig) -> str:
    entity = config.entities[0] if config.entities else "pool"
    return f"agent_{entity[:MAX_ENTITY_CHARACTERS]}_{uuid.uuid4().hex[:4]}"
