"""Needs of ROS 2 stacks: each row is wrong, or a note, when its property is missing."""

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import pytest

from zensim.deploy.cli.findings import FindingMark
from zensim.deploy.cli.ros_requirements import RobotTopics, RosStack, check_stack
from zensim.proto.messages.standard_messages import (
    Clock,
    Header,
    LaserScan,
    Odometry,
    PoseWithCovariance,
    String,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    TwistStamped,
    TwistWithCovariance,
)
from zensim.proto.ros2.liveliness_tokens import AnnouncedEndpoint
from zensim.proto.ros2.qos_profiles import LATCHED, RELIABLE_5, Qos

ONES = tuple(1.0 for _ in range(36))
ZEROS = tuple(0.0 for _ in range(36))
LATE_S, OLD_S = 20, -20


def end(
    kind: str, key: str, message: type[msgspec.Struct], qos: Qos = RELIABLE_5
) -> AnnouncedEndpoint:
    return AnnouncedEndpoint(kind, key, "/r1/agent", str(getattr(message, "ros_type", "")), qos)


ENDPOINTS = (
    end("MP", "clock", Clock),
    end("MP", "r1/odom", Odometry),
    end("MP", "r1/tf", TFMessage),
    end("MP", "r1/tf_static", TFMessage, LATCHED),
    end("MP", "r1/scan", LaserScan),
    end("MP", "r1/robot_description", String, LATCHED),
    end("MS", "r1/cmd_vel", Twist),
    end("MS", "r1/cmd_vel", TwistStamped),
)


def transform(parent: str, child: str, second: int = 0) -> TransformStamped:
    return TransformStamped(Header(Time(second), parent), child)


def tf(*edges: tuple[str, str], second: int = 100) -> tuple[TFMessage, ...]:
    return (TFMessage(tuple(transform(*edge, second) for edge in edges)),)


ODOMETRY = Odometry(
    Header(Time(100), "odom"),
    "base_footprint",
    PoseWithCovariance(covariance=ONES),
    TwistWithCovariance(covariance=ONES),
)
SCAN_MESSAGE = LaserScan(
    Header(Time(100), "lidar_link"),
    angle_min=-1.0,
    angle_max=1.0,
    angle_increment=0.5,
    ranges=(1.0,) * 5,
)
FIXED = (("base_footprint", "base_link"), ("base_link", "lidar_link"))
MESSAGES: dict[str, Sequence[msgspec.Struct]] = {
    "clock": (Clock(Time(99)), Clock(Time(100))),
    "tf": tf(("r1/odom", "r1/base_footprint")),
    "tf_static": tf(
        ("world", "r1/odom"),
        ("r1/base_footprint", "r1/base_link"),
        ("r1/base_link", "r1/lidar_link"),
    ),
    "r1/odom": (ODOMETRY,),
    "r1/tf": tf(("odom", "base_footprint")),
    "r1/tf_static": tf(*FIXED, second=0),
    "r1/scan": (SCAN_MESSAGE,),
    "r1/robot_description": (String("<robot/>"),),
}
WHOLE = RobotTopics(
    namespace="r1",
    endpoints=ENDPOINTS,
    messages=MESSAGES,
    links=("base_footprint", "base_link", "lidar_link"),
    meshes={"package://r1/body.stl": ""},
)


def with_messages(**changed: Sequence[msgspec.Struct]) -> RobotTopics:
    """Replace messages; `__` stands for the slash of a topic."""
    named = {name.replace("__", "/"): value for name, value in changed.items()}
    return replace(WHOLE, messages=MESSAGES | named)


def without(key: str, message: type[msgspec.Struct]) -> RobotTopics:
    gone = (key, getattr(message, "ros_type", ""))
    return replace(
        WHOLE, endpoints=tuple(one for one in ENDPOINTS if (one.key, one.ros_type) != gone)
    )


def with_qos(key: str, qos: Qos) -> RobotTopics:
    return replace(
        WHOLE,
        endpoints=tuple(
            msgspec.structs.replace(one, qos=qos) if one.key == key else one for one in ENDPOINTS
        ),
    )


def renamed(key: str, name: str) -> RobotTopics:
    ends = (msgspec.structs.replace(o, key=name) if o.key == key else o for o in ENDPOINTS)
    return replace(WHOLE, endpoints=tuple(ends), messages=MESSAGES | {name: MESSAGES.get(key, ())})


def marks(topics: RobotTopics, stack: RosStack) -> dict[str, FindingMark]:
    return {one.what: one.mark for one in check_stack(topics, stack)}


@pytest.mark.parametrize("stack", RosStack)
def test_stack_finds_nothing_wrong_when_all_is_there(stack: RosStack) -> None:
    found = list(check_stack(WHOLE, stack))

    assert {one.mark for one in found} == {"ok"}
    assert len({one.what for one in found}) == len(found)


@pytest.mark.parametrize("stack", RosStack)
def test_stack_of_a_robot_outside_of_ros_is_one_wrong_row(stack: RosStack) -> None:
    shared = replace(WHOLE, endpoints=ENDPOINTS[:1])

    (found,) = check_stack(shared, stack)

    assert (found.mark, found.what) == ("wrong", "ROS 2")


