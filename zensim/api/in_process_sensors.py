"""InProcessSensors: lidars and cameras of a world in process, measured for subscribers only."""

from zensim.proto.memory_bus import MemoryBus
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.proto.sensor_schedule import is_due
from zensim.proto.topic_faults import TopicFaults
from zensim.sim_server.sensors.scene_roster import POSE_COLUMNS, SceneRoster
from zensim.sim_server.sensors.sensor_config import SensorProcessConfig
from zensim.sim_server.sensors.sensor_groups import SceneMoment, list_addresses
from zensim.sim_server.sensors.sensor_process import SensorShare
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.spawner.client.service_client import ServiceClient

NAME = "sensors"


class InProcessSensors:
    """Publishes the sensors as a sensor process does: at the same steps, with the same bytes."""

    def __init__(self, world: SimulatedWorld, network: MemoryBus, faults: TopicFaults) -> None:
        """Read the entities.

        Args:
            world: Its sensors are measured.
            network: Of the sensors only, with the subscriptions of users.
            faults: Of the topics, with the messages that they keep.
        """
        self._world = world
        self._network = network
        config = SensorProcessConfig(endpoint="", world=world.name, name=NAME)
        self._share = SensorShare(network, config, RosGraph(network, NO_ROS))
        self._share.topics.faults = faults
        self._version = -1
        self._update()

    def find_refusal(self, key: str) -> str:
        """Find why the sensor with this topic cannot be measured here; empty if it can."""
        self._update()
        for sensor in self._share.unmeasured:
            if any(address.key == key for address in list_addresses(sensor)):
                return str(self._share.find_fault(sensor, NAME))
        return ""

    def publish(self) -> None:
        """Measure and publish what is due at this step and has subscribers."""
        self._update()
        roster = self._share.roster
        if roster is None or not self._share.topics.is_wanted:
            return
        step = self._world.clock.steps
        groups = self._share.find_groups()
        due = [
            group
            for group in groups
            if is_due(step, group.sensors[0].sensor.update_rate_hz, roster.environment)
        ]
        if due:
            states = self._world.states()
            poses = states.base[:, :POSE_COLUMNS].copy()
            time_ns = self._world.clock.time_ns
            moment = SceneMoment(step, time_ns, poses, states.joint_positions)
            faults = self._world.injected_faults.topic_faults
            self._share.topics.faults.update(faults, time_ns)
            for group in due:
                group.publish(moment)

    def _update(self) -> None:
        """Follow changes of the entities and of the subscriptions."""
        roster = self._share.roster
        if roster is None or roster.number != self._world.entities.roster_number:
            found = ServiceClient(self._network, self._world.name).models()
            self._share.set_roster(SceneRoster(found, roster))
            self._version = -1
        if self._version != self._network.version:
            self._version = self._network.version
            self._share.topics.check_all()

    def reply_to_queries(self) -> None:
        """Reply to queries for the last messages."""
        self._update()
        self._share.topics.poll()
