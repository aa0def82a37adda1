"""The agent: holds entities of one world and drives them, for as long as it is left to."""

import logging
import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Protocol

from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import Claim, DriveCommand, DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.robot_agent.claimer import Claimer, Wish
from zensim.robot_agent.config import AgentConfig
from zensim.robot_agent.fleet import Fleet
from zensim.robot_agent.network import Network
from zensim.robot_agent.precedence import Precedence, be_nice
from zensim.robot_agent.rates import with_rates
from zensim.robot_agent.reading import Timeline
from zensim.robot_agent.revising import Revising
from zensim.robot_agent.rhythm import COMMANDS_S, LONGEST_S, Rhythm
from zensim.robot_agent.share_claimer import ShareClaimer, ShareWish
from zensim.robot_agent.upkeep import Kept, Upkeep

LOG = logging.getLogger("zensim.agent")
LOOK_S = 0.02
"""Pause between looks for anything else: none of it is urgent, and each look costs."""


LOGGED_CLAIMS = 20
"""Of more at once, only the number is told."""


class Claiming(Protocol):
    """Asks for entities; `Claimer` by name, `ShareClaimer` for a share."""

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Ask if it is time to."""

    def hurry(self) -> None:
        """Ask soon: something has changed."""

    def want(self, entities: tuple[str, ...]) -> None:
        """Learn that entities were lost."""


class Held(Kept, Protocol):
    """The robots that are held; `Fleet` has them one by one, `PoolFleet` in arrays."""

    newest_claim: int

    def take(self, claims: Sequence[Claim]) -> None:
        """Hold what was claimed."""

    def lose_all_but(self, claims: bytes) -> tuple[str, ...]:
        """Let go all others, and name them."""

    def holds(self, claims: bytes) -> bool:
        """Whether all these claims are held."""

    def reset(self) -> None:
        """Start all robots again."""

    def advance(self, state: DriveState) -> DriveCommand:
        """Drive by one control period."""

    def revise(self) -> DriveCommand | None:
        """Answer the last state anew if a command that came since changes the answer."""

    def tell(self) -> None:
        """Publish what the last state made due."""


class Agent:
    """One process's part in the world; it moves only when polled."""

    def __init__(self, network: Network, config: AgentConfig) -> None:
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
        self._ears = network if config.pool_limit is None else network.beside()
        self._states = self._ears.subscribe(keys.drive_state(world, agent))
        self._commands = network.advertise(
            keys.drive_command(world, agent), make_encoding(DriveCommand, Format.MSGPACK)
        )
        self._graph = RosGraph(network, config.ros)
        self._claimer = _claimer_of(network, config)
        self._fleet = _fleet_of(network, config, self._graph, self._ears)
        self._timeline = Timeline()
        self._upkeep = Upkeep(self._fleet)
        self._precedence = Precedence(be_nice)
        self._rhythm = Rhythm(COMMANDS_S if config.pool_limit is None else LONGEST_S)
        self._revising = Revising()
        self._look_s = self._now_s = -math.inf

    def close(self) -> None:
        """Withdraw what is not withdrawn with the session."""
        self._graph.close()
        if self._ears is not self._network:
            self._ears.close()

    def pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s] before the next poll."""
        return self._rhythm.pause_s(now_s)

    def poll(self, now_s: float) -> bool:
        """Do what there is to do; tell whether there was a drive state.

        Args:
            now_s: Wall time, from any beginning.

        Raises:
            ServiceError: See `Claimer.poll`, as for the others.
            NoServer: See there.
            TimeoutError: See there.
            MalformedPayload: See there.
        """
        self._now_s = now_s
        if now_s >= self._look_s:
            self._look_s = now_s + LOOK_S
            self._look_around(now_s)
        return self._drive()

    def _look_around(self, now_s: float) -> None:
        self._watch_server()
        claims = self._claimer.poll(now_s)
        if claims:
            self._take_over(claims)
        self._upkeep.poll(now_s)

    def _watch_server(self) -> None:
        for _, is_alive in self._servers.take():
            if is_alive:
                self._claimer.hurry()
                continue
            self._timeline.forget()
            self._lose(self._fleet.lose_all_but(b""), "the server is gone")

    def _take_over(self, claims: tuple[Claim, ...]) -> None:
        self._fleet.take(with_rates(claims, self._config.rates))
        if len(claims) > LOGGED_CLAIMS:
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
            self._rhythm.note_state(self._now_s, is_awaited=state.is_awaited)
            self._precedence.note_state(self._now_s, state)
            self._follow(state)
        except MalformedPayload as error:
            self.malformed += 1
            if self.malformed == 1:
                LOG.warning("drive_state agent=%s reason=%r", self._config.agent, str(error))
        return True

    def _follow(self, state: DriveState) -> None:
        # An older state does not speak of the newest claim.
        if state.newest_claim < self._fleet.newest_claim or not self._fleet.holds(state.claims):
            return
        order = self._timeline.place(state.epoch, state.step)
        if order == "stale":
            return
        if order == "reset":
            self._fleet.reset()
        self._lose(self._fleet.lose_all_but(state.claims), "the entity is gone")
        if not state.claims:
            return
        payload = encode(self._fleet.advance(state), Format.MSGPACK)
        self._revising.note_state(state, self._now_s)
        if state.is_awaited:
            # One link keeps the order: who sees the command has seen what the state made due.
            self._fleet.tell()
            self._commands.send(payload)
        else:
            self._commands.send(payload)
            self._fleet.tell()

    def _revise(self) -> None:
        """Let a command that has come since the last state take effect before the next one."""
        if not self._revising.is_open(self._now_s):
            return
        if (command := self._fleet.revise()) is not None:
            self._commands.send(encode(command, Format.MSGPACK))
            self._revising.close()

    def _lose(self, entities: tuple[str, ...], reason: str) -> None:
        if not entities:
            return
        self._claimer.want(entities)
        if len(entities) > LOGGED_CLAIMS:
            LOG.info(
                "lost agent=%s entities=%d reason=%r", self._config.agent, len(entities), reason
            )
            return
        for entity in entities:
            LOG.info("lost agent=%s entity=%s reason=%r", self._config.agent, entity, reason)


def run_agent(
    network: Network,
    config: AgentConfig,
    should_stop: Callable[[], bool],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Hold and drive entities until told to stop, or until they cannot be had.

    Raises:
        ServiceError: See `Claimer.poll`, as for the others.
        NoServer: See there.
        TimeoutError: See there.
        MalformedPayload: See there.
    """
    with closing(Agent(network, config)) as agent:
        while not should_stop():
            agent.poll(clock())
            sleep(agent.pause_s(clock()))


def _fleet_of(network: Network, config: AgentConfig, graph: RosGraph, ears: Network) -> Held:
    timeout_ns = round(config.cmd_vel_timeout_s * NANOSECONDS)
    if config.pool_limit is None:
        return Fleet(network, timeout_ns, graph)
    # Numpy and what is made of arrays are half of what an agent has to load, and 10 MB.
    from zensim.robot_agent.pool.fleet import PoolFleet  # noqa: PLC0415

    return PoolFleet(network, timeout_ns, graph, ears)


def _claimer_of(network: Network, config: AgentConfig) -> Claiming:
    if config.pool_limit is None:
        wish = Wish(
            world=config.world,
            agent=config.agent,
            entities=config.entities,
            on_release=config.on_release,
            wait_s=config.wait_s,
        )
        return Claimer(network, wish)
    share = ShareWish(
        world=config.world,
        agent=config.agent,
        limit=config.pool_limit,
        on_release=config.on_release,
        wait_s=config.wait_s,
    )
    return ShareClaimer(network, share)
