"""Robots of large fleets, whose odometry comes in the messages of their agents."""

from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from typing import Final, NamedTuple, Protocol

import msgspec

from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.drive_topic_keys import resolve_odom_key, resolve_topic_key
from zensim.proto.messages.drive_messages import DriveSettings
from zensim.proto.messages.model_messages import MOVABLE_KINDS, Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import EntityModel, Event, GetModelsResponse
from zensim.proto.network_protocols import CallingNetwork, Sample
from zensim.proto.tf_joints import list_hidden_joints
from zensim.proto.topic_catalog import ODOM, TF
from zensim.recording.recorded_topics import RecordedTopic
from zensim.spawner.client.service_client import ServiceClient

LEAST_ROBOTS: Final = 300
"""Robots from which on a world has a large fleet: pools publish all topics of fewer."""
SUFFIXES: Final = (ODOM.suffix, TF.suffix)
FAILURES: Final = (BusError, ServiceError, TimeoutError, MalformedPayload)


class FleetRobot(NamedTuple):
    """A robot of which odometry is expected."""

    entity: str
    model: Model
    has_agent: bool
    odometry_key: str
    """Empty if agents do not send its odometry."""
    tf_key: str
    """Empty without transforms."""
    single_keys: tuple[str, ...]
    """Keys of odometry that agents do not send."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of its topics that are made of the odometry of agents."""
        return tuple(filter(None, (self.odometry_key, self.tf_key)))


class FleetSelection(msgspec.Struct, frozen=True):
    """Which topics are taken from a fleet."""

    expressions: tuple[str, ...]
    """Key expressions with wildcards, of odometry or transforms."""
    find_topic: Callable[[Sample], RecordedTopic | None]
    """None if a topic is not recorded."""


class RobotMessageSource(Protocol):
    """Makes the messages of single robots from those of their agents."""

    def collect(self, epoch: int) -> None:
        """Take what has come, so that no queue fills.

        Args:
            epoch: Of the clock; messages of a later one wait.
        """

    def take(self) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        """Make the newest messages of the epoch since the last call: stamp [ns], topic, bytes."""

    def find_single_keys(self, now_ns: int) -> AbstractSet[str]:
        """Find the keys that are to be subscribed to, since agents do not send their messages.

        They are those of robots with an agent whose odometry has not come for a second, as of an
        agent of another program or with a fault, and transforms that odometry does not give.
        """

    def clear(self) -> None:
        """Find all robots again."""

    def note_event(self, event: Event) -> None:
        """Follow what becomes of robots."""

    def close(self) -> None:
        """End the subscription."""


def is_of_many(expression: str) -> bool:
    """Whether a key expression is of odometry or transforms of several robots."""
    return "*" in expression and expression.rsplit("/", 1)[-1] in SUFFIXES


def has_large_fleet(network: CallingNetwork, world: str) -> bool:
    """Whether a world has so many robots that their odometry is taken from agents."""
    with suppress(*FAILURES):
        found = ServiceClient(network, world).models()
        return sum(1 for _ in list_robots(found)) >= LEAST_ROBOTS
    return False


def list_robots(found: GetModelsResponse) -> Iterator[FleetRobot]:
    """List the entities that have a drive."""
    for one in found.entities:
        if one.model < len(found.models) and found.models[one.model].drive is not None:
            yield find_robot(one, found.models[one.model])


def find_robot(entity: EntityModel, model: Model) -> FleetRobot:
    """Find the topics of a robot."""
    namespace, drive = entity.namespace, model.drive or DriveSettings()
    truths = [resolve_topic_key(namespace, one.topic, one.ros) for one in model.ground_truths]
    odometry_key = resolve_odom_key(namespace, drive) if drive.publish_odom else ""
    # A topic with two publishers is not made of the messages of one.
    is_sent = odometry_key and odometry_key not in truths
    tf_key = resolve_topic_key(namespace, TF.suffix, drive.ros) if has_transforms(model) else ""
    robot = FleetRobot(entity.entity, model, bool(entity.agent), odometry_key, tf_key, (*truths,))
    return robot if is_sent else robot._replace(odometry_key="", single_keys=(*truths, *robot.keys))


def has_transforms(model: Model) -> bool:
    """Whether a robot has transforms, of its odometry or of joints."""
    hidden = list_hidden_joints(model)
    has_joints = any(one.kind in MOVABLE_KINDS and one.name not in hidden for one in model.joints)
    return has_joints or (model.drive is not None and model.drive.publish_odom_tf)
