"""Fixed transforms of a pool are few messages, and follow its robots."""

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryBus
from tests.proto.drives.robots_of_each_drive import DRIVES, robot_of
from tests.robot_agent.models import DRIVE, two_wheeler
from tests.robot_agent.pool.pool_samples import a_state, claims_of, messages, roots
from zensim.proto.codec.cdr import encode
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Frame, GroundTruth, Model, Origin
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_catalog import TF_STATIC
from zensim.robot_agent.pool import static_topics
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robot_telemetry import make_fixed_transforms, make_shared_transforms
from zensim.robot_agent.robots import IndividualRobots

STATIC_KEY = RosGraph(MemoryBus(), RosSettings()).data_key(TF_STATIC.root())
ON_TF_STATIC = "@ros2_lv/0/*/*/*/MP/*/*/*/%tf_static/**"


class PoolOfStatic:
    """A pool with subscribers to the shared fixed transforms."""

    def __init__(self, *models: Model) -> None:
        self.bus = MemoryBus()
        self.pool = PooledRobots(self.bus, 0, RosGraph(self.bus, RosSettings()))
        self.plain = self.bus.subscribe("tf_static", 64)
        self.ros = self.bus.subscribe(STATIC_KEY, 64)
        self.claims = claims_of(models)
        self.pool.add_claims(self.claims)
        self.pool.announce()

    def late(self) -> list[TFMessage]:
        """Query as a late subscriber of rmw_zenoh does."""
        if not self.bus.pumps:
            self.bus.pumps.append(self.pool.reply_to_queries)
        found = self.bus.ask(f"{STATIC_KEY}/@adv/pub/ab12/uhlc/_", b"", b"")
        return [decode(TFMessage, one.payload, one.encoding) for one in found]


def test_fixed_transforms_of_a_pool_are_one_message_on_plain_and_ros_keys() -> None:
    published = PoolOfStatic(*[robot_of(DRIVES["diff"])] * 20)

    (plain,), (ros,), (late,) = (
        messages(published.plain),
        messages(published.ros),
        published.late(),
    )

    assert plain == ros == late
    assert {
        edge.child_frame_id for edge in plain.transforms if edge.header.frame_id == "world"
    } == {f"r{number}/odom" for number in range(1, 21)}


def test_fixed_transforms_are_those_of_robots_that_are_driven_one_by_one() -> None:
    models = [robot_of(DRIVES["diff"]), robot_of(DRIVES["car"]), watched_robot()]
    published = PoolOfStatic(*models)
    bus = MemoryBus()
    received = bus.subscribe("tf_static", 64)
    fleet = IndividualRobots(bus, 0, RosGraph(bus, RosSettings()))
    fleet.add_claims(published.claims)

    (plain,) = published.plain.take()

    expected = messages(received)
    assert len(expected) == len(models)
    whole = TFMessage(tuple(edge for one in expected for edge in one.transforms))
    assert sorted(decode(TFMessage, plain.payload, plain.encoding).transforms, key=repr) == sorted(
        whole.transforms, key=repr
    )
    assert plain.payload == encode(decode(TFMessage, plain.payload, plain.encoding))


NAMESPACES = ("r", "fleet/r2", "r2", "a" * 40, "q2", "fleet/r3")


@pytest.mark.parametrize("frame", ["camera", "r2/camera"])
@pytest.mark.parametrize(
    "drive", [DRIVE, msgspec.structs.replace(DRIVE, odometry_source="encoder")]
)
def test_fixed_transforms_of_one_model_have_the_namespace_of_each_robot(
    drive: DiffDrive, frame: str
) -> None:
    joint = Frame(frame, "base_link", Origin((0.2, 0.0, 0.1)))
    model = two_wheeler(drive, frames=(*two_wheeler().frames, joint))
    spawns = np.random.default_rng(1).uniform(-1.0, 1.0, (len(NAMESPACES), STATE_COLUMNS))
    claims = [
        Claim(number, name, name, model, spawn_state=tuple(spawn.tolist()))
        for number, (name, spawn) in enumerate(zip(NAMESPACES, spawns, strict=True), 1)
    ]
    bus, settings = MemoryBus(), RosSettings()
    received = bus.subscribe("tf_static", 64)
    pool = PooledRobots(bus, 0, RosGraph(bus, settings))

    pool.add_claims(claims)
    pool.announce()

    fixed = make_fixed_transforms(model)
    alone = [make_shared_transforms(one, fixed, settings) for one in claims]
    (message,) = received.take()
    assert message.payload == encode(
        TFMessage(tuple(edge for one in alone for edge in one.transforms))
    )


def watched_robot() -> Model:
    """Make a robot that no group can hold."""
    return msgspec.structs.replace(
        robot_of(DRIVES["diff"]), ground_truths=(GroundTruth("base_link", topic="truth"),)
    )


def test_fixed_transforms_of_many_robots_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(static_topics, "MAX_TF_MESSAGE_BYTES", 1)
    published = PoolOfStatic(*[robot_of(DRIVES["diff"])] * 3)

    assert [roots(one) - {"world"} for one in published.late()] == [{"r1"}, {"r2"}, {"r3"}]
    assert len(published.bus.list_tokens(ON_TF_STATIC)) == 3


def test_new_robot_is_published_with_the_others_and_a_removed_one_no_more() -> None:
    published = PoolOfStatic(*[robot_of(DRIVES["diff"])] * 2)
    published.ros.take()
    third = msgspec.structs.replace(published.claims[0], claim=3, entity="r3", namespace="r3")

    published.pool.add_claims([third])
    for _ in range(3):
        published.pool.announce()

    (added,) = messages(published.ros)
    assert roots(added) == {"world", "r1", "r2", "r3"}
    published.pool.release_all_except(a_state([*published.claims[1:], third], 1).claims)
    published.pool.announce()
    assert messages(published.ros) == []
    assert [roots(one) for one in published.late()] == [{"world", "r2", "r3"}]


def test_pool_without_robots_has_no_shared_static_topic() -> None:
    published = PoolOfStatic(robot_of(DRIVES["diff"]))
    (token,) = published.bus.list_tokens(ON_TF_STATIC)
    assert "/zensim_pool_ab12_static/" in token

    published.pool.release_all_except(b"")

    assert published.bus.list_tokens("@ros2_lv/**") == []
    assert not published.bus.is_served("tf_static")
