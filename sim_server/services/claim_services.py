"""Services that claim robots for agents: by name, or as a pool's share of all robots."""

from collections.abc import Mapping, Sequence

from zensim.proto.messages import agent_messages
from zensim.proto.messages.result_messages import ClaimCode, Result
from zensim.proto.names import InvalidName, check_name
from zensim.sim_server.errors import IncorrectState, RequestRefused
from zensim.sim_server.service_parts import Agents
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.simulated_world import World


def split_evenly(total: int, limits: Sequence[int]) -> tuple[int, ...]:
    """Share out `total` as evenly as limits allow; earlier ones get what does not divide.

    Args:
        total: How many there are.
        limits: Most that each may get.
    """
    given = [0] * len(limits)
    # Who has the lowest limit goes first: what it cannot take is left to the others.
    order = sorted(range(len(limits)), key=lambda place: (limits[place], -place))
    for done, place in enumerate(order):
        given[place] = min(limits[place], total // (len(order) - done))
        total -= given[place]
    return tuple(given)


def find_robots_to_move(
    asker: str, limits: Mapping[str, int], held: Mapping[str, Sequence[str]], free: Sequence[str]
) -> tuple[str, ...]:
    """Name the robots that a pool gets: of those that are free first, then of other pools' surplus.

    Args:
        asker: The pool; one of `limits`.
        limits: Most robots of each pool, in the order of joining.
        held: What pools have, in the order of claiming; a pool without any may be missing.
        free: Robots that nobody has.
    """
    total = len(free) + sum(len(held.get(pool, ())) for pool in limits)
    quotas = dict(zip(limits, split_evenly(total, tuple(limits.values())), strict=True))
    missing = max(0, quotas[asker] - len(held.get(asker, ())))
    moved = list(free[:missing])
    for pool, quota in quotas.items():
        mine = held.get(pool, ())
        # The newest go: the oldest have been driven by this pool for longest.
        spare = max(0, min(len(mine) - quota, missing - len(moved)))
        moved += mine[len(mine) - spare :]
    return tuple(moved)


UNLIMITED = 1 << 32
MAX_SHARE_TEXT = 2 << 20
"""Characters of descriptions, each counted once, after which a share is cut: a message has a
largest size, and robots that were spawned one by one have a text each."""


def claim_entity(
    world: World, agents: Agents, request: agent_messages.ClaimEntityRequest
) -> agent_messages.ClaimEntityResponse:
    """Make an agent the driver of entities."""
    agent = _check_agent(agents, request.agent)
    if not request.entities:
        raise RequestRefused(ClaimCode.NOT_DRIVABLE, "no entity was named; name at least one")
    granted = world.claim(agent, request.entities, request.on_release)
    return agent_messages.ClaimEntityResponse(
        Result(),
        *agent_messages.make_grants(granted),
        world.clock.step_ns,
        world.control_steps,
    )


def claim_share(
    world: World, agents: Agents, request: agent_messages.ClaimShareRequest
) -> agent_messages.ClaimShareResponse:
    """Make a pool the driver of its share of the robots that nobody drives by name."""
    agent = _check_agent(agents, request.agent)
    agents.pool_limits[agent] = request.limit or UNLIMITED
    moved = _find_share(world, agents.pool_limits, agent)
    names = _fit_in_reply(moved)
    for entity in names:
        # No wheel is stopped: the pool that gets it answers the very next state.
        world.claims.drop(entity)
    granted = world.claim(agent, names, request.on_release)
    return agent_messages.ClaimShareResponse(
        Result(),
        *agent_messages.make_grants(granted),
        world.clock.step_ns,
        world.control_steps,
        len(names) < len(moved),
    )


def _check_agent(agents: Agents, name: str) -> str:
    try:
        agent = check_name(name, "agent")
    except InvalidName as error:
        raise RequestRefused(ClaimCode.AGENT_INVALID, str(error)) from error
    if agent not in agents.alive:
        raise IncorrectState(f"agent '{agent}' has no liveliness token; declare it before claiming")
    return agent


def _find_share(world: World, limits: Mapping[str, int], agent: str) -> tuple[Entity, ...]:
    robots = {
        entity.name: entity
        for entity in world.entities
        if entity.model.drive is not None and not world.divergence_guard.is_frozen(entity.name)
    }
    held = {
        pool: [name for name, _ in world.claims.list_claims(pool) if name in robots]
        for pool in limits
    }
    free = [name for name in robots if not world.claims.agent_of(name)]
    return tuple(robots[name] for name in find_robots_to_move(agent, limits, held, free))


def _fit_in_reply(moved: tuple[Entity, ...]) -> tuple[str, ...]:
    """Name those whose texts fit in one reply; always one."""
    texts: set[str] = set()
    room = MAX_SHARE_TEXT
    for count, entity in enumerate(moved):
        if entity.description not in texts:
            texts.add(entity.description)
            room -= len(entity.description)
        if room < 0 and count:
            return tuple(one.name for one in moved[:count])
    return tuple(entity.name for entity in moved)
