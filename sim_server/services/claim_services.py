"""Services that claim robots for agents: by name, or as a pool's share of all robots."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Final

from zensim.proto.codec.message_codec import Format
from zensim.proto.messages import agent_messages
from zensim.proto.messages.result_messages import ClaimCode, Result, ResultCode
from zensim.proto.messages.telemetry_messages import PROTOCOL
from zensim.proto.names import InvalidName, check_name
from zensim.sim_server.errors import IncorrectState, RequestRefused, SimError
from zensim.sim_server.service_parts import (
    Agents,
    CurrentWorld,
    Descriptions,
    Pacing,
    ShareGrace,
    make_environment,
)
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.simulated_world import SimulatedWorld


def split_evenly(total: int, limits: Sequence[int]) -> tuple[int, ...]:
    """Divide `total` as evenly as the limits allow; the first ones get the remainder.

    Args:
        total: Number to divide.
        limits: Upper limit of each part.
    """
    given = [0] * len(limits)
    # Lowest limit first: what it cannot take is divided among the others.
    order = sorted(range(len(limits)), key=lambda place: (limits[place], -place))
    for done, place in enumerate(order):
        given[place] = min(limits[place], total // (len(order) - done))
        total -= given[place]
    return tuple(given)


def find_robots_to_move(
    pool: str,
    limits: Mapping[str, int],
    claims_of: Mapping[str, Sequence[str]],
    free: Sequence[str],
) -> tuple[str, ...]:
    """Choose the robots that a pool gets: free ones first, then the surplus of other pools.

    Args:
        pool: One of `limits`.
        limits: Most robots of each pool, in the order of their first request.
        claims_of: Robots of each pool, oldest claims first; a pool without robots may be missing.
        free: Robots without a claim.
    """
    total = len(free) + sum(len(claims_of.get(one, ())) for one in limits)
    quotas = dict(zip(limits, split_evenly(total, tuple(limits.values())), strict=True))
    missing = max(0, quotas[pool] - len(claims_of.get(pool, ())))
    moved = list(free[:missing])
    for other, quota in quotas.items():
        claimed = claims_of.get(other, ())
        # The newest claims move: a robot stays with its pool for long.
        spare = max(0, min(len(claimed) - quota, missing - len(moved)))
        moved += claimed[len(claimed) - spare :]
    return tuple(moved)


UNLIMITED = 1 << 32
START_NS: Final = 30_000_000_000
"""Simulation and wall time in which a pool begins to drive new robots: thousands take seconds."""
MAX_SHARE_TEXT = 2 << 20
"""Most characters of distinct descriptions in one reply: the size of a message is limited."""


def claim_entity(
    world: SimulatedWorld,
    agents: Agents,
    current: CurrentWorld,
    descriptions: Descriptions,
    request: agent_messages.ClaimEntityRequest,
) -> agent_messages.ClaimEntityResponse:
    """Grant an agent the claim of entities, named by the agent; pools lose theirs to it."""
    _check_protocol(request.protocol)
    agent = _check_agent(agents, request.agent)
    if not request.entities:
        raise RequestRefused(ClaimCode.NOT_DRIVABLE, "no entity was named; name at least one")
    granted = world.claim(
        agent, request.entities, request.on_release, yielding=agents.pool_limits.keys()
    )
    agents.state_formats[agent] = Format[request.state_format.upper()]
    grants, models, texts = agent_messages.make_grants(descriptions.locate_files(granted))
    return agent_messages.ClaimEntityResponse(
        Result(),
        grants,
        models,
        texts,
        world.clock.step_ns,
        world.control_steps,
        make_environment(world, current),
        tuple(model.actuators for model in models),
    )


def claim_share(
    world: SimulatedWorld,
    agents: Agents,
    current: CurrentWorld,
    descriptions: Descriptions,
    pacing: Pacing,
    request: agent_messages.ClaimShareRequest,
) -> agent_messages.ClaimShareResponse:
    """Grant a pool the claims of its share of the robots."""
    _check_protocol(request.protocol)
    agent = _check_agent(agents, request.agent)
    agents.pool_limits[agent] = request.limit or UNLIMITED
    moved = _find_new_share(world, agents, pacing, agent)
    names = _fit_in_reply(moved)
    for entity in names:
        # The wheels keep turning: the new pool replies to the next state.
        world.claims.drop(entity)
    granted = world.claim(agent, names, request.on_release)
    if granted:
        agents.graces[agent] = ShareGrace(world.clock.time_ns, pacing.now_ns(), START_NS)
    return agent_messages.ClaimShareResponse(
        Result(),
        *agent_messages.make_grants(descriptions.locate_files(granted)),
        world.clock.step_ns,
        world.control_steps,
        make_environment(world, current),
        is_more=len(names) < len(moved),
    )


class WrongProtocol(SimError):
    """The agent has messages that this server does not know, or no longer."""

    code = ResultCode.FEATURE_UNSUPPORTED
    slug = "agent.protocol"

    def __init__(self, protocol: int) -> None:
        super().__init__(
            f"the agent has protocol {protocol}, and this server (zensim {version('zensim')}) "
            f"{PROTOCOL}; install the same zensim on both hosts"
        )


def _check_protocol(protocol: int) -> None:
    """Check the protocol of an agent: during an upgrade, agents of the one before go on."""
    if not PROTOCOL - 1 <= protocol <= PROTOCOL:
        raise WrongProtocol(protocol)


def _check_agent(agents: Agents, name: str) -> str:
    try:
        agent = check_name(name, "agent")
    except InvalidName as error:
        raise RequestRefused(ClaimCode.AGENT_INVALID, str(error)) from error
    if agent not in agents.alive:
        raise IncorrectState(f"agent '{agent}' has no liveliness token; declare it before claiming")
    return agent


def _find_new_share(
    world: SimulatedWorld, agents: Agents, pacing: Pacing, agent: str
) -> tuple[Entity, ...]:
    """Find what a pool gets; at once if nothing has changed since it got nothing.

    Pools call each second, and a search among 10,000 robots takes 30 ms of the loop.
    """
    abandoning = _find_abandoning(world, agents, pacing, agent)
    basis = (
        world.claims.changes,
        world.entities.roster_number,
        tuple(agents.pool_limits.items()),
        abandoning,
        world.divergence_guard.frozen,
    )
    if agents.settled_shares.get(agent) == basis:
        return ()
    moved = _find_share(world, agents.pool_limits, abandoning, agent)
    if moved:
        agents.settled_shares.pop(agent, None)
    else:
        agents.settled_shares[agent] = basis
    return moved


def _find_abandoning(
    world: SimulatedWorld, agents: Agents, pacing: Pacing, agent: str
) -> frozenset[str]:
    """Find the silent pools whose robots others get: not those that still have time."""
    now_ns = world.clock.time_ns, pacing.now_ns()
    return frozenset(
        pool
        for pool in world.claims.silent & agents.pool_limits.keys()
        if pool != agent
        and not ((grace := agents.graces.get(pool)) is not None and grace.lasts_at(*now_ns))
    )


def _find_share(
    world: SimulatedWorld, limits: Mapping[str, int], silent: frozenset[str], agent: str
) -> tuple[Entity, ...]:
    robots = {
        entity.name: entity
        for entity in world.entities
        if entity.model.needs_agent and not world.divergence_guard.is_frozen(entity.name)
    }
    running = {pool: limit for pool, limit in limits.items() if pool not in silent}
    claims_of = {
        pool: [name for name, _ in world.claims.list_claims(pool) if name in robots]
        for pool in running
    }
    free = [name for name in robots if world.claims.agent_of(name) in {"", *silent}]
    return tuple(robots[name] for name in find_robots_to_move(agent, running, claims_of, free))


def _fit_in_reply(moved: tuple[Entity, ...]) -> tuple[str, ...]:
    """List the entities whose descriptions fit in one reply, at least one."""
    texts: set[str] = set()
    room = MAX_SHARE_TEXT
    for count, entity in enumerate(moved):
        if entity.description not in texts:
            texts.add(entity.description)
            room -= len(entity.description)
        if room < 0 and count:
            return tuple(one.name for one in moved[:count])
    return tuple(entity.name for entity in moved)
