"""Groups of sensors with equal settings, which are measured and published together."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.sensor_messages import Noise
from zensim.proto.se3 import FloatArray
from zensim.proto.sensor_noise import SensorNoise, make_noise_key
from zensim.proto.topic_catalog import TOPICS
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.fleet_casting import make_scan_caster
from zensim.sim_server.scene.scan_casting import ScanCaster
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.sensors.scene_roster import SceneRoster, SceneSensor, SensorPlaces
from zensim.sim_server.sensors.sensor_publishers import SensorAddress, SensorTopics, is_subscribed


@dataclass(frozen=True, eq=False)
class SceneMoment:
    """Poses of all entities at one step.

    Attributes:
        step: Since the epoch began.
        time_ns: Simulation time of the step.
        base: (n, 7) of the root links in the world.
        joint_positions: Of all entities.
    """

    step: int
    time_ns: int
    base: FloatArray
    joint_positions: FloatArray


class SensedScene:
    """The shapes of all entities; poses are taken when the first sensor of a moment needs them.

    Attributes:
        layout: Entities and shapes.
    """

    def __init__(self, layout: SceneLayout) -> None:
        self.layout = layout
        self._caster = make_scan_caster(layout)
        self._moment: SceneMoment | None = None

    def find_caster(self, moment: SceneMoment) -> ScanCaster:
        """Find the caster of lidars, with the poses of a moment."""
        if self._moment is not moment:
            self._caster.place(moment.base, moment.joint_positions)
            self._moment = moment
        return self._caster


class GroupTopics:
    """The topics of a group; row i is that of sensor i."""

    def __init__(self, sensors: Sequence[SceneSensor], topics: SensorTopics) -> None:
        """Find the addresses of the topics that the sensors have in common."""
        self._topics = topics
        self._addresses = {
            name: [list_addresses(sensor)[number] for sensor in sensors]
            for number, name in enumerate(list_topic_names(sensors[0]))
        }
        self._triggers = [
            address for sensor in sensors for address in list_subscriptions(sensor)[:1]
        ]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the topics in the catalog."""
        return tuple(self._addresses)

    def find_wanted(self, name: str) -> IntArray:
        """Find the rows (m,) of the sensors whose topic has subscribers."""
        has_subscribers = self._topics.has_subscribers
        addresses = self._addresses[name]
        return np.flatnonzero([has_subscribers(address) for address in addresses])

    def find_triggered(self) -> IntArray:
        """Find the rows (m,) of the sensors that got a trigger since the last call.

        Triggers of a sensor that reach none of its subscribers are dropped.
        """
        counts = [self._topics.take_count(address) for address in self._triggers]
        return np.flatnonzero(counts)

    def find_all_wanted(self) -> tuple[IntArray, dict[str, IntArray]]:
        """Find the rows of the sensors that have subscribers on any topic, and those by topic."""
        wanted = {name: self.find_wanted(name) for name in self._addresses}
        return np.unique(np.concatenate([np.zeros(0, np.intp), *wanted.values()])), wanted

    def put(self, name: str, rows: IntArray, payloads: Sequence[bytes]) -> None:
        """Publish on one topic."""
        addresses = self._addresses[name]
        self._topics.put([addresses[row] for row in rows.tolist()], payloads)


class SensorGroup(ABC):
    """Sensors that are measured together; they have equal settings, rates and topics."""

    def __init__(
        self, sensors: Sequence[SceneSensor], roster: SceneRoster, topics: SensorTopics
    ) -> None:
        """Prepare what any of them needs.

        Args:
            sensors: With topics of the same names.
            roster: Of their entities.
            topics: Publishes.
        """
        self.sensors = sensors
        self._environment = roster.environment
        self._places = SensorPlaces(sensors, roster)
        self._topics = GroupTopics(sensors, topics)
        self._frames = [one.sensor.frame_id for one in sensors]
        self._compat = sensors[0].sensor.compat

    @abstractmethod
    def publish(self, moment: SceneMoment) -> IntArray:
        """Measure and publish the sensors with subscribers; return their indices (m,)."""

    def _make_noise(self, noise: Noise, rows: Iterable[int]) -> SensorNoise:
        chosen = [self.sensors[row] for row in rows]
        keys = [make_noise_key(self._environment.seed, one.entity, one.sensor) for one in chosen]
        return SensorNoise([noise], keys, self._environment, self._compat)


def list_topic_names(sensor: SceneSensor) -> tuple[str, ...]:
    """List the catalog names of the topics that a sensor publishes."""
    return tuple(address.topic.name for address in list_addresses(sensor))


def list_addresses(sensor: SceneSensor) -> list[SensorAddress]:
    """List the topics that a sensor publishes."""
    return [one for one in _list_all(sensor) if not is_subscribed(one)]


def list_subscriptions(sensor: SceneSensor) -> list[SensorAddress]:
    """List the topics that a sensor subscribes to."""
    return [one for one in _list_all(sensor) if is_subscribed(one)]


def _list_all(sensor: SceneSensor) -> list[SensorAddress]:
    return [
        SensorAddress(
            TOPICS[topic.topic], sensor.find_key(topic), sensor.namespace or sensor.entity
        )
        for topic in sensor.sensor.topics
        if topic.topic in TOPICS
    ]


def group_sensors(sensors: Iterable[SceneSensor]) -> list[list[SceneSensor]]:
    """Group sensors with equal settings, rates and topics, in the order of the first of each."""
    groups: dict[object, list[SceneSensor]] = {}
    keys_of: dict[int, object] = {}
    for one in sensors:
        # By identity first: hashing settings is slow, and robots of one model share them.
        key = keys_of.get(id(one.sensor))
        if key is None:
            sensor = one.sensor
            key = sensor.settings, sensor.update_rate_hz, sensor.compat, list_topic_names(one)
            keys_of[id(one.sensor)] = key
        groups.setdefault(key, []).append(one)
    return list(groups.values())
