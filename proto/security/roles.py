"""Roles: what the users of each may publish, subscribe, query and declare, and call.

The access rules of the router, the checks of the server, the table in docs/security.md and the
test of every cell derive from `ROLES`.
"""

from enum import Enum
from typing import Final

import msgspec

from zensim.proto import service_catalog as catalog
from zensim.proto.names import check_name, check_namespace
from zensim.proto.ros2.trajectory_messages import TRAJECTORY_ACTION
from zensim.proto.service_catalog import SERVICES
from zensim.proto.topic_catalog import (
    AGENT_STATS,
    CLOCK,
    CMD_VEL,
    CONTACTS,
    CONTROLLER_COMMANDS,
    DRIVE_COMMAND,
    EVENTS,
    FLEET_ODOMETRY,
    IMAGE_TRIGGER,
    JOINT_COMMANDS,
    ROBOT_TOPICS,
    SCENE_STATE,
    TWISTS,
    VEHICLES,
    WORLD_TOPICS,
    Participant,
    TopicSpec,
)


class Operation(Enum):
    """What a client does with a key; the value is its letter in tables."""

    PUBLISH = "P"
    SUBSCRIBE = "S"
    QUERY = "Q"
    REPLY = "A"
    DECLARE_TOKEN = "T"
    WATCH_TOKENS = "L"


class KeyGrant(msgspec.Struct, frozen=True):
    """Operations on key expressions.

    A key expression may contain `{world}`, `{user}`, `{robot}` (one key per robot of the user),
    `{mangled}` (that robot in tokens of ROS 2) and `{domain}` (of ROS 2, left out without one).
    """

    operations: str
    """Letters of `Operation`."""
    keys: tuple[str, ...]


class Role(msgspec.Struct, frozen=True):
    """What the users of a role may do."""

    summary: str
    grants: tuple[KeyGrant, ...]
    services: frozenset[str]
    has_robots: bool = False
    """Whether a user of this role has robots of its own, by name."""


class User(msgspec.Struct, frozen=True):
    """A user: one process or person with a password of its own."""

    name: str
    role: str
    robots: tuple[str, ...] = ()
    """Names of the robots, which are also their namespaces; only for roles with robots."""


class RefusedUser(ValueError):
    """A user that cannot exist: unknown role, invalid name, or robots that do not fit the role."""


SERVER_USER: Final = "server"
"""The server itself, which may do everything."""
ROS_USER: Final = "@ros"
"""Stands for the users of role `ros` in calls of ROS 2, whose keys have no user."""
STEPS_USER: Final = "@operator"
"""Stands for operators in requests of steps that are published: only they may publish there."""
ROLES_OF_CALLERS: Final = {ROS_USER: "ros", STEPS_USER: "operator"}
"""No user can have these names, so that no user gets a role by its name."""
RESERVED_USERS: Final = frozenset({SERVER_USER, "router"})

SPAWNING: Final = frozenset(
    one.name
    for one in (
        catalog.SPAWN_ENTITY,
        catalog.SPAWN_ENTITIES,
        catalog.DELETE_ENTITY,
        catalog.SET_ENTITY_INFO,
        catalog.PUT_ASSET,
    )
)
CLAIMING: Final = frozenset({catalog.CLAIM_ENTITY.name, catalog.CLAIM_SHARE.name})
READING: Final = (
    frozenset(name for name, service in SERVICES.items() if not service.is_mutating) - SPAWNING
)
CONTROLLING: Final = frozenset(SERVICES) - SPAWNING - CLAIMING - READING
"""Simulation time, worlds, states, forces and properties of entities; and the end of the server."""


def _suffixes(publisher: Participant) -> tuple[TopicSpec, ...]:
    return tuple(topic for topic in ROBOT_TOPICS.values() if topic.publisher is publisher)


def _of_any_robot(*topics: TopicSpec) -> tuple[str, ...]:
    """Keys of topics of any robot and of the root; then those of ROS 2, and of its caches."""
    suffixes = tuple(dict.fromkeys(topic.suffix for topic in topics))
    return (
        *(f"**/{suffix}" for suffix in suffixes),
        *(f"{{domain}}/**/{suffix}/*/*" for suffix in suffixes),
        *(f"{{domain}}/**/{suffix}/*/*/@adv/**" for suffix in suffixes),
    )


