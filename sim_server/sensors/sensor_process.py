"""The sensor process: measures and publishes its share of the sensors of a world."""

import logging
import math
import signal
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus_with_retry
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.json_logs import CONTEXT
from zensim.proto.messages.sensing_messages import (
    SceneState,
    SensorFigures,
    SensorsReply,
    SensorStats,
)
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.metric_families import MetricFamily, make_counter, make_gauge
from zensim.proto.network_protocols import AgentNetwork, Sample
from zensim.proto.poll_schedule import PollSchedule
from zensim.proto.program_status import CLIENT_TURN_S, ProgramStatus, make_program_status
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.rosout import Rosout
from zensim.proto.security.role_checks import require_access
from zensim.proto.security.roles import Operation
from zensim.proto.sensor_libraries import (
    Library,
    find_missing_libraries,
    format_missing,
    parse_missing,
)
from zensim.proto.sensor_schedule import count_due, find_true_rate_hz, is_due
from zensim.proto.served_status import served_status
from zensim.proto.stats_publisher import StatsPublisher, read_process_usage
from zensim.proto.stop_signal import STOP_SIGNALS, StopFlag
from zensim.proto.subscriber_search import SubscriberWatches
from zensim.proto.topic_catalog import SCENE_STATE, SENSOR_STATS, SENSORS_REPLY
from zensim.proto.verbosity import configure_logging
from zensim.sim_server.scene.camera_selection import find_opengl_fault
from zensim.sim_server.scene.sensor_faults import SensorFault, find_sensor_fault, has_one_level_row
from zensim.sim_server.sensors.camera_sensors import CameraSensorGroup, ViewedScene
from zensim.sim_server.sensors.ray_sensors import RaySensorGroup
from zensim.sim_server.sensors.scene_roster import (
    POSE_COLUMNS,
    SceneMeshes,
    SceneRoster,
    SceneSensor,
)
from zensim.sim_server.sensors.sensor_config import SensorProcessConfig
from zensim.sim_server.sensors.sensor_groups import (
    SceneMoment,
    SensedScene,
    SensorGroup,
    group_sensors,
    list_addresses,
    list_subscriptions,
)
from zensim.sim_server.sensors.sensor_publishers import SensorAddress, SensorTopics
from zensim.spawner.client.world_follower import ENTITY_EVENTS, WorldFollower

LOG = logging.getLogger("zensim.sensors")
HOUSEKEEPING_PERIOD_S = 0.02
IDLE_POLL_S = 0.025
IDLE_AFTER_S = 2.0
"""Time without subscribers after which the subscription to scene states ends."""
MAX_WAITING_STATES = 8
"""Older scene states that have not been handled are left out."""


class SensorCounts:
    """What was published of each sensor, by `SceneSensor.name`."""

    def __init__(self) -> None:
        self.messages: Counter[tuple[str, str, str]] = Counter()
        self.late: Counter[tuple[str, str, str]] = Counter()
        self.cost_s: dict[tuple[str, str, str], float] = {}
        self.total = 0
        self.total_late = 0

    def add(self, sensors: Iterable[SceneSensor], cost_s: float, *, is_late: bool) -> None:
        """Count a measurement of some sensors, and what each cost [s]."""
        for sensor in sensors:
            self.messages[sensor.name] += 1
            self.cost_s[sensor.name] = cost_s
            self.total += 1
            if is_late:
                self.late[sensor.name] += 1
                self.total_late += 1

    def keep(self, sensors: Iterable[SceneSensor]) -> None:
        """Forget all other sensors; the totals stay."""
        names = {sensor.name for sensor in sensors}
        for counts in (self.messages, self.late, self.cost_s):
            for gone in counts.keys() - names:
                del counts[gone]

    def add_missing(self, sensors: Iterable[SceneSensor], count: int) -> None:
        """Count measurements that were not made."""
        for sensor in sensors:
            self.late[sensor.name] += count
            self.total_late += count


