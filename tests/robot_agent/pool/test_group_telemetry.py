"""tf of a group, on the shared topic."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import ManualClock, MemoryBus
from tests.proto.drives.robots_of_each_drive import DRIVES, robot_of
from tests.robot_agent.models import DRIVE, two_wheeler
from tests.robot_agent.pool.pool_samples import a_state, claims_of, messages, roots
from zensim.proto import message_paths
from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_batch import CdrBatch
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import Claim, DriveCommand
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    Odometry,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
    time_from_ns,
)
from zensim.proto.ros2.rmw_attachment import read_attachment
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.subscriber_search import (
    MAX_PUBLISHERS,
    SEARCH_PERIOD_S,
    MessageBudget,
    SubscriberWatches,
)
from zensim.robot_agent import message_templates
from zensim.robot_agent.odometry import BaseMotion, OdometryHeader, make_covariances
from zensim.robot_agent.pool import group_telemetry
from zensim.robot_agent.pool.group_telemetry import TfMessageBatch
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robots import IndividualRobots

NUMBER = st.floats(allow_nan=False, allow_infinity=False)
TIME_NS = st.integers(0, 2**31 * 10**9 - 1)


def motion_of(numbers: list[float]) -> BaseMotion:
    x, y, z, qx, qy, qz, qw, vx, vy, wz = numbers
    return BaseMotion((x, y, z), (qx, qy, qz, qw), vx, vy, wz)


@given(
    st.lists(st.tuples(st.text(max_size=9), st.text(max_size=9)), min_size=1, max_size=4), st.data()
)
def test_odometry_is_what_the_encoder_writes(
    names: list[tuple[str, str]], data: st.DataObject
) -> None:
    frames = [OdometryHeader(frame, child, *make_covariances(DRIVE)) for frame, child in names]
    blank = [one.message(BaseMotion(), time_from_ns(0)) for one in frames]
    batch = CdrBatch(blank, message_paths.ODOMETRY_PATHS, message_paths.HEADER_STAMP)
    rows = data.draw(st.lists(st.sampled_from(range(len(names))), unique=True, min_size=1))
    numbers = [data.draw(st.lists(NUMBER, min_size=10, max_size=10)) for _ in rows]
    times = [data.draw(TIME_NS) for _ in rows]

    batch.fill(np.array(rows), np.array(numbers), np.array(times))

    written = [
        cdr.encode(frames[row].message(motion_of(one), time_from_ns(time)))
        for row, one, time in zip(rows, numbers, times, strict=True)
    ]
    assert batch.payloads(np.array(rows)) == [
        written[rows.index(row)] for row in (sorted(rows) if len(rows) == len(names) else rows)
    ]
    assert [batch.payload(row) for row in rows] == written


@pytest.mark.parametrize("child", ["", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg"])
def test_transforms_are_what_the_encoder_writes(child: str) -> None:
    def message(numbers: list[float], time_ns: int) -> TFMessage:
        stamp = time_from_ns(time_ns)
        parts = [numbers[:7], numbers[7:]]
        return TFMessage(
            tuple(
                TransformStamped(
                    Header(stamp, "odom"),
                    child * number,
                    Transform(Vector3(*part[:3]), Quaternion(*part[3:])),
                )
                for number, part in enumerate(parts)
            )
        )

    numbers = np.arange(14.0).tolist()
    batch = CdrBatch(
        [message([0.0] * 14, 0)], message_paths.list_tf_paths(2), message_paths.list_tf_stamps(2)
    )

    batch.fill(np.array([0]), np.array([numbers]), np.array([3 * 10**9 + 5]))

    assert batch.payload(0) == cdr.encode(message(numbers, 3 * 10**9 + 5))


def test_joint_states_are_what_the_encoder_writes() -> None:
    model = two_wheeler()
    batch = CdrBatch(
        [message_templates.make_joint_states_template(model, (0, 1))],
        message_templates.list_joint_paths(2),
        message_paths.HEADER_STAMP,
    )

    batch.fill(np.array([0]), np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]]), np.array([10**9]))

    expected = JointState(
        Header(time_from_ns(10**9)),
        ("left_joint", "right_joint"),
        (0.1, 0.2),
        (0.3, 0.4),
        (0.5, 0.6),
    )
    assert batch.payload(0) == cdr.encode(expected)


NAMES = st.text(max_size=9)


def edge(names: tuple[str, str], stamp: Time, pose: list[float]) -> TransformStamped:
    transform = Transform(Vector3(*pose[:3]), Quaternion(*pose[3:]))
    return TransformStamped(Header(stamp, names[0]), names[1], transform)


@given(st.integers(1, 2), st.data())
def test_message_is_what_the_encoder_writes(count: int, data: st.DataObject) -> None:
    of_robot = st.lists(st.tuples(NAMES, NAMES), min_size=count, max_size=count)
    robots = data.draw(st.lists(of_robot, min_size=1, max_size=4))
    blank = [TFMessage(tuple(edge(one, Time(), [0.0] * 7) for one in names)) for names in robots]
    batch = TfMessageBatch(blank)
    rows = data.draw(st.lists(st.sampled_from(range(len(robots))), unique=True, min_size=1))
    poses = np.random.default_rng(len(rows)).uniform(-9.0, 9.0, (len(rows), 7 * count))
    times_ns = [row * 10**9 + 7 for row in rows]

    written = batch.message(np.array(rows), poses, np.array(times_ns))

    assert written == cdr.encode(
        TFMessage(
            tuple(
                edge(names, time_from_ns(time_ns), pose.tolist())
                for row, numbers, time_ns in zip(rows, poses, times_ns, strict=True)
                for names, pose in zip(robots[row], numbers.reshape(count, 7), strict=True)
            )
        )
    )
    assert len(written) - 8 == sum(batch.size(row) for row in rows[1:]) + first_size(
        robots[rows[0]]
    )


def first_size(names: list[tuple[str, str]]) -> int:
    blank = TFMessage(tuple(edge(one, Time(), [0.0] * 7) for one in names))
    return len(cdr.encode(blank)) - 8


ROS_KEY = "0/tf/tf2_msgs::msg::dds_::TFMessage_/*"
ON_TF = "@ros2_lv/0/*/*/*/MP/%/%/*/%tf/**"


class PoolOnRos:
    """A pool with ROS 2 keys, and subscribers to its transforms."""

    def __init__(self, *models: Model) -> None:
        self.bus = MemoryBus()
        self.pool = PooledRobots(self.bus, 0, RosGraph(self.bus, RosSettings()))
        self.claims = claims_of(models)
        self.pool.add_claims(self.claims)
        self.plain = self.bus.subscribe("tf", 64)
        self.ros = self.bus.subscribe(ROS_KEY, 64)
        self.step = 0

    def advance(self, claims: Sequence[Claim] = ()) -> None:
        """Advance by a state of some robots, by default all."""
        self.step += 1
        state = a_state(claims or self.claims, self.step)
        self.pool.release_all_except(state.claims)
        self.pool.advance(state)
        for _ in range(3):
            self.pool.reply_to_queries()
        self.pool.publish()


def by_frame(published: Sequence[TFMessage]) -> dict[str, TransformStamped]:
    return {edge.child_frame_id: edge for one in published for edge in one.transforms}


def test_robots_of_a_group_share_one_message_on_plain_and_ros_keys() -> None:
    published = PoolOnRos(*[robot_of(DRIVES["diff"])] * 3)

    published.advance()

    (plain,), (ros,) = messages(published.plain), messages(published.ros)
    assert roots(plain) == {"r1", "r2", "r3"}
    assert ros == plain


@pytest.mark.parametrize("drives", [("diff", "diff"), ("diff", "planar"), ("planar", "planar")])
def test_transforms_are_those_of_robots_that_are_driven_one_by_one(drives: Sequence[str]) -> None:
    published = PoolOnRos(*[robot_of(DRIVES[drive]) for drive in drives])
    bus = MemoryBus()
    fleet = IndividualRobots(bus, 0, RosGraph(bus, RosSettings()))
    fleet.add_claims(published.claims)
    received = bus.subscribe("tf", 64)

    for step in range(1, 20):
        published.advance()
        fleet.advance(a_state(published.claims, step))
        fleet.publish()
        found, expected = (by_frame(messages(one)) for one in (published.plain, received))
        assert list(found) == list(expected)
        for child, edge in expected.items():
            assert found[child].header == edge.header
            assert found[child].transform.translation.x == pytest.approx(
                edge.transform.translation.x, abs=1e-12
            )
            assert found[child].transform.rotation.w == pytest.approx(
                edge.transform.rotation.w, abs=1e-12
            )


def test_transforms_of_large_groups_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(group_telemetry, "MAX_TF_MESSAGE_BYTES", 1)
    published = PoolOnRos(*[robot_of(DRIVES["diff"])] * 3)

    published.advance()

    samples = published.ros.take()
    read = [read_attachment(sample.attachment) for sample in samples]
    assert [one.sequence_number for one in read if one] == [1, 2, 3]
    assert len({one.gid for one in read if one}) == 1


def test_pool_is_the_publisher_in_ros() -> None:
    published = PoolOnRos(*[robot_of(DRIVES["diff"])] * 2)
    published.advance()

    (token,) = published.bus.list_tokens(ON_TF)

    assert "/zensim_pool_ab12_1/" in token


def test_query_gets_the_transforms_of_all_robots() -> None:
    published = PoolOnRos(*[robot_of(DRIVES["diff"])] * 2)
    published.bus.pumps.append(published.pool.reply_to_queries)
    assert published.bus.get("tf") == []

    published.advance()

    (answer,) = published.bus.get("tf")
    assert roots(decode(TFMessage, answer.payload, answer.encoding)) == {"r1", "r2"}


def test_removed_robot_is_not_published() -> None:
    published = PoolOnRos(*[robot_of(DRIVES["diff"])] * 2)
    published.advance()
    published.plain.take()

    published.advance(published.claims[1:])

    assert [roots(one) for one in messages(published.plain)] == [{"r2"}]


def test_group_without_robots_has_no_topic() -> None:
    published = PoolOnRos(robot_of(DRIVES["diff"]), robot_of(DRIVES["planar"]))
    published.advance()
    assert len(published.bus.list_tokens(ON_TF)) == 2

    published.pool.release_all_except(b"")

    assert published.bus.list_tokens(ON_TF) == []
    assert not published.bus.is_served("tf")


class LargePool:
    """More robots than those whose publishers are all declared; time stands."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = ManualClock(100.0)
        monkeypatch.setattr("zensim.proto.fleet_topics.topic_members.time.monotonic", self.clock)
        self.bus = MemoryBus()
        watches = SubscriberWatches(self.bus)
        watches.budget = self.budget = MessageBudget(1000.0, self.clock)
        self.pool = PooledRobots(self.bus, 0, watches=watches)
        self.claims = claims_of([robot_of(DRIVES["diff"])] * (MAX_PUBLISHERS + 1))
        self.pool.add_claims(self.claims)
        self.step = 0

    def search(self) -> None:
        self.clock.sleep(SEARCH_PERIOD_S)
        for _ in range(100):
            self.pool.reply_to_queries()

    def advance(self, steps: int = 1) -> DriveCommand:
        self.step += steps
        command = self.pool.advance(a_state(self.claims, self.step))
        self.pool.publish()
        return command


