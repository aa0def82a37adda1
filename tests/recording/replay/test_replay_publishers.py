"""A replay publishes on plain keys and those of ROS 2, and replies to late subscribers."""

from pathlib import Path

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.recording.replays import TYPE_HASH, make_odometry, make_text, make_transforms, write_run
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import Clock, String, TFMessage
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.ros2.liveliness_tokens import parse_endpoint_token
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_endpoints import make_topic_factory
from zensim.recording.recorded_topics import HASH_METADATA
from zensim.recording.recording_reader import RecordingReader, StoredTopic
from zensim.recording.replay.replay_publishers import ReplayPublishers
from zensim.recording.replay.replayed_names import NameSettings, ReplayedNames
from zensim.recording.topic_selection import TopicSelection


class PublishersTrial:
    """Publishers of all topics of a recording on a network in memory."""

    def __init__(self, folder: Path) -> None:
        path = folder / "run.mcap"
        write_run(path, 1.0)
        self.bus = MemoryBus()
        reader = RecordingReader(path)
        names = ReplayedNames(NameSettings(selection=TopicSelection()), reader.topics)
        self.graph = RosGraph(self.bus, RosSettings(domain=3))
        factory = make_topic_factory(self.bus, self.graph, "", "zensim_replay")
        self.publishers = ReplayPublishers(self.bus, factory, names, 1_000_000)
        self.topics: dict[str, StoredTopic] = {one.name: one for one in reader.topics}

    def publish(self, name: str, payload: bytes) -> None:
        """Publish on a topic."""
        self.publishers.publish(self.topics[name], payload)

    def get(self, key: str) -> list[bytes]:
        """Query a key."""
        self.bus.pumps = [self.publishers.serve]
        return [one.payload for one in self.bus.get(key)]


@pytest.fixture
def trial(tmp_path: Path) -> PublishersTrial:
    return PublishersTrial(tmp_path)


def test_message_is_published_on_both_keys_as_it_was_recorded(trial: PublishersTrial) -> None:
    plain = trial.bus.subscribe("r1/odom", 8)
    ros = trial.bus.subscribe("3/r1/odom/*/*", 8)

    trial.publish("/r1/odom", make_odometry(7))

    (sample,) = plain.take()
    assert (sample.payload, sample.encoding) == (
        make_odometry(7),
        "application/cdr;nav_msgs/msg/Odometry",
    )
    (of_ros,) = ros.take()
    assert of_ros.payload == make_odometry(7)
    assert len(of_ros.attachment) == 33


def test_topics_have_the_recorded_qos_in_the_graph(trial: PublishersTrial) -> None:
    tokens = [parse_endpoint_token(key) for key in trial.bus.list_tokens("@ros2_lv/3/**")]

    found = {one.key: one for one in tokens if one is not None and one.kind == "MP"}
    assert found["r1/robot_description"].qos.durability == "transient_local"
    assert found["r1/odom"].qos.durability == "volatile"
    assert found["r1/custom"].ros_type == "my_msgs/msg/Own"
    assert {one.node for one in found.values()} == {"/zensim_replay"}


def test_topic_of_an_unknown_type_is_published_as_it_is(trial: PublishersTrial) -> None:
    plain = trial.bus.subscribe("r1/custom", 8)
    ros = trial.bus.subscribe(f"3/r1/custom/my_msgs::msg::dds_::Own_/{TYPE_HASH}", 8)

    trial.publish("/r1/custom", b"\0\1\0\0abcd")

    assert [one.encoding for one in plain.take()] == ["application/cdr;my_msgs/msg/Own"]
    assert [one.payload for one in ros.take()] == [b"\0\1\0\0abcd"]


def test_late_subscriber_gets_the_last_description(trial: PublishersTrial) -> None:
    trial.publish("/r1/robot_description", make_text("<old/>"))
    trial.publish("/r1/robot_description", make_text("<new/>"))
    late = trial.bus.subscribe("r1/robot_description", 8)
    trial.publishers.serve()

    assert [decode(String, one.payload).data for one in late.take()][-1] == "<new/>"
    assert trial.get("r1/robot_description") == [make_text("<new/>")]


def test_late_subscriber_gets_the_static_transforms_of_all(trial: PublishersTrial) -> None:
    for payload in (make_transforms("a", "b"), make_transforms("c"), make_transforms("a")):
        trial.publish("/tf_static", payload)

    (payload,) = trial.get("tf_static")

    children = [one.child_frame_id for one in decode(TFMessage, payload).transforms]
    assert sorted(children) == ["a", "b", "c"]


def test_events_are_published_as_the_world_does(trial: PublishersTrial) -> None:
    events = trial.bus.subscribe("sim/default/events", 8)

    trial.publish("/sim/default/events", make_text('{"kind":"reset"}'))

    (sample,) = events.take()
    assert (sample.payload, sample.encoding) == (b'{"kind":"reset"}', "application/json")


def test_clock_has_time_step_and_epoch_and_replies(trial: PublishersTrial) -> None:
    world = trial.bus.subscribe("sim/default/clock", 8)
    root = trial.bus.subscribe("clock", 8)

    trial.publishers.publish_clock(2_500_000_000, 3)

    clock = decode(WorldClock, world.take()[0].payload)
    assert (clock.clock.sec, clock.clock.nanosec, clock.step, clock.epoch) == (
        2,
        500_000_000,
        2500,
        3,
    )
    assert decode(Clock, root.take()[0].payload).clock == clock.clock
    assert [decode(WorldClock, one) for one in trial.get("sim/default/clock")] == [clock]


@pytest.mark.parametrize(
    ("ros_type", "type_hash"),
    [
        ("my_msgs/msg/Own", "**"),
        ("my_msgs/msg/Own", "RIHS01_ab"),
        ("*/**/Own", TYPE_HASH),
        ("my_msgs/msg/", TYPE_HASH),
    ],
)
def test_types_that_cannot_be_get_no_key_of_ros(
    trial: PublishersTrial, ros_type: str, type_hash: str
) -> None:
    one = msgspec.structs.replace(
        trial.topics["/r1/custom"], ros_type=ros_type, channel_metadata={HASH_METADATA: type_hash}
    )
    names = ReplayedNames(NameSettings(selection=TopicSelection()), [one])
    factory = make_topic_factory(trial.bus, trial.graph, "", "zensim_replay")
    publishers = ReplayPublishers(trial.bus, factory, names)
    plain = trial.bus.subscribe("r1/custom", 8)
    ros = trial.bus.subscribe("3/r1/custom/**", 8)

    publishers.publish(one, bytes(8))

    (sample,) = plain.take()
    assert sample.payload == bytes(8)
    assert ros.take() == []