class HostLibraries:
    """What the hosts of all sensor processes lack, by their tokens.

    Attributes:
        missing: What this host lacks, and why.
    """

    def __init__(self, network: AgentNetwork, world: str, name: str) -> None:
        self._network, self._world, self._name = network, world, name
        self.missing = find_missing_libraries()
        self._others: dict[str, frozenset[Library]] = {}
        self._tokens = network.watch_tokens(keys.sensor_libraries(world, "*", "*"))
        self._has_tried_opengl = False
        self._declare()

    def try_opengl(self) -> None:
        """Find whether OpenGL really works, which takes a while, once."""
        if self._has_tried_opengl or "opengl" in self.missing:
            return
        self._has_tried_opengl = True
        if fault := find_opengl_fault():
            former = self._token
            self.missing["opengl"] = fault
            self._declare()
            former.close()

    def poll(self) -> bool:
        """Take changes of other processes; return whether there are any."""
        changes = self._tokens.take()
        for key, is_alive in changes:
            process, text = keys.parse_sensor_libraries(key)
            missing = parse_missing(text)
            if is_alive:
                self._others[process] = missing
            elif self._others.get(process) == missing:
                del self._others[process]
        return bool(changes)

    def find_missing(self, process: str) -> frozenset[Library]:
        """Find what the host of a process lacks; nothing if that is not known."""
        if process == self._name:
            return frozenset(self.missing)
        return self._others.get(process, frozenset())

    def close(self) -> None:
        """Undeclare the token."""
        self._token.close()

    def _declare(self) -> None:
        missing = format_missing(self.missing)
        key = keys.sensor_libraries(self._world, self._name, missing)
        self._token = self._network.token(key)


def share_sensors(
    sensors: Sequence[SceneSensor],
    processes: Sequence[str],
    find_fault: Callable[[SceneSensor, str], SensorFault | None],
) -> dict[str, list[SceneSensor]]:
    """Share sensors evenly: the k-th of n processes gets every n-th of those that it can measure.

    What no process can measure is in the share "".

    Args:
        sensors: Of the world.
        processes: Names, in order.
        find_fault: Finds what a sensor lacks on the host of a process.
    """
    shares: dict[str, list[SceneSensor]] = {process: [] for process in (*processes, "")}
    for number, sensor in enumerate(sensors):
        able = [one for one in processes if not is_refused(find_fault(sensor, one))]
        shares[able[number % len(able)] if able else ""].append(sensor)
    return shares


def is_refused(fault: SensorFault | None) -> bool:
    """Whether a sensor is not measured."""
    return fault is not None and fault.is_refused


class SensorShare:
    """The sensors that this process publishes, in groups of equal settings.

    Attributes:
        sensors: The sensors of the share.
        unmeasured: Those that no process can measure.
    """

    def __init__(
        self,
        network: AgentNetwork,
        config: SensorProcessConfig,
        graph: RosGraph,
        watches: SubscriberWatches | None = None,
    ) -> None:
        world, self._name = config.world, config.name
        self.libraries = HostLibraries(network, world, config.name)
        self.topics = SensorTopics(network, graph, watches)
        # A search finds a new subscriber later than `--always` allows.
        self._watches = None if config.is_always_on else watches
        self.roster: SceneRoster | None = None
        self.sensors: Sequence[SceneSensor] = ()
        self.unmeasured: Sequence[SceneSensor] = ()
        self._meshes = SceneMeshes(network, world)
        self._has_meshes = True
        self._processes: tuple[str, ...] = (config.name,)
        self._scene: SensedScene | None = None
        self._view: ViewedScene | None = None
        self._has_visual_meshes = True
        self._groups: tuple[SensorGroup, ...] | None = None

    def set_roster(self, roster: SceneRoster) -> None:
        """Set the entities of the world."""
        self.roster, self._scene, self._view = roster, None, None
        if self._watches is not None:
            self._watches.set_world_robots(len(roster.models))
        if any(isinstance(one.sensor.settings, CameraSensor) for one in roster.sensors):
            self.libraries.try_opengl()
        self._set_addresses()

    def set_processes(self, processes: tuple[str, ...]) -> None:
        """Set the names of the processes that share, in order; this one is among them."""
        if processes != self._processes:
            self._processes = processes
            self._set_addresses()

    def poll_libraries(self) -> None:
        """Share anew when another process has other libraries than was known."""
        if self.libraries.poll():
            self._set_addresses()

    def find_fault(self, sensor: SceneSensor, process: str) -> SensorFault | None:
        """Find what a sensor lacks on the host of a process."""
        settings, roster = sensor.sensor.settings, self.roster
        if roster is None:
            return None
        return find_sensor_fault(
            sensor.sensor,
            find_true_rate_hz(sensor.sensor.update_rate_hz, roster.environment),
            self.libraries.find_missing(process),
            is_level=isinstance(settings, RaySensor) and has_one_level_row(settings),
        )

    def find_groups(self) -> tuple[SensorGroup, ...]:
        """Find the groups, which takes a while after each change."""
        if self._groups is None or not (self._has_meshes and self._has_visual_meshes):
            self._groups = () if self.roster is None else tuple(self._make_groups(self.roster))
        return self._groups

    def _set_addresses(self) -> None:
        sensors = self.roster.sensors if self.roster is not None else ()
        shares = share_sensors(sensors, self._processes, self.find_fault)
        former, self.unmeasured = self.unmeasured, shares.pop("")
        self.sensors = shares[self._name]
        every = [sensor for share in shares.values() for sensor in share]
        if self.unmeasured and self.unmeasured != former:
            fault = self.find_fault(self.unmeasured[0], self._name)
            LOG.warning("unmeasured sensors=%d reason=%r", len(self.unmeasured), str(fault))
        self.topics.set_addresses(_list_all_addresses(every), _list_all_addresses(self.sensors))
        # Sensors with subscribers that are new here must not miss the next state.
        self.topics.poll()
        self._groups = None

    def _make_groups(self, roster: SceneRoster) -> Iterator[SensorGroup]:
        if not self.sensors:
            return
        if self._scene is None or not self._has_meshes:
            self._has_meshes = self._meshes.fetch(roster.meshes)
            self._scene = SensedScene(roster.make_layout(self._meshes))
        for sensors in group_sensors(self.sensors):
            settings = sensors[0].sensor.settings
            if isinstance(settings, RaySensor):
                yield RaySensorGroup(sensors, settings, roster, self.topics, self._scene)
            elif isinstance(settings, CameraSensor):
                view = self._find_view(roster)
                yield CameraSensorGroup(sensors, settings, roster, self.topics, view)

    def _find_view(self, roster: SceneRoster) -> ViewedScene:
        if self._view is None or not self._has_visual_meshes:
            has_meshes = self._meshes.fetch(roster.visual_meshes)
            self._has_visual_meshes = self._meshes.fetch_files(roster.texture_files) and has_meshes
            layout = roster.make_visual_layout(self._meshes)
            self._view = ViewedScene(layout, roster.scene, self._meshes)
        return self._view


