"""Robots of large fleets, whose odometry comes in the messages of their agents."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final, NamedTuple, Protocol

import msgspec

from zensim.proto.bus import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import (
    Event,
    GetModelsRequest,
    GetModelsResponse,
)
from zensim.proto.network_protocols import CallingNetwork, Sample
from zensim.proto.service_catalog import GET_MODELS
from zensim.proto.topic_catalog import ODOM, TF
from zensim.recording.recorded_topics import RecordedTopic

LEAST_ROBOTS: Final = 300
"""Robots from which on a world has a large fleet: pools publish all topics of fewer."""
SUFFIXES: Final = (ODOM.suffix, TF.suffix)
FAILURES: Final = (BusError, ServiceError, TimeoutError, MalformedPayload)


class FleetRobot(NamedTuple):
    """A robot of which odometry is expected."""

    entity: str
    namespace: str
    model: Model
    has_agent: bool


class FleetSelection(msgspec.Struct, frozen=True):
    """Which topics are taken from a fleet."""

    expressions: tuple[str, ...]
    """Key expressions with wildcards, of odometry or transforms."""
    find_topic: Callable[[Sample], RecordedTopic | None]
    """None if a topic is not recorded."""


class RobotMessageSource(Protocol):
    """Makes the messages of single robots from those of their agents."""

    def collect(self) -> None:
        """Take what has come, so that no queue fills."""

    def take(self, epoch: int) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        """Make the newest messages since the last call: stamp [ns], topic, bytes.

        Args:
            epoch: Of the clock; messages of a later one wait.
        """

    def take_single_keys(self, now_ns: int) -> list[str]:
        """Take the keys that are to be subscribed to, since agents do not send their messages."""

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
        found = network.call(GET_MODELS, GetModelsRequest(), world=world)
        return sum(1 for _ in list_robots(found)) >= LEAST_ROBOTS
    return False


def list_robots(found: GetModelsResponse) -> Iterator[FleetRobot]:
    """List the entities that have a drive."""
    for one in found.entities:
        if one.model < len(found.models) and found.models[one.model].drive is not None:
            yield FleetRobot(one.entity, one.namespace, found.models[one.model], bool(one.agent))