_ROSOUT: Final = (
    KeyGrant("P", ("rosout", "{domain}/rosout/*/*")),
    KeyGrant("AT", ("{domain}/rosout/*/*/@adv/**",)),
)
"""Warnings and errors of a program in ROS 2."""
GETTABLE: Final = tuple(topic.key("{world}") for topic in WORLD_TOPICS if topic.is_gettable)
_CALLS: Final = KeyGrant("Q", ("sim/{world}/info", "sim/{world}/u/{user}/*"))
_SESSIONS: Final = KeyGrant("T", ("sim/{world}/u/{user}/session/*",))
_SERVER_TOKEN: Final = KeyGrant("L", ("sim/{world}/alive/server", "sim/*/alive/server"))
_EVERY_TOPIC: Final = (
    KeyGrant("S", ("**", "{domain}/**/@adv/**")),
    KeyGrant(
        "Q", (*GETTABLE, *_of_any_robot(*ROBOT_TOPICS.values()), "{domain}/rosout/*/*/@adv/**")
    ),
    KeyGrant(
        "L",
        (
            "sim/{world}/alive/**",
            "sim/{world}/sensors/**",
            "@ros2_lv/{domain}/**",
            "{domain}/**/@adv/**",
        ),
    ),
)
_WATCHING: Final = (_CALLS, _SESSIONS, _SERVER_TOKEN, *_EVERY_TOPIC)
_AGENT: Final = (
    _CALLS,
    _SESSIONS,
    _SERVER_TOKEN,
    KeyGrant(
        "P",
        tuple(one.key("{world}", "{user}") for one in (DRIVE_COMMAND, AGENT_STATS, FLEET_ODOMETRY)),
    ),
    KeyGrant(
        "S", ("sim/{world}/drive/{user}/state", CLOCK.key("{world}"), CONTACTS.key("{world}"))
    ),
    KeyGrant("T", ("sim/{world}/alive/agent/{user}",)),
)
_ROS_TOKENS_OF_ROBOT: Final = (
    "@ros2_lv/{domain}/*/*/*/*/*/{mangled}/**",
    "@ros2_lv/{domain}/*/*/*/*/*/{mangled}%$*/**",
)
_LATCHED_OF_ANY_ROBOT: Final = tuple(
    f"{{domain}}/**/{topic.suffix}/*/*/@adv/**"
    for topic in _suffixes(Participant.AGENT)
    if topic.is_latched
)
_TRAJECTORY_ACTIONS: Final = (
    f"**/{TRAJECTORY_ACTION}/_action/*",
    f"{{domain}}/**/{TRAJECTORY_ACTION}/_action/*/*/*",
    f"{{domain}}/**/{TRAJECTORY_ACTION}/_action/*/*/*/@adv/**",
)