class SceneStream:
    """The subscription to scene states, while it is active."""

    def __init__(self, network: AgentNetwork, world: str, name: str) -> None:
        """Subscribe; the token comes after that, since the server waits for who has it."""
        self._states = network.subscribe(SCENE_STATE.key(world), MAX_WAITING_STATES)
        self._token = network.token(keys.active_sensors(world, name))

    def take(self) -> list[Sample]:
        """Take all states received."""
        return self._states.take()

    def close(self) -> None:
        """Undeclare the token, then the subscription."""
        self._token.close()
        self._states.close()


class SensorProcess:
    """One sensor process; it acts only in `poll`."""

    def __init__(self, network: AgentNetwork, config: SensorProcessConfig) -> None:
        world, self.name = config.world, config.name
        self._now_s = -math.inf
        self.counts = SensorCounts()
        self._network = network
        self._config = config
        self._token = network.token(keys.alive_sensors(world, self.name))
        self._processes = network.watch_tokens(keys.alive_sensors(world, "*"))
        self._alive: set[str] = set()
        self._replies = network.advertise(
            SENSORS_REPLY.key(world, self.name), SENSORS_REPLY.encoding
        )
        self._graph = RosGraph(network, config.ros)
        self._rosout = Rosout(network, self._graph)
        self._watches = SubscriberWatches(network)
        self._share = SensorShare(network, config, self._graph, self._watches)
        self._follower = WorldFollower(
            network, world, kinds=ENTITY_EVENTS, period_s=0.0, clock=lambda: self._now_s
        )
        self._stats = StatsPublisher(
            network, SENSOR_STATS, SENSOR_STATS.key(world, self.name), self.make_stats
        )
        self._stream: SceneStream | None = None
        self._wanted_s = -math.inf
        self._last: tuple[int, int] | None = None
        """Epoch and step of the last scene state."""
        self._schedule = PollSchedule()
        self._housekeeping_s = -math.inf

    @property
    def is_active(self) -> bool:
        """Whether it is subscribed to scene states."""
        return self._stream is not None

    def pause_s(self, now_s: float) -> float:
        """Find how long to sleep [s] before the next poll."""
        return self._schedule.pause_s(now_s) if self.is_active else IDLE_POLL_S

    def poll(self, now_s: float) -> None:
        """Do what is due.

        Args:
            now_s: Wall time from any origin.
        """
        self._now_s = now_s
        if now_s >= self._housekeeping_s:
            self._housekeeping_s = now_s + HOUSEKEEPING_PERIOD_S
            self._do_housekeeping()
        if self._stream is not None:
            self._take_states(self._stream)

    def close(self) -> None:
        """Undeclare what is not part of the session."""
        self._set_active(is_active=False)
        self._rosout.close()
        self._follower.close()
        self._share.topics.close()
        self._share.libraries.close()
        self._graph.close()
        self._watches.close()
        self._token.close()

    def make_stats(self) -> SensorStats:
        """Make the statistics of this process."""
        counts, usage = self.counts, read_process_usage()
        return SensorStats(
            process=self.name,
            is_active=self.is_active,
            cpu_s=usage.cpu_s,
            messages=counts.total,
            late=counts.total_late,
            sensors=(
                *(self._make_figures(one, is_measured=True) for one in self._share.sensors),
                *(self._make_figures(one, is_measured=False) for one in self._share.unmeasured),
            ),
            missing={str(one): why for one, why in self._share.libraries.missing.items()},
            usage=usage,
        )

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List the metrics of this process; another thread calls it."""
        share = self._share
        yield make_gauge("zensim_sensors", "Sensors of this process.", len(share.sensors))
        yield make_gauge(
            "zensim_unmeasured_sensors", "Sensors of no process.", len(share.unmeasured)
        )
        yield make_counter(
            "zensim_sensor_messages_total", "Published measurements.", self.counts.total
        )
        yield make_counter(
            "zensim_sensor_late_messages_total",
            "Measurements that were late, or not made.",
            self.counts.total_late,
        )

    def _make_figures(self, sensor: SceneSensor, *, is_measured: bool) -> SensorFigures:
        counts, topics, addresses = self.counts, self._share.topics, list_addresses(sensor)
        fault = self._share.find_fault(sensor, self.name)
        return SensorFigures(
            entity=sensor.entity,
            sensor=sensor.sensor.name,
            topic=addresses[0].key if addresses else "",
            has_subscribers=any(map(topics.has_subscribers, addresses)),
            messages=counts.messages[sensor.name],
            late=counts.late[sensor.name],
            cost_s=counts.cost_s.get(sensor.name, 0.0),
            is_measured=is_measured,
            fault="" if fault is None else str(fault),
        )

    def _do_housekeeping(self) -> None:
        self._watch_tokens()
        self._poll_roster()
        self._share.topics.poll()
        self._rosout.poll()
        if self._config.is_always_on or self._share.topics.is_wanted:
            self._wanted_s = self._now_s
        self._set_active(is_active=self._now_s - self._wanted_s < IDLE_AFTER_S)
        self._stats.poll(self._now_s)

    def _poll_roster(self) -> None:
        """Fetch the entities if they are due."""
        if self._follower.poll() and self._follower.models is not None:
            roster = SceneRoster(self._follower.models, self._share.roster)
            self._share.set_roster(roster)
            self.counts.keep(roster.sensors)

    def _watch_tokens(self) -> None:
        if any(self._follower.take().servers):
            self._last = None
        for key, is_alive in self._processes.take():
            process = keys.parse_sensor_process(key)
            (self._alive.add if is_alive else self._alive.discard)(process)
        if not self.is_active:
            self._take_place(tuple(sorted(self._alive)))
        self._share.poll_libraries()

    def _take_place(self, processes: tuple[str, ...]) -> bool:
        """Take the share of this process; return whether it is one of them."""
        if self.name not in processes:
            return False
        self._share.set_processes(processes)
        return True

    def _set_active(self, *, is_active: bool) -> None:
        if is_active and self._stream is None:
            self._stream = SceneStream(self._network, self._config.world, self.name)
            LOG.info("active sensors=%s", self.name)
        elif not is_active and self._stream is not None:
            self._stream.close()
            self._stream, self._last = None, None
            LOG.info("inactive sensors=%s", self.name)

    def _take_states(self, stream: SceneStream) -> None:
        samples = stream.take()
        for number, sample in enumerate(samples):
            try:
                state = decode(SceneState, sample.payload, sample.encoding)
            except MalformedPayload as error:
                LOG.warning("scene_state reason=%r", str(error))
                continue
            self._schedule.note_state(self._now_s, is_awaited=state.is_awaited)
            if self._is_new(state):
                self._measure(state, is_late=number + 1 < len(samples))
            self._reply(state)

    def _is_new(self, state: SceneState) -> bool:
        """Whether a state has not been handled, and is not older than one that has."""
        return self._last is None or (state.epoch, state.step) > self._last

    def _reply(self, state: SceneState) -> None:
        counts = self.counts
        reply = SensorsReply(state.epoch, state.step, counts.total, counts.total_late)
        self._replies.send(encode(reply, Format.MSGPACK))

    def _measure(self, state: SceneState, *, is_late: bool) -> None:
        before, self._last = self._last, (state.epoch, state.step)
        if not self._take_place(state.processes) or (moment := self._find_moment(state)) is None:
            return
        roster = self._share.roster
        if roster is None:
            return
        self._share.topics.faults.update(state.topic_faults, state.time_ns)
        for group in self._share.find_groups():
            rate_hz = group.sensors[0].sensor.update_rate_hz
            if is_due(state.step, rate_hz, roster.environment):
                self._publish(group, moment, is_late=is_late)
            if before is not None and before[0] == state.epoch:
                self._count_missing(group, roster, before[1], state.step)

    def _publish(self, group: SensorGroup, moment: SceneMoment, *, is_late: bool) -> None:
        began_s = time.thread_time()
        rows = group.publish(moment)
        if len(rows):
            cost_s = (time.thread_time() - began_s) / len(rows)
            sensors = [group.sensors[row] for row in rows.tolist()]
            self.counts.add(sensors, cost_s, is_late=is_late)

    def _count_missing(
        self, group: SensorGroup, roster: SceneRoster, before: int, step: int
    ) -> None:
        """Count what was due at states between two that came."""
        rate_hz = group.sensors[0].sensor.update_rate_hz
        last = step - roster.environment.control_steps
        missing = count_due(before, last, rate_hz, roster.environment)
        if missing > 0:
            topics = self._share.topics
            received = [
                one
                for one in group.sensors
                if any(map(topics.has_subscribers, list_addresses(one)))
            ]
            self.counts.add_missing(received, missing)

    def _find_moment(self, state: SceneState) -> SceneMoment | None:
        """Find the poses of all entities; None if they are not of a known roster."""
        try:
            base = np.frombuffer(state.poses, dtype="<f8").reshape(-1, POSE_COLUMNS)
            joints = np.frombuffer(state.joint_positions, dtype="<f8")
        except ValueError as error:
            LOG.warning("scene_state reason=%r", str(error))
            return None
        self._follower.note_roster(state.roster)
        self._poll_roster()
        roster = self._share.roster
        if roster is None or not roster.fits(base, joints):
            return None
        return SceneMoment(state.step, state.time_ns, base, joints)


def run_sensor_process(
    network: AgentNetwork,
    config: SensorProcessConfig,
    should_stop: Callable[[], bool],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
    status: ProgramStatus | None = None,
) -> None:
    """Publish sensors until `should_stop`."""
    status = status or ProgramStatus()
    with closing(SensorProcess(network, config)) as process:
        status.sources.append(process.list_metrics)
        while not should_stop():
            status.note_turn()
            process.poll(clock())
            sleep(process.pause_s(clock()))


def start_sensor_process(config: SensorProcessConfig) -> None:
    """Run a sensor process until it is stopped; without a name it generates one.

    Raises:
        EndpointUnreachable: Nothing accepts connections at the endpoint.
        UnusableMetrics: Metrics cannot be served.
    """
    configure_logging(logging.WARNING if config.is_quiet else logging.INFO)
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    status = make_program_status(config.world, CLIENT_TURN_S)
    CONTEXT.world = config.world
    with (
        served_status(config.metrics, status),
        open_bus_with_retry(BusConfig(connect=(config.endpoint,)), config.wait_s) as bus,
    ):
        status.sources.append(bus.traffic.list_metrics)
        name = bus.user or config.name or f"sensors_{uuid.uuid4().hex[:8]}"
        token = keys.alive_sensors(config.world, name)
        require_access(bus, config.world, Operation.DECLARE_TOKEN, token)
        # An interrupt in a callback of Python is lost: the flag is read, too.
        with suppress(KeyboardInterrupt):
            stop = StopFlag(is_armed=False, on_stop=status.drain)
            config = msgspec.structs.replace(config, name=name)
            run_sensor_process(bus, config, stop, status=status)


def _list_all_addresses(sensors: Iterable[SceneSensor]) -> list[SensorAddress]:
    return [
        address
        for sensor in sensors
        for address in (*list_addresses(sensor), *list_subscriptions(sensor))
    ]
