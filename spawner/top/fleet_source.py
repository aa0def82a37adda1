"""Reads what the programs of a world report, once a second, from as few topics as possible.

The statistics are one message a second of each process, poses of all robots are one query of the
snapshot, and rates of odometry are measured for the robots that are shown only: an agent publishes
odometry for subscribers only, and that of a fleet would be 50 messages a second of each robot.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Final, Generic, TypeVar

import msgspec

from zensim.proto.bus.bus_session import Bus, BusSubscription
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.process_messages import AgentStats, ProcessUsage
from zensim.proto.messages.sensing_messages import SensorStats
from zensim.proto.messages.telemetry_messages import Snapshot, Stats
from zensim.proto.messages.vehicle_messages import FleetStatus
from zensim.proto.stats_publisher import read_host_name
from zensim.proto.topic_catalog import (
    AGENT_STATS,
    ODOM,
    SENSOR_STATS,
    SNAPSHOT,
    STATS,
    VEHICLES,
    TopicSpec,
)
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.client.topic_reader import TopicReader, WantedTopics, read_topic
from zensim.spawner.client.vehicle_statuses import VehicleStatuses
from zensim.spawner.client.world_follower import WorldFollower
from zensim.spawner.top.fleet_figures import NO_MODELS, FleetReading
from zensim.spawner.top.local_processes import list_descendants

Report = TypeVar("Report", bound=msgspec.Struct)

SILENT_S: Final = 3.5
"""A process that has not reported for so long is left out; a silent server is marked."""
REPORTS_DEPTH: Final = 4096
ODOM_DEPTH: Final = 4096
QUERY_TIMEOUT_S: Final = 0.5


class Reports(Generic[Report]):
    """The last report of each process, until it is silent."""

    def __init__(self, reader: TopicReader[Report], name: Callable[[Report], str]) -> None:
        self._reader, self._name = reader, name
        self._last: dict[str, tuple[float, Report]] = {}

    def read(self, now_s: float) -> Mapping[str, Report]:
        """Read the reports by name."""
        for report in self._reader.take():
            self._last[self._name(report)] = (now_s, report)
        fresh = {name: at for name, at in self._last.items() if now_s - at[0] <= SILENT_S}
        return {name: fresh[name][1] for name in sorted(fresh)}

    @property
    def last(self) -> Report | None:
        """The last report, however old it is."""
        return self._reader.last

    def close(self) -> None:
        """Undeclare the subscription."""
        self._reader.close()


class OdometryRates:
    """Measures the rates of odometry of some robots."""

    def __init__(self, bus: Bus) -> None:
        # They wait for a second: each would keep the buffer that it was received in.
        self._topics: WantedTopics[str, BusSubscription] = WantedTopics(
            lambda key: bus.subscribe_copying(key, ODOM_DEPTH)
        )
        self._since_s: dict[str, float] = {}

    def watch(self, namespaces: Iterable[str], now_s: float) -> None:
        """Subscribe to these robots only."""
        wanted = {one: ODOM.key(one) for one in sorted(set(namespaces))}
        self._topics.follow(wanted)
        self._since_s = {one: self._since_s.get(one, now_s) for one in wanted}

    def read(self, now_s: float) -> dict[str, float]:
        """Count the messages since the reading before [Hz]."""
        found = {}
        for namespace, subscription in self._topics:
            elapsed_s = now_s - self._since_s[namespace]
            count = len(subscription.take())
            if elapsed_s > 0.0:
                found[namespace] = count / elapsed_s
                self._since_s[namespace] = now_s
        return found

    def close(self) -> None:
        """Undeclare all subscriptions."""
        self.watch((), 0.0)


class FleetSource:
    """Subscriptions and calls of `zensim top`."""

    def __init__(self, client: SimClient) -> None:
        """Subscribe.

        Args:
            client: Of the world.
        """
        bus, world = client.bus, client.world
        self._client = client
        self._follower = WorldFollower(bus, world)

        def read(kind: type[Report], topic: TopicSpec, *owner: str) -> TopicReader[Report]:
            return read_topic(bus, topic.key(world, *owner), kind, REPORTS_DEPTH)

        self._stats = Reports(read(Stats, STATS), lambda one: one.world)
        self._agents = Reports(read(AgentStats, AGENT_STATS, "*"), lambda one: one.agent)
        self._sensors = Reports(read(SensorStats, SENSOR_STATS, "*"), lambda one: one.process)
        self._rates = OdometryRates(bus)
        self._fleets = read(FleetStatus, VEHICLES)
        self._vehicles = VehicleStatuses()

    def watch(self, namespaces: Iterable[str]) -> None:
        """Measure the rates of odometry of these robots, and of no others."""
        self._rates.watch(namespaces, time.monotonic())

    def read(self) -> FleetReading:
        """Read what was reported; calls the server, whose models only if it has replied before."""
        snapshot = self._fetch_snapshot()
        now_s = time.monotonic()
        stats, agents = self._stats.read(now_s), self._agents.read(now_s)
        sensors = self._sensors.read(now_s)
        for fleet in self._fleets.take():
            self._vehicles.receive(fleet)
        self._follower.take()
        if snapshot is not None:  # else a call would only wait, and the silence be shown late
            self._follower.note_roster(snapshot.roster)
            self._follower.poll()
        reports: list[Stats | AgentStats | SensorStats] = [
            *stats.values(),
            *agents.values(),
            *sensors.values(),
        ]
        return FleetReading(
            stats=self._stats.last,
            agents=agents,
            sensors=sensors,
            children=tuple(list_descendants(list_local_ids(one.usage for one in reports))),
            read_s=time.monotonic(),
            snapshot=snapshot,
            models=self._follower.models or NO_MODELS,
            odom_hz=self._rates.read(time.monotonic()),
            vehicles=self._vehicles.read(),
            is_stale=not stats,
        )

    def close(self) -> None:
        """Undeclare all subscriptions."""
        reports = (self._stats, self._agents, self._sensors, self._rates, self._fleets)
        for one in (self._follower, *reports):
            one.close()

    def _fetch_snapshot(self) -> Snapshot | None:
        bus = self._client.bus
        try:
            found = bus.get(SNAPSHOT.key(self._client.world), QUERY_TIMEOUT_S)
            return decode(Snapshot, found[0].payload, found[0].encoding) if found else None
        except MalformedPayload:
            return None


def list_local_ids(usages: Iterable[ProcessUsage]) -> list[int]:
    """List the ids of the processes that run on this host."""
    return [one.process_id for one in usages if one.host == read_host_name() and one.process_id]
