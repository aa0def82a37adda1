"""Zenoh key expressions of services, liveliness tokens and robots; for topics see `topic_catalog`.

Names are validated before: see `zensim.proto.names`.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Final

NO_NAMESPACE: Final = "zensim-no-robot"
"""Only key expressions with wildcards match keys of a namespace that no robot has."""


def service(world: str, name: str, user: str = "") -> str:
    """Key of a service; of a user on a secured server, which has the user as a chunk."""
    return f"sim/{world}/u/{user}/{name}" if user else f"sim/{world}/{name}"


def services(world: str) -> str:
    """All services of a world."""
    return f"sim/{world}/*"


def services_of_users(world: str) -> str:
    """All services of a world, called by any user of a secured server."""
    return f"sim/{world}/u/*/*"


def router_link(world: str, session: str, address: str) -> str:
    """Liveliness token of a session that is linked to the router of a secured server."""
    return f"sim/{world}/router/links/{session}/{address}"


def router_links(world: str) -> str:
    """Liveliness tokens of all sessions that are linked to the router of a secured server."""
    return f"sim/{world}/router/links/**"


def parse_router_link(key: str) -> tuple[str, str]:
    """Return session and address of a `router_link` key; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "router", "links", session, *address]:
            return session, "/".join(address)
    return "", ""


def router_refusals(world: str) -> str:
    """Topic on which the router of a secured server says which joins it refused."""
    return f"sim/{world}/router/refusals"


def user_session(world: str, user: str, session: str) -> str:
    """Liveliness token of a session of a user of a secured server."""
    return f"sim/{world}/u/{user}/session/{session}"


def user_sessions(world: str) -> str:
    """Liveliness tokens of the sessions of all users."""
    return f"sim/{world}/u/*/session/*"


def parse_user_session(key: str) -> tuple[str, str]:
    """Return user and session of a `user_session` key; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "u", user, "session", session]:
            return user, session
    return "", ""


def parse_user(key: str) -> str:
    """Return the user of a service key; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "u", user, _]:
            return user
    return ""


def alive_server(world: str) -> str:
    """Liveliness token of the server."""
    return f"sim/{world}/alive/server"


def list_served_worlds(tokens: Iterable[str]) -> list[str]:
    """List the worlds of `alive_server` tokens, sorted."""
    return sorted({token.split("/")[1] for token in tokens})


def alive_agent(world: str, agent: str) -> str:
    """Liveliness token of an agent."""
    return f"sim/{world}/alive/agent/{agent}"


def alive_agents(world: str) -> str:
    """Liveliness tokens of all agents of a world."""
    return f"sim/{world}/alive/agent/*"


def alive_replay(world: str) -> str:
    """Liveliness token of a replay that stands for a world."""
    return f"sim/{world}/alive/replay"


def alive_client(world: str, client: str) -> str:
    """Liveliness token of a client that steps or orders twists."""
    return f"sim/{world}/alive/clients/{client}"


def alive_clients(world: str) -> str:
    """Liveliness tokens of all such clients of a world."""
    return f"sim/{world}/alive/clients/*"


def requested_steps(world: str, client: str) -> str:
    """Topic on which a client requests steps, as `simulate_steps` does."""
    return f"sim/{world}/clients/{client}/steps"


def made_steps(world: str, client: str) -> str:
    """Topic of the responses to the steps that a client has requested on a topic."""
    return f"sim/{world}/clients/{client}/made"


