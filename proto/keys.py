"""Every Zenoh key expression, built and parsed; names are validated by the names module first."""

CMD_VEL = "cmd_vel"
ODOM = "odom"
TF = "tf"
TF_STATIC = "tf_static"
JOINT_STATES = "joint_states"
ROBOT_DESCRIPTION = "robot_description"


def service(world: str, name: str) -> str:
    """A service's queryable."""
    return f"sim/{world}/{name}"


def services(world: str) -> str:
    """All services of one world."""
    return f"sim/{world}/*"


def clock(world: str) -> str:
    """Simulation time."""
    return f"sim/{world}/clock"


def stats(world: str) -> str:
    """How the loop is doing, once a second."""
    return f"sim/{world}/stats"


def snapshot(world: str) -> str:
    """Every entity's pose and twist."""
    return f"sim/{world}/snapshot"


def events(world: str) -> str:
    """What happened."""
    return f"sim/{world}/events"


def steps_progress(world: str) -> str:
    """How far goals of steps are."""
    return f"sim/{world}/simulate_steps_feedback"


def model_states(world: str) -> str:
    """Every entity's pose and twist, as Gazebo tells them."""
    return f"sim/{world}/model_states"


def link_states(world: str) -> str:
    """Every link's pose and twist, as Gazebo tells them."""
    return f"sim/{world}/link_states"


def drive_state(world: str, agent: str) -> str:
    """Server to one agent."""
    return f"sim/{world}/drive/{agent}/state"


def drive_command(world: str, agent: str) -> str:
    """One agent to the server."""
    return f"sim/{world}/drive/{agent}/command"


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
