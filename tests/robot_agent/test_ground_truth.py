"""What ground truth plug-ins tell."""

import math

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryBus, MemorySubscription
from tests.models import a_state
from tests.robot_agent.models import DRIVE, a_claim, two_wheeler
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.model_messages import GroundTruth, Origin, RosBlock
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.rotation import from_rpy
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.ground_truth import TruthTelemetry
from zensim.robot_agent.reading import Reading
from zensim.robot_agent.robot import Robot

MS = 1_000_000
QUARTER = math.pi / 2.0
MOVING = a_state((1.0, 2.0, 0.1), turn=(0.0, 0.0, QUARTER), linear=(0.0, 0.5, 0.0))
TRUTH = GroundTruth("base_link", topic="truth")


def reading(time_ms: int = 0, velocities: tuple[float, ...] = (0.0, 0.0)) -> Reading:
    return Reading(time_ms * MS, tuple(MOVING.tolist()), (0.0, 0.0), velocities)


def telling(bus: MemoryBus, *truths: GroundTruth) -> TruthTelemetry:
    model = msgspec.structs.replace(two_wheeler(), ground_truths=truths)
    return TruthTelemetry(TopicFactory(bus), a_claim(model=model))


def messages(listener: MemorySubscription) -> list[Odometry]:
    return [decode(Odometry, one.payload, one.encoding) for one in listener.take()]


def told(truth: GroundTruth, key: str = "r1/truth") -> Odometry:
    bus = MemoryBus()
    listener = bus.subscribe(key)
    telling(bus, truth).tell(reading())
    (message,) = messages(listener)
    return message


def test_truth_is_the_pose_in_the_world_and_the_velocity_in_the_body() -> None:
    message = told(TRUTH)

    pose, twist = message.pose.pose, message.twist.twist
    assert (message.header.frame_id, message.child_frame_id) == ("world", "base_link")
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 0.1)
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert (twist.linear.x, twist.linear.y) == pytest.approx((0.5, 0.0))
    assert message.pose.covariance == (0.0,) * 36


def test_velocity_is_along_the_axes_of_the_world_as_gazebo_has_it() -> None:
    twist = told(msgspec.structs.replace(TRUTH, compat="gazebo11")).twist.twist

    assert (twist.linear.x, twist.linear.y) == pytest.approx((0.0, 0.5))


def test_truth_is_of_links_that_move_or_are_merged() -> None:
    bus = MemoryBus()
    wheel, camera = bus.subscribe("r1/wheel"), bus.subscribe("r1/camera")
    truths = (GroundTruth("left_wheel", topic="wheel"), GroundTruth("camera", topic="camera"))

    telling(bus, *truths).tell(reading(velocities=(3.0, 0.0)))

    (spin,), (view,) = messages(wheel), messages(camera)
    assert spin.twist.twist.angular.y == pytest.approx(3.0)
    assert view.pose.pose.position.y == pytest.approx(2.2)


def test_truth_may_be_told_relative_to_a_link() -> None:
    truth = msgspec.structs.replace(TRUTH, body="camera", frame_id="base_footprint")

    message = told(truth)

    position = message.pose.pose.position
    assert (position.x, position.y, position.z) == pytest.approx((0.2, 0.0, 0.2))
    assert message.pose.pose.orientation.w == pytest.approx(1.0)
    assert message.twist.twist.linear.x == pytest.approx(0.0)


def test_truth_is_off_by_what_is_asked_for() -> None:
    x, y, z, w = from_rpy(0.0, 0.0, -QUARTER).tolist()
    truth = msgspec.structs.replace(TRUTH, offset=Origin((10.0, 0.0, 0.0), (x, y, z, w)))

    pose = told(truth).pose.pose

    assert (pose.position.x, pose.position.y) == (11.0, 2.0)
    assert pose.orientation.w == pytest.approx(1.0)


def test_truth_is_told_at_its_rate_where_it_is_remapped_to() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/exact", depth=100)
    rules = RosBlock(remappings=("odom:=exact",))
    telemetry = telling(bus, GroundTruth("base_link", update_rate_hz=20.0, ros=rules))

    for time_ms in range(0, 1000, 10):
        telemetry.tell(reading(time_ms))

    assert len(messages(listener)) == 20


def velocities_told(*, resets: bool = False) -> list[float]:
    bus = MemoryBus()
    listener = bus.subscribe("r1/truth", depth=2000)
    telemetry = telling(bus, msgspec.structs.replace(TRUTH, noise=0.1))
    for time_ms in range(0, 500, 1):
        telemetry.tell(reading(time_ms))
    if resets:
        telemetry.reset()
        listener.take()
        for time_ms in range(0, 500, 1):
            telemetry.tell(reading(time_ms))
    heard = messages(listener)
    assert heard[0].twist.covariance[::7] == pytest.approx((0.01,) * 6)
    return [message.twist.twist.linear.x for message in heard]


def test_velocity_has_the_noise_that_is_asked_for_the_same_on_every_run() -> None:
    first = velocities_told()

    assert np.mean(first) == pytest.approx(0.5, abs=0.02)
    assert np.std(first) == pytest.approx(0.1, rel=0.15)
    assert velocities_told() == first
    assert velocities_told(resets=True) == first


def test_robot_tells_and_answers_its_ground_truth_until_it_is_closed() -> None:
    bus = MemoryBus()
    model = msgspec.structs.replace(two_wheeler(DRIVE), ground_truths=(TRUTH,))
    robot = Robot(TopicFactory(bus), a_claim(model=model), 500 * MS)
    listener = bus.subscribe("r1/truth")
    robot.advance(reading())

    robot.tell()

    assert len(messages(listener)) == 1
    assert bus.is_served("r1/truth")
    robot.close()
    assert not bus.is_served("r1/truth")