BEST_EFFORT = Qos(reliability="best_effort")
change = msgspec.structs.replace
MISSING: dict[str, tuple[RosStack, RobotTopics, str, FindingMark]] = {
    "no clock": (RosStack.NAV2, with_messages(clock=()), "clock", "wrong"),
    "clock stands": (RosStack.RVIZ, with_messages(clock=(Clock(),) * 2), "clock", "note"),
    "no odometry": (RosStack.NAV2, without("r1/odom", Odometry), "odometry", "wrong"),
    "silent odometry": (RosStack.NAV2, with_messages(r1__odom=()), "odometry", "wrong"),
    "odometry without frames": (
        RosStack.NAV2,
        with_messages(r1__odom=(Odometry(),)),
        "odometry",
        "wrong",
    ),
    "best effort odometry": (RosStack.NAV2, with_qos("r1/odom", BEST_EFFORT), "odometry", "wrong"),
    "other odometry topic": (RosStack.NAV2, renamed("r1/odom", "r1/odo"), "odometry", "note"),
    "no pose variance": (
        RosStack.NAV2,
        with_messages(r1__odom=(change(ODOMETRY, pose=PoseWithCovariance()),)),
        "covariances",
        "note",
    ),
    "no twist variance": (
        RosStack.NAV2,
        with_messages(r1__odom=(change(ODOMETRY, twist=TwistWithCovariance()),)),
        "covariances",
        "note",
    ),
    "no odometry transform": (RosStack.SLAM, with_messages(r1__tf=()), "odom tf", "wrong"),
    "no node for the transform": (
        RosStack.NAV2,
        replace(with_messages(r1__tf=()), publishes_odom_tf=False),
        "odom tf",
        "wrong",
    ),
    "no base_link": (RosStack.NAV2, with_messages(r1__tf_static=()), "base frame", "note"),
    "no base at all": (
        RosStack.SLAM,
        with_messages(r1__tf=(), r1__tf_static=()),
        "base frame",
        "wrong",
    ),
    "no scan for Nav2": (RosStack.NAV2, without("r1/scan", LaserScan), "scan", "note"),
    "no scan for SLAM": (RosStack.SLAM, without("r1/scan", LaserScan), "scan", "wrong"),
    "silent lidar": (RosStack.NAV2, with_messages(r1__scan=()), "scan", "wrong"),
    "best effort scan": (RosStack.SLAM, with_qos("r1/scan", BEST_EFFORT), "scan", "note"),
    "one range too many": (
        RosStack.SLAM,
        with_messages(r1__scan=(change(SCAN_MESSAGE, ranges=(1.0,) * 6),)),
        "scan angles",
        "wrong",
    ),
    "scan without ranges": (
        RosStack.SLAM,
        with_messages(r1__scan=(change(SCAN_MESSAGE, ranges=()),)),
        "scan angles",
        "wrong",
    ),
    "unknown scan frame": (
        RosStack.SLAM,
        with_messages(r1__tf_static=tf(FIXED[0])),
        "scan frame",
        "wrong",
    ),
    "moving lidar": (
        RosStack.SLAM,
        with_messages(r1__tf=tf(("odom", "base_footprint"), FIXED[1]), r1__tf_static=tf(FIXED[0])),
        "scan frame",
        "note",
    ),
    "scans ahead of tf": (
        RosStack.SLAM,
        with_messages(r1__tf=tf(("odom", "base_footprint"), second=100 - LATE_S)),
        "scan stamps",
        "wrong",
    ),
    "scans that tf forgot": (
        RosStack.NAV2,
        with_messages(r1__tf=tf(("odom", "base_footprint"), second=100 - OLD_S)),
        "scan stamps",
        "wrong",
    ),
    "no commands": (
        RosStack.NAV2,
        replace(WHOLE, endpoints=tuple(one for one in ENDPOINTS if one.kind == "MP")),
        "cmd_vel",
        "wrong",
    ),
    "no stamped commands": (RosStack.NAV2, without("r1/cmd_vel", TwistStamped), "cmd_vel", "note"),
    "other command topic": (RosStack.NAV2, renamed("r1/cmd_vel", "r1/cmd"), "cmd_vel", "note"),
    "no description": (
        RosStack.RVIZ,
        without("r1/robot_description", String),
        "description",
        "wrong",
    ),
    "empty description": (RosStack.RVIZ, replace(WHOLE, links=()), "description", "wrong"),
    "volatile description": (
        RosStack.RVIZ,
        with_qos("r1/robot_description", RELIABLE_5),
        "description",
        "wrong",
    ),
    "link without frame": (RosStack.RVIZ, with_messages(tf_static=()), "link frames", "wrong"),
    "no fixed frame": (
        RosStack.RVIZ,
        with_messages(tf_static=tf(("r1/base_footprint", "r1/base_link"))),
        "fixed frame",
        "note",
    ),
    "nodes out of reach": (RosStack.NAV2, replace(WHOLE, unreachable=("/far",)), "hosts", "note"),
    "mesh not here": (
        RosStack.RVIZ,
        replace(WHOLE, meshes={"package://r1/body.stl": "no such file"}),
        "meshes",
        "wrong",
    ),
}


@pytest.mark.parametrize(("stack", "topics", "what", "mark"), MISSING.values(), ids=MISSING)
def test_row_reports_a_missing_property_with_advice(
    stack: RosStack, topics: RobotTopics, what: str, mark: FindingMark
) -> None:
    found = {one.what: one for one in check_stack(topics, stack)}

    assert found[what].mark == mark
    assert found[what].advice


def test_each_row_is_tested_without_its_property() -> None:
    rows = {(stack, what) for stack in RosStack for what in marks(WHOLE, stack)}

    tested = {what for _, _, what, _ in MISSING.values()}

    assert {what for _, what in rows} == tested


def test_another_node_may_publish_the_transform_of_odometry() -> None:
    topics = replace(WHOLE, publishes_odom_tf=False)

    assert marks(topics, RosStack.NAV2)["odom tf"] == "ok"


def test_cyclic_frames_end() -> None:
    topics = with_messages(
        r1__tf_static=tf(("base_link", "lidar_link"), ("lidar_link", "base_link"))
    )

    assert marks(topics, RosStack.SLAM)["scan frame"] == "wrong"
