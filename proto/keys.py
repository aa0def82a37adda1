"""Every Zenoh key expression, built and parsed; names are validated by the names module first."""


def service(world: str, name: str) -> str:
    """A service's queryable."""
    return f"sim/{world}/{name}"


def services(world: str) -> str:
    """All services of one world."""
    return f"sim/{world}/*"


def drive_commands(world: str) -> str:
    """All agents to the server."""
    return f"sim/{world}/drive/*/command"


def alive_server(world: str) -> str:
    """Liveliness token of the server."""
    return f"sim/{world}/alive/server"


def alive_agent(world: str, agent: str) -> str:
    """Liveliness token of one agent."""
    return f"sim/{world}/alive/agent/{agent}"


def alive_agents(world: str) -> str:
    """Liveliness tokens of all agents."""
    return f"sim/{world}/alive/agent/*"


def bond(world: str, name: str) -> str:
    """Liveliness token that keeps entities alive."""
    return f"sim/{world}/bond/{name}"


def bonds(world: str) -> str:
    """All bonds."""
    return f"sim/{world}/bond/*"


def robot(namespace: str, topic: str) -> str:
    """A robot's topic."""
    return f"{namespace}/{topic}"


def robot_topics(namespace: str) -> str:
    """All topics of one robot."""
    return f"{namespace}/*"


def make_pattern(key: str) -> str:
    """The pattern of all keys that are as long as a key and end as it does: `*/odom`."""
    *before, last = key.split("/")
    return "/".join([*("*" for _ in before), last])


def parse_agent(key: str) -> str:
    """The agent that a drive or alive key belongs to; empty when it is neither."""
    match key.split("/"):
        case ["sim", _, "drive", agent, _] | ["sim", _, "alive", "agent", agent]:
            return agent
    return ""


def last_chunk(key: str) -> str:
    """The service or topic that a key ends with."""
    return key.rsplit("/", 1)[-1]
