"""Topics of the sensors of one robot that its agent simulates."""

from functools import partial

import numpy as np

from zensim.proto.codec.cdr_template import CdrTemplate
from zensim.proto.message_paths import HEADER_STAMP
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.standard_messages import Header
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.mounted_sensors import list_sensor_keys, list_state_sensors, mount_sensors
from zensim.robot_agent.robot_rows import NEW_ROW, StateRows
from zensim.robot_agent.state_sensors import (
    SensorOutput,
    StateSensor,
    identify_sensor,
    make_state_sensor,
)

FIRST_ROW = np.zeros(1, dtype=np.int64)
"""Row of the only robot."""


class StateSensorTelemetry:
    """The sensors of one robot, as groups of one."""

    def __init__(self, factory: TopicFactory, claim: Claim) -> None:
        self.publishers: list[LazyTopicPublisher] = []
        self._sensors: list[tuple[StateSensor, list[LazyTopicPublisher]]] = []
        self._state: RobotState | None = None
        topic_keys = iter(list_sensor_keys(claim.model, claim.namespace))
        mounted = mount_sensors(claim.model)
        for sensor, mount in zip(list_state_sensors(claim.model), mounted, strict=True):
            rows = make_state_sensor(mount, claim.environment)
            rows.remap([identify_sensor(claim, sensor)], np.array([NEW_ROW]))
            publishers = []
            for output in (rows.outputs[topic] for topic in mount.topics):
                template = CdrTemplate(
                    rows.make_template(output.topic, Header(frame_id=sensor.frame_id)),
                    numbers=output.paths,
                    stamps=HEADER_STAMP,
                )
                value = partial(self._fill_template, template, rows, output)
                topic = output.topic.at(next(topic_keys))
                publishers.append(LazyTopicPublisher(factory, topic, value))
            self.publishers += publishers
            self._sensors.append((rows, publishers))

    def reset(self) -> None:
        """Forget all states; time may have gone back."""
        for sensor, _ in self._sensors:
            sensor.reset()

    def publish(self, state: RobotState) -> None:
        """Publish what is due."""
        rows = StateRows(
            state.time_ns,
            np.array([state.base]),
            np.array([state.positions]),
            np.array([state.velocities]),
        )
        for sensor, publishers in self._sensors:
            if len(sensor.take(rows)):
                for publisher in publishers:
                    publisher.publish()

    @staticmethod
    def _fill_template(
        template: CdrTemplate, sensor: StateSensor, output: SensorOutput
    ) -> bytes | None:
        if (time_ns := sensor.measured_ns) is None:
            return None
        return template.payload(time_ns, sensor.find_numbers(output, FIRST_ROW)[0].tolist())
