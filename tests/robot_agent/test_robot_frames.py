"""Frames and transforms of a robot."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot_agent.models import DRIVE, FOOTPRINT, WHEELS, two_wheeler
from zensim.proto.messages.model_messages import (
    Frame,
    Joint,
    JointStatePublisher,
    Link,
    Model,
    Origin,
)
from zensim.proto.messages.standard_messages import (
    Header,
    Quaternion,
    Time,
    TransformStamped,
    Vector3,
)
from zensim.proto.rigid_transforms import compose, from_axis_angle, invert
from zensim.proto.tf_joints import list_published_joints
from zensim.robot_agent.odometry import BaseMotion
from zensim.robot_agent.robot_frames import (
    BaseFrame,
    FrameEdge,
    MovingJoint,
    find_base_frame,
    list_fixed_edges,
    list_moving_joints,
    make_moving_transforms,
    make_odometry_edge,
)

STAMP = Time(1, 2)
LIDAR = Joint("lidar_joint", "revolute", "base_link", "lidar", axis=(0.0, 0.0, 1.0))
QUIET = msgspec.structs.replace(DRIVE, publish_odom_tf=False, publish_wheel_tf=False)


def with_base(name: str, **changes: bool) -> Model:
    drive = msgspec.structs.replace(DRIVE, robot_base_frame=name, **changes)
    return two_wheeler(drive)


def parents_of(model: Model) -> dict[str, str]:
    return {edge.child: edge.parent for edge in list_fixed_edges(model, find_base_frame(model))}


def names_of(model: Model) -> list[str]:
    return [model.joints[joint.index].name for joint in list_moving_joints(model)]


def test_base_is_a_frame_on_the_root_link() -> None:
    assert find_base_frame(two_wheeler()) == BaseFrame("base_footprint", Origin((0.0, 0.0, -0.1)))


def test_base_is_the_root_link_when_the_drive_says_so() -> None:
    assert find_base_frame(with_base("base_link")) == BaseFrame("base_link", Origin())


def test_unknown_base_has_the_pose_of_the_root_link() -> None:
    assert find_base_frame(with_base("nowhere")) == BaseFrame("nowhere", Origin())


def test_base_is_the_root_link_when_the_frame_moves_on_it() -> None:
    assert find_base_frame(with_base("left_wheel")).name == "base_link"


def test_base_is_the_root_link_when_there_is_no_drive() -> None:
    assert find_base_frame(two_wheeler(None)) == BaseFrame("base_link", Origin())


def test_base_is_composed_along_frames_on_frames() -> None:
    frames = (
        Frame(
            "plate",
            "base_link",
            Origin((0.0, 0.0, 0.1), from_axis_angle((0.0, 0.0, 1.0), math.pi / 2)),
        ),
        Frame("base_footprint", "plate", Origin((1.0, 0.0, 0.0))),
    )

    base = find_base_frame(two_wheeler(frames=frames))

    assert base.pose_in_root.position == pytest.approx((0.0, 1.0, 0.1))


def test_fixed_frames_hang_from_the_base_when_the_description_has_it_the_other_way_round() -> None:
    assert parents_of(two_wheeler()) == {"base_link": "base_footprint", "camera": "base_link"}


def test_fixed_frame_is_inverted_when_its_parent_comes_to_hang_from_it() -> None:
    edges = list_fixed_edges(two_wheeler(), find_base_frame(two_wheeler()))

    assert edges[0] == FrameEdge("base_footprint", "base_link", invert(FOOTPRINT.origin))


def test_fixed_frames_hang_as_described_when_the_base_is_the_root_link() -> None:
    assert parents_of(with_base("base_link")) == {
        "base_footprint": "base_link",
        "camera": "base_link",
    }


def test_fixed_frames_join_the_root_link_when_the_description_lacks_the_base() -> None:
    assert parents_of(with_base("nowhere"))["base_link"] == "nowhere"


def test_fixed_frames_omit_an_unknown_base_without_odometry() -> None:
    assert "base_link" not in parents_of(with_base("nowhere", publish_odom_tf=False))


def test_fixed_frames_hold_joints_that_do_not_move() -> None:
    bolted = Joint("bolt", "fixed", "base_link", "box", Origin((1.0, 0.0, 0.0)))

    assert parents_of(two_wheeler(joints=(*WHEELS, bolted)))["box"] == "base_link"


def test_fixed_frames_end_when_a_description_goes_in_circles() -> None:
    frames = (Frame("base_footprint", "plate"), Frame("plate", "base_footprint"))

    assert find_base_frame(two_wheeler(frames=frames)).name == "base_link"


@given(st.data())
def test_tf_is_one_tree_whatever_is_fixed_to_what(data: st.DataObject) -> None:
    names = ["base_link"]
    frames = []
    for index in range(data.draw(st.integers(0, 6))):
        parent = data.draw(st.sampled_from(names))
        frames.append(Frame(f"frame{index}", parent, Origin((float(index), 1.0, 0.0))))
        names.append(f"frame{index}")
    drive = msgspec.structs.replace(DRIVE, robot_base_frame=data.draw(st.sampled_from(names)))
    model = Model("any", (Link("base_link"),), (), tuple(frames), drive)

    base = find_base_frame(model)
    edges = list_fixed_edges(model, base)

    placed = {base.name: Origin()}
    for edge in edges:
        assert edge.child not in placed
        placed[edge.child] = compose(placed[edge.parent], edge.origin)
    assert set(placed) == set(names)
    assert placed["base_link"].position == pytest.approx(invert(base.pose_in_root).position)


def test_moving_joints_include_wheels_with_publish_wheel_tf() -> None:
    publisher = JointStatePublisher(("lidar_joint",))

    assert names_of(two_wheeler(joints=(*WHEELS, LIDAR), joint_state=publisher)) == [
        "left_joint",
        "right_joint",
        "lidar_joint",
    ]


def test_moving_joints_omit_wheels_by_default() -> None:
    publisher = JointStatePublisher(("lidar_joint",))
    model = two_wheeler(QUIET, joints=(*WHEELS, LIDAR), joint_state=publisher)

    assert names_of(model) == ["lidar_joint"]


def test_moving_joints_include_wheels_whose_states_are_published() -> None:
    publisher = JointStatePublisher(("left_joint",))

    assert names_of(two_wheeler(QUIET, joint_state=publisher)) == ["left_joint"]
    assert names_of(two_wheeler(QUIET)) == ["left_joint", "right_joint"]


def test_published_joints_are_all_that_move_when_nothing_chooses() -> None:
    bolted = Joint("bolt", "fixed", "base_link", "box")

    assert list_published_joints(two_wheeler(joints=(bolted, *WHEELS))) == (1, 2)


def test_published_joints_are_those_of_the_publisher() -> None:
    publisher = JointStatePublisher(("right_joint", "missing"))

    assert list_published_joints(two_wheeler(joint_state=publisher)) == (1,)


def test_turning_joint_turns_its_child_about_its_axis() -> None:
    origin = Origin((1.0, 2.0, 3.0), from_axis_angle((0.0, 0.0, 1.0), 1.0))
    joint = MovingJoint(Joint("j", "revolute", "a", "b", origin, axis=(0.0, 0.0, 2.0)), 0)

    moved = joint.to_message(0.5, STAMP)

    assert moved.header == Header(STAMP, "a")
    assert moved.child_frame_id == "b"
    assert moved.transform.translation == Vector3(1.0, 2.0, 3.0)
    assert moved.transform.rotation.z == pytest.approx(math.sin(0.75))
    assert moved.transform.rotation.w == pytest.approx(math.cos(0.75))


def test_sliding_joint_shifts_its_child_along_its_axis() -> None:
    origin = Origin((1.0, 0.0, 0.0), from_axis_angle((0.0, 0.0, 1.0), math.pi / 2))
    joint = MovingJoint(Joint("j", "prismatic", "a", "b", origin, axis=(1.0, 0.0, 0.0)), 0)

    shift = joint.to_message(0.5, STAMP).transform.translation

    assert (shift.x, shift.y, shift.z) == pytest.approx((1.0, 0.5, 0.0))


def test_moving_transforms_take_each_joints_own_position() -> None:
    model = two_wheeler(joints=(LIDAR, *WHEELS))
    joints = list_moving_joints(model)

    left = make_moving_transforms(joints, (0.0, 1.0, 0.0), STAMP)[1]

    assert left.child_frame_id == "left_wheel"
    assert left.transform.rotation.y == pytest.approx(math.sin(0.5))


def test_odometry_edge_places_the_base() -> None:
    motion = BaseMotion((1.0, 2.0, 0.0), (0.0, 0.0, 1.0, 0.0))

    stamped = make_odometry_edge("odom", "base_footprint", motion).to_message(STAMP)

    assert isinstance(stamped, TransformStamped)
    assert stamped.header == Header(STAMP, "odom")
    assert stamped.transform.translation == Vector3(1.0, 2.0, 0.0)
    assert stamped.transform.rotation == Quaternion(0.0, 0.0, 1.0, 0.0)
