"""True odometry of links."""

import math

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryBus
from tests.models import a_state
from tests.robot_agent.models import DRIVE, a_claim, two_wheeler
from zensim.proto.codec.message_codec import decode
from zensim.proto.memory_bus import MemorySubscription
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import GroundTruth, Origin
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.se3 import from_rpy
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.robots import DrivenRobot
from zensim.robot_agent.true_odometry import TrueOdometryTelemetry

MS = 1_000_000
QUARTER = math.pi / 2.0
MOVING = a_state((1.0, 2.0, 0.1), turn=(0.0, 0.0, QUARTER), linear=(0.0, 0.5, 0.0))
PLUGIN = GroundTruth("base_link", topic="truth")


def state(time_ms: int = 0, velocities: tuple[float, ...] = (0.0, 0.0)) -> RobotState:
    return RobotState(time_ms * MS, tuple(MOVING.tolist()), (0.0, 0.0), velocities)


def make_telemetry(bus: MemoryBus, *plugins: GroundTruth) -> TrueOdometryTelemetry:
    model = msgspec.structs.replace(two_wheeler(), ground_truths=plugins)
    return TrueOdometryTelemetry(TopicFactory(bus), a_claim(model=model))


def messages(listener: MemorySubscription) -> list[Odometry]:
    return [decode(Odometry, one.payload, one.encoding) for one in listener.take()]


def publish(plugin: GroundTruth, key: str = "r1/truth") -> Odometry:
    bus = MemoryBus()
    listener = bus.subscribe(key)
    make_telemetry(bus, plugin).publish(state())
    (message,) = messages(listener)
    return message


def test_true_odometry_is_the_pose_in_the_world_and_the_velocity_in_the_body() -> None:
    message = publish(PLUGIN)

    pose, twist = message.pose.pose, message.twist.twist
    assert (message.header.frame_id, message.child_frame_id) == ("world", "base_link")
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 0.1)
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert (twist.linear.x, twist.linear.y) == pytest.approx((0.5, 0.0))
    assert message.pose.covariance == (0.0,) * 36


def test_true_velocity_has_world_axes_with_compat_gazebo11() -> None:
    twist = publish(msgspec.structs.replace(PLUGIN, compat="gazebo11")).twist.twist

    assert (twist.linear.x, twist.linear.y) == pytest.approx((0.0, 0.5))


def test_true_odometry_covers_moving_and_merged_links() -> None:
    bus = MemoryBus()
    wheel, camera = bus.subscribe("r1/wheel"), bus.subscribe("r1/camera")
    plugins = (GroundTruth("left_wheel", topic="wheel"), GroundTruth("camera", topic="camera"))

    make_telemetry(bus, *plugins).publish(state(velocities=(3.0, 0.0)))

    (spin,), (view,) = messages(wheel), messages(camera)
    assert spin.twist.twist.angular.y == pytest.approx(3.0)
    assert view.pose.pose.position.y == pytest.approx(2.2)


def test_true_odometry_may_be_relative_to_a_link() -> None:
    plugin = msgspec.structs.replace(PLUGIN, body="camera", frame_id="base_footprint")

    message = publish(plugin)

    position = message.pose.pose.position
    assert (position.x, position.y, position.z) == pytest.approx((0.2, 0.0, 0.2))
    assert message.pose.pose.orientation.w == pytest.approx(1.0)
    assert message.twist.twist.linear.x == pytest.approx(0.0)


def test_true_odometry_has_the_described_offset() -> None:
    x, y, z, w = from_rpy(0.0, 0.0, -QUARTER).tolist()
    plugin = msgspec.structs.replace(PLUGIN, offset=Origin((10.0, 0.0, 0.0), (x, y, z, w)))

    pose = publish(plugin).pose.pose

    assert (pose.position.x, pose.position.y) == (11.0, 2.0)
    assert pose.orientation.w == pytest.approx(1.0)


def test_true_odometry_is_published_at_its_rate_on_its_remapped_key() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/exact", depth=100)
    rules = RosBlock(remappings=("odom:=exact",))
    telemetry = make_telemetry(bus, GroundTruth("base_link", update_rate_hz=20.0, ros=rules))

    for time_ms in range(0, 1000, 10):
        telemetry.publish(state(time_ms))

    assert len(messages(listener)) == 20


def list_velocities(*, resets: bool = False) -> list[float]:
    bus = MemoryBus()
    listener = bus.subscribe("r1/truth", depth=2000)
    telemetry = make_telemetry(bus, msgspec.structs.replace(PLUGIN, noise=0.1))
    for time_ms in range(0, 500, 1):
        telemetry.publish(state(time_ms))
    if resets:
        telemetry.reset()
        listener.take()
        for time_ms in range(0, 500, 1):
            telemetry.publish(state(time_ms))
    received = messages(listener)
    assert received[0].twist.covariance[::7] == pytest.approx((0.01,) * 6)
    return [message.twist.twist.linear.x for message in received]


def test_true_velocity_has_the_described_noise_in_every_run() -> None:
    first = list_velocities()

    assert np.mean(first) == pytest.approx(0.5, abs=0.02)
    assert np.std(first) == pytest.approx(0.1, rel=0.15)
    assert list_velocities() == first
    assert list_velocities(resets=True) == first


def test_robot_publishes_and_replies_with_true_odometry_until_closed() -> None:
    bus = MemoryBus()
    model = msgspec.structs.replace(two_wheeler(DRIVE), ground_truths=(PLUGIN,))
    robot = DrivenRobot(TopicFactory(bus), a_claim(model=model), 500 * MS)
    listener = bus.subscribe("r1/truth")
    robot.advance(state())

    robot.publish()

    assert len(messages(listener)) == 1
    assert bus.is_served("r1/truth")
    robot.close()
    assert not bus.is_served("r1/truth")