def test_large_pool_publishes_each_state_of_subscribed_robots(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    large = LargePool(monkeypatch)
    received = large.bus.subscribe("r7/odom", 64)
    large.advance()
    large.search()

    for _ in range(5):
        large.advance()

    read = [decode(Odometry, sample.payload, sample.encoding) for sample in received.take()]
    assert len(read) == 5
    assert {one.child_frame_id for one in read} == {"base_footprint"}
    assert len({one.header.stamp for one in read}) == 5


def test_large_pool_serves_wildcards_in_turn_within_its_budget(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    large = LargePool(monkeypatch)
    own = large.bus.subscribe("r7/odom", 64)
    large.advance()
    large.search()
    everything = large.bus.subscribe("*/odom", 4096)
    large.search()
    own.take()

    for _ in range(10):
        large.clock.sleep(0.05)
        large.advance()
    large.clock.sleep(1.0)

    published = [sample.key for sample in everything.take()]
    counts = Counter(key for key in published if key != "r7/odom")
    assert len(own.take()) == 10
    assert sum(counts.values()) == pytest.approx(500, rel=0.2)
    assert max(counts.values()) - min(counts.values()) <= 1
    assert len(counts) == MAX_PUBLISHERS
    assert large.advance().withheld_hz > 0


def test_large_pool_that_misses_states_publishes_less_to_wildcards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    large = LargePool(monkeypatch)
    everything = large.bus.subscribe("*/odom", 4096)
    large.advance()
    large.search()

    counts = []
    for missed in (0, 1, 1, 1, 1):
        everything.take()
        for turn in range(20):
            large.clock.sleep(0.05)
            large.advance(1 + missed * (turn % 2))
        counts.append(len(everything.take()))

    assert counts[0] == pytest.approx(1000, rel=0.2)
    assert counts[-1] < counts[0] / 3
