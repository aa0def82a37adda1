"""Claims of agents: by name, and as a pool's share of all robots."""

from zensim.proto.messages import agent_messages
from zensim.proto.messages.result_messages import ClaimCode, Result
from zensim.proto.names import InvalidName, check_name
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import IncorrectState, Refused
from zensim.sim_server.handlers.shares import moves_to
from zensim.sim_server.world.entity import Entity

ANY_NUMBER = 1 << 32
SHARE_TEXT = 2 << 20
"""Characters of descriptions, each counted once, after which a share is cut: a message has a
largest size, and robots that were spawned one by one have a text each."""


def claim(
    desk: Desk, request: agent_messages.ClaimEntityRequest
) -> agent_messages.ClaimEntityResponse:
    """Make an agent the driver of entities."""
    agent = _checked_agent(desk, request.agent)
    if not request.entities:
        raise Refused(ClaimCode.NOT_DRIVABLE, "no entity was named; name at least one")
    granted = desk.world.claim(agent, request.entities, request.on_release)
    return agent_messages.ClaimEntityResponse(
        Result(), *agent_messages.make_grants(granted), desk.world.step_ns, desk.world.control_steps
    )


def claim_share(
    desk: Desk, request: agent_messages.ClaimShareRequest
) -> agent_messages.ClaimShareResponse:
    """Make a pool the driver of its share of the robots that nobody drives by name."""
    agent, world = _checked_agent(desk, request.agent), desk.world
    desk.pools[agent] = request.limit or ANY_NUMBER
    moved = _share(desk, agent)
    names = _first(moved)
    for entity in names:
        # No wheel is stopped: the pool that gets it answers the very next state.
        world.claims.drop(entity)
    granted = world.claim(agent, names, request.on_release)
    return agent_messages.ClaimShareResponse(
        Result(),
        *agent_messages.make_grants(granted),
        world.step_ns,
        world.control_steps,
        len(names) < len(moved),
    )


def _checked_agent(desk: Desk, name: str) -> str:
    try:
        agent = check_name(name, "agent")
    except InvalidName as error:
        raise Refused(ClaimCode.AGENT_INVALID, str(error)) from error
    if agent not in desk.alive_agents:
        raise IncorrectState(f"agent '{agent}' has no liveliness token; declare it before claiming")
    return agent


def _share(desk: Desk, agent: str) -> tuple[Entity, ...]:
    world = desk.world
    robots = {
        entity.name: entity
        for entity in world.entities
        if entity.model.drive is not None and not world.watch.is_frozen(entity.name)
    }
    held = {
        pool: [name for name, _ in world.claims.held_by(pool) if name in robots]
        for pool in desk.pools
    }
    free = [name for name in robots if not world.claims.agent_of(name)]
    return tuple(robots[name] for name in moves_to(agent, desk.pools, held, free))


def _first(moved: tuple[Entity, ...]) -> tuple[str, ...]:
    """Name those whose texts fit in one reply; always one."""
    texts: set[str] = set()
    room = SHARE_TEXT
    for count, entity in enumerate(moved):
        if entity.description not in texts:
            texts.add(entity.description)
            room -= len(entity.description)
        if room < 0 and count:
            return tuple(one.name for one in moved[:count])
    return tuple(entity.name for entity in moved)