ROLES: Final[dict[str, Role]] = {
    "operator": Role(
        "everything but the work of agents and sensor processes",
        (
            *_WATCHING,
            KeyGrant(
                "P",
                (
                    *_of_any_robot(CMD_VEL, JOINT_COMMANDS, CONTROLLER_COMMANDS, IMAGE_TRIGGER),
                    TWISTS.key("{world}"),
                    VEHICLES.key("{world}"),
                    "sim/{world}/clients/*/steps",
                ),
            ),
            KeyGrant("T", ("sim/{world}/alive/clients/*", "sim/{world}/bond/*")),
        ),
        READING | SPAWNING | CONTROLLING,
    ),
    "observer": Role("subscribe to all topics, call services that read", _WATCHING, READING),
    "recorder": Role("the same as an observer, for programs that record", _WATCHING, READING),
    "page": Role("the same as an observer, for the web page", _WATCHING, READING),
    "spawner": Role(
        "spawn entities; change and delete those that it spawned",
        (
            _CALLS,
            _SESSIONS,
            _SERVER_TOKEN,
            KeyGrant("S", tuple(topic.key("{world}") for topic in WORLD_TOPICS)),
            KeyGrant("Q", GETTABLE),
            KeyGrant("T", ("sim/{world}/bond/*",)),
        ),
        READING | SPAWNING,
    ),
    "agent": Role(
        "claim and drive its own robots, publish their topics",
        (
            *_AGENT,
            *_ROSOUT,
            KeyGrant("PSA", ("{robot}/**", "{domain}/{robot}/**", "{domain}/{robot}/**/@adv/**")),
            KeyGrant("T", (*_ROS_TOKENS_OF_ROBOT, "{domain}/{robot}/**/@adv/**")),
            KeyGrant("L", ("@ros2_lv/{domain}/**",)),
        ),
        READING | CLAIMING,
        has_robots=True,
    ),
    "pool": Role(
        "claim and drive any robots, publish their topics and the shared `tf`",
        (
            *_AGENT,
            *_ROSOUT,
            KeyGrant("PA", _of_any_robot(*_suffixes(Participant.AGENT))),
            KeyGrant("T", _LATCHED_OF_ANY_ROBOT),
            KeyGrant("S", _of_any_robot(CMD_VEL, JOINT_COMMANDS, CONTROLLER_COMMANDS)),
            KeyGrant("PAT", _TRAJECTORY_ACTIONS),
            KeyGrant("A", ("{domain}/**/agent/*/*/*", "{domain}/zensim_pool_$*/*/*/*")),
            KeyGrant("TL", ("@ros2_lv/{domain}/**",)),
        ),
        READING | CLAIMING,
    ),
    "sensors": Role(
        "measure and publish lidars and cameras of all robots",
        (
            _CALLS,
            _SESSIONS,
            _SERVER_TOKEN,
            *_ROSOUT,
            KeyGrant("PA", _of_any_robot(*_suffixes(Participant.SENSORS))),
            KeyGrant("A", ("{domain}/**/sensors/*/*/*",)),
            KeyGrant(
                "P", ("sim/{world}/sensors/{user}/reply", "sim/{world}/sensors/{user}/figures")
            ),
            KeyGrant(
                "S",
                (
                    SCENE_STATE.key("{world}"),
                    EVENTS.key("{world}"),
                    CLOCK.key("{world}"),
                    *_of_any_robot(IMAGE_TRIGGER),
                ),
            ),
            KeyGrant(
                "T",
                (
                    "sim/{world}/alive/sensors/{user}",
                    "sim/{world}/sensors/{user}/active",
                    "sim/{world}/sensors/{user}/lacks/*",
                    "@ros2_lv/{domain}/**",
                ),
            ),
            KeyGrant(
                "L",
                (
                    "sim/{world}/alive/sensors/*",
                    "sim/{world}/sensors/*/active",
                    "sim/{world}/sensors/*/lacks/*",
                    "@ros2_lv/{domain}/**",
                ),
            ),
        ),
        READING,
    ),
    "ros": Role(
        "a host of ROS 2 nodes with rmw_zenoh: every ROS 2 topic of the domain",
        (
            *_WATCHING,
            KeyGrant("PSQA", ("{domain}/**", "{domain}/**/@adv/**")),
            KeyGrant("TL", ("@ros2_lv/{domain}/**", "{domain}/**/@adv/**")),
        ),
        READING | SPAWNING,
    ),
}
"""Every role of a user, by name."""


def check_user(user: User) -> User:
    """Return the user if it can exist.

    Raises:
        RefusedUser: See there.
    """
    try:
        check_name(user.name, "user")
        for robot in user.robots:
            check_namespace(robot)
    except ValueError as error:
        raise RefusedUser(str(error)) from error
    if user.name in RESERVED_USERS:
        raise RefusedUser(f"user name '{user.name}' is reserved; choose another")
    if (role := ROLES.get(user.role)) is None:
        raise RefusedUser(f"role {user.role[:40]!r} is unknown; use one of {', '.join(ROLES)}")
    if role.has_robots != bool(user.robots):
        wanted = "name at least one --robot" if role.has_robots else "leave --robot out"
        raise RefusedUser(f"role '{user.role}' with robots {user.robots!r}; {wanted}")
    return user


def list_keys(user: User, operation: Operation, *, world: str, domain: int | None) -> list[str]:
    """List the key expressions on which a user may do an operation."""
    found: dict[str, None] = {}
    for grant in ROLES[user.role].grants:
        if operation.value in grant.operations:
            for key in grant.keys:
                found.update(dict.fromkeys(_expand(key, user, world, domain)))
    return list(found)


def _expand(key: str, user: User, world: str, domain: int | None) -> list[str]:
    if "{domain}" in key and domain is None:
        return []
    robots = user.robots if "{robot}" in key or "{mangled}" in key else ("",)
    return [
        key.replace("{world}", world)
        .replace("{user}", user.name)
        .replace("{domain}", str(domain))
        .replace("{robot}", robot)
        .replace("{mangled}", "%" + robot.replace("/", "%"))
        for robot in robots
    ]
