"""Sensors of a group that agents simulate, and their topics."""

from collections.abc import Sequence
from functools import partial

import msgspec

from zensim.proto.message_paths import HEADER_STAMP
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Header
from zensim.robot_agent.mounted_sensors import list_state_sensors
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.pool.group_telemetry import FindPublisher, GroupTopic
from zensim.robot_agent.robot_rows import IntArray, StateRows
from zensim.robot_agent.state_sensors import identify_sensor, make_state_sensor


class GroupSensors:
    """The sensors of equal robots; each has a row per robot."""

    def __init__(self, group_key: GroupKey, find_publisher: FindPublisher) -> None:
        """Declare the topics.

        Args:
            group_key: Of the robots.
            find_publisher: Finds the publishers of the topics.
        """
        self._mounted = group_key.sensors
        self._sensors = [make_state_sensor(one, group_key.environment) for one in self._mounted]
        self._topics_of: list[list[GroupTopic]] = []
        patterns = iter(group_key.patterns.sensors)
        for sensor, mounted in zip(self._sensors, self._mounted, strict=True):
            outputs = [sensor.outputs[topic] for topic in mounted.topics]
            self._topics_of.append(
                [
                    GroupTopic(
                        find_publisher(next(patterns), output.topic),
                        numbers=partial(sensor.find_numbers, output),
                        paths=output.paths,
                        stamps=HEADER_STAMP,
                    )
                    for output in outputs
                ]
            )
        self.topics = tuple(topic for topics in self._topics_of for topic in topics)
        """Topics that each robot has, in the order of `make_templates`."""

    def make_templates(self, model: Model) -> Sequence[msgspec.Struct]:
        """Make the message templates of a model, one per topic."""
        listed = list_state_sensors(model)
        return [
            sensor.make_template(sensor.outputs[topic].topic, Header(frame_id=one.frame_id))
            for sensor, mounted, one in zip(self._sensors, self._mounted, listed, strict=True)
            for topic in mounted.topics
        ]

    def remap(self, claims: Sequence[Claim], before: IntArray) -> None:
        """Set the robots, one per row, and the former row of each; see `remap_floats`."""
        if not self._sensors:
            return
        listed = [list_state_sensors(claim.model) for claim in claims]
        for number, sensor in enumerate(self._sensors):
            pairs = zip(claims, listed, strict=True)
            sensor.remap([identify_sensor(claim, one[number]) for claim, one in pairs], before)

    def reset(self) -> None:
        """Forget all states; time may have gone back."""
        for sensor in self._sensors:
            sensor.reset()
        for topic in self.topics:
            topic.reset()

    def publish(self, state: StateRows) -> None:
        """Publish what is due."""
        for sensor, topics in zip(self._sensors, self._topics_of, strict=True):
            rows = sensor.take(state)
            for topic in topics if len(rows) else ():
                topic.publish(rows, state.time_ns)