def parse_stepping_client(key: str) -> str:
    """Return the client of a topic of requested steps; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "clients", client, "steps"]:
            return client
    return ""


def alive_sensors(world: str, process: str) -> str:
    """Liveliness token of a sensor process."""
    return f"sim/{world}/alive/sensors/{process}"


def active_sensors(world: str, process: str) -> str:
    """Liveliness token of a sensor process while it is subscribed to scene states."""
    return f"sim/{world}/sensors/{process}/active"


def sensor_libraries(world: str, process: str, missing: str) -> str:
    """Liveliness token of what the host of a sensor process lacks: names joined by `+`."""
    return f"sim/{world}/sensors/{process}/lacks/{missing}"


def bond(world: str, name: str) -> str:
    """Liveliness token to which the existence of entities is bound."""
    return f"sim/{world}/bond/{name}"


def bonds(world: str) -> str:
    """All bonds of a world."""
    return f"sim/{world}/bond/*"


def parse_sensor_process(key: str) -> str:
    """Return the sensor process of a token or topic of it; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "sensors", process, _] | ["sim", _, "alive", "sensors", process]:
            return process
    return ""


def parse_sensor_libraries(key: str) -> tuple[str, str]:
    """Return process and missing libraries of a `sensor_libraries` key; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "sensors", process, "lacks", missing]:
            return process, missing
    return "", ""


def robot(namespace: str, topic: str) -> str:
    """Topic of a robot."""
    return f"{namespace}/{topic}"


def make_pattern(key: str) -> str:
    """Replace all chunks but the last by `*`: `*/odom` for `r1/odom`."""
    *before, last = key.split("/")
    return "/".join([*("*" for _ in before), last])


def parse_agent(key: str) -> str:
    """Return the agent of a drive or alive key; empty for other keys."""
    match key.split("/"):
        case ["sim", _, "drive", agent, _] | ["sim", _, "alive", "agent", agent]:
            return agent
    return ""


def last_chunk(key: str) -> str:
    """Return the last chunk: the name of a service or topic."""
    return key.rsplit("/", 1)[-1]


def intersect(one: str, other: str) -> bool:
    """Whether some key fits both expressions.

    `*` is one chunk, `**` any number of them, `$*` any part of one; none of them fits a chunk that
    begins with `@`.
    """
    if "*" not in one and "*" not in other:
        return one == other
    return _sequences_intersect(one.split("/"), other.split("/"), "**", _chunk_intersects)


def _chunk_intersects(one: str, other: str) -> bool:
    if one == other or one.startswith("@") or other.startswith("@"):
        return one == other
    if "*" in {one, other}:
        return True
    if "*" not in one and "*" not in other:
        return False
    texts = one.replace("$*", "*"), other.replace("$*", "*")
    return _sequences_intersect(*texts, "*", str.__eq__)


def _sequences_intersect(
    one: Sequence[str], other: Sequence[str], wild: str, fits: Callable[[str, str], bool]
) -> bool:
    """Whether some sequence fits both, of which `wild` stands for any number of items.

    Without recursion: names of recordings may be long, and have many wildcards.
    """
    reached = _pass_wilds({0}, other, wild)
    for item in one:
        if item == wild:
            following = _pass_shown(reached, other, wild)
        else:
            following = {
                at + (other[at] != wild)
                for at in reached
                if at < len(other)
                and (_is_shown(item, wild) if other[at] == wild else fits(item, other[at]))
            }
        reached = _pass_wilds(following, other, wild)
    return len(other) in reached


def _pass_wilds(reached: set[int], items: Sequence[str], wild: str) -> set[int]:
    """Add the positions that follow wildcards, which may stand for nothing."""
    found = set(reached)
    for at in reached:
        end = at
        while end < len(items) and items[end] == wild:
            end += 1
            found.add(end)
    return found


def _pass_shown(reached: set[int], items: Sequence[str], wild: str) -> set[int]:
    """Add all positions that a wildcard reaches."""
    found: set[int] = set()
    for at in sorted(reached):
        end = at
        while end not in found:
            found.add(end)
            end += end < len(items) and _is_shown(items[end], wild)
    return found


def _is_shown(item: str, wild: str) -> bool:
    """Whether a wildcard may stand for an item: for chunks that do not begin with `@`."""
    return wild != "**" or not item.startswith("@")
