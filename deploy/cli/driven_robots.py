"""Robots that a command drives: found by name or pattern, and what keeps commands from them."""

import time
from collections.abc import Sequence
from fnmatch import fnmatchcase

from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import BusPublisher
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.near_names import name_choices
from zensim.proto.topic_catalog import CMD_VEL
from zensim.proto.topic_discovery import list_topics
from zensim.proto.verbosity import print_note
from zensim.spawner.client.sim_client import SimClient

POLL_S = 0.002
ASK_S = 0.05
"""Time between two questions to the server."""
SUBSCRIBER_TIMEOUT_S = 3.0
ABSENCE_TIMEOUT_S = 0.5
"""A robot that is not there may be spawned by the command before this one."""


class NoSubscriber(BusError):
    """No agent subscribes to a robot's cmd_vel."""


class NoSuchRobot(BusError):
    """No entity has this name or namespace."""

    code = ResultCode.NOT_FOUND


def wait_for_subscriber(publisher: BusPublisher) -> bool:
    """Wait until something subscribes; False if nothing does within `SUBSCRIBER_TIMEOUT_S`."""
    deadline = time.monotonic() + SUBSCRIBER_TIMEOUT_S
    while not publisher.is_matched:
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_S)
    return True


def select_robots(models: GetModelsResponse, patterns: Sequence[str]) -> list[EntityModel]:
    """Select the robots whose namespace or name fits a pattern with `*`, `?` or `[1-4]`, in order.

    Without patterns, the only robot.

    Raises:
        NoSuchRobot: A pattern fits none, or there is more than one to choose from.
    """
    robots = list_robots(models)
    if not patterns and len(robots) == 1:
        return robots
    if not patterns:
        raise NoSuchRobot(f"which robot? {name_robots(models)}")
    for pattern in patterns:
        if not any(_fits(one, pattern) for one in robots):
            raise find_problem(models, pattern, is_matched=False) or _make_absence(models, pattern)
    return [one for one in robots if any(_fits(one, pattern) for pattern in patterns)]


def _fits(robot: EntityModel, pattern: str) -> bool:
    return any(fnmatchcase(name, pattern) for name in (robot.namespace, robot.entity))


def list_robots(models: GetModelsResponse) -> list[EntityModel]:
    """List the entities that have a drive."""
    return [one for one in models.entities if models.models[one.model].drive is not None]


def await_driver(client: SimClient, publisher: BusPublisher, robot: str) -> None:
    """Wait until commands of a robot have an effect.

    A subscription with wildcards, as of a recorder or a pool, covers robots that nothing drives,
    so the server is asked, too. A robot that it does not know is driven, with a note, if a node
    announces to subscribe to its commands, or if the world has no robots.

    Raises:
        NoSubscriber: They have none within `SUBSCRIBER_TIMEOUT_S`.
        NoSuchRobot: There is none within `ABSENCE_TIMEOUT_S`.
    """
    began_s = time.monotonic()
    while (problem := _ask(client, robot, is_matched=publisher.is_matched)) is not None:
        is_absent = isinstance(problem, NoSuchRobot)
        if publisher.is_matched and is_absent and _is_elsewhere(client, robot):
            print_note("drive", str(problem))
            return
        if time.monotonic() - began_s > (ABSENCE_TIMEOUT_S if is_absent else SUBSCRIBER_TIMEOUT_S):
            raise problem
        time.sleep(ASK_S)


def _is_elsewhere(client: SimClient, robot: str) -> bool:
    """Whether a robot that the world lacks may be another program's."""
    key = CMD_VEL.key(robot)
    topics = list_topics(client.bus, client.world, None)
    is_announced = any(one.key == key and one.subscriptions for one in topics)
    return is_announced or not list_robots(client.models())


def _ask(client: SimClient, robot: str, *, is_matched: bool) -> BusError | None:
    """Ask the server why commands of a robot have no effect; None if they have."""
    try:
        models = client.models()
    except (BusError, ServiceError, TimeoutError):
        unexplained = NoSubscriber(
            f"nothing subscribes to {CMD_VEL.key(robot)}, and no server says why"
        )
        return None if is_matched else unexplained
    return find_problem(models, robot, is_matched=is_matched)


def find_problem(models: GetModelsResponse, robot: str, *, is_matched: bool) -> BusError | None:
    """Find out why commands of a robot have no effect; None if they have."""
    key = CMD_VEL.key(robot)
    names = {one.namespace: one for one in models.entities} | {
        one.entity: one for one in models.entities if one.namespace != robot
    }
    found = names.get(robot)
    if found is None:
        return _make_absence(models, robot)
    if models.models[found.model].drive is None:
        return NoSubscriber(f"'{robot}' is not a robot: it has no drive; {name_robots(models)}")
    if found.namespace != robot:
        return NoSubscriber(
            f"the topics of '{robot}' are at {found.namespace}/; use 'zensim drive "
            f"{found.namespace}'"
        )
    if not found.agent:
        return NoSubscriber(f"no agent drives '{robot}'; start one: 'zensim agent {found.entity}'")
    unsubscribed = NoSubscriber(
        f"agent {found.agent} drives '{robot}', but does not subscribe to {key}"
    )
    return None if is_matched else unsubscribed


def _make_absence(models: GetModelsResponse, robot: str) -> NoSuchRobot:
    return NoSuchRobot(f"there is no robot '{robot}'; {name_robots(models, like=robot)}")


def name_robots(models: GetModelsResponse, *, like: str = "") -> str:
    """Name the robots that there are, those with a name like the given one first."""
    shown = name_choices(like, (one.namespace or one.entity for one in list_robots(models)))
    return f"the robots are {shown}" if shown else "spawn one: 'zensim spawn box_bot'"
