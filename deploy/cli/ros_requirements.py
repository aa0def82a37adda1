"""What Nav2, slam_toolbox and RViz ask of a robot: checks of what its ROS 2 topics publish.

Sources: parameters and subscriptions of navigation2, slam_toolbox, robot_localization and rviz2.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import chain
from typing import Final, TypeAlias, TypeVar

import msgspec

from zensim.deploy.cli.findings import Finding
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Clock,
    LaserScan,
    Odometry,
    String,
    TFMessage,
    TransformStamped,
    Twist,
    TwistStamped,
    ns_from_time,
)
from zensim.proto.ros2.liveliness_tokens import AnnouncedEndpoint
from zensim.proto.topic_catalog import CLOCK, CMD_VEL, ODOM, ROBOT_DESCRIPTION, TF, TF_STATIC

Message = TypeVar("Message", bound=msgspec.Struct)
PUBLISHER, SUBSCRIPTION = "MP", "MS"
BASE_FRAMES: Final = {
    "base_link": "robot_base_frame of Nav2",
    "base_footprint": "base_frame_id of AMCL, base_frame of slam_toolbox",
}
"""Frames that stacks expect below odometry, and the parameters that name another."""
POSE_DIAGONAL: Final = (0, 7, 35)
TWIST_DIAGONAL: Final = (0, 35)
"""x, y, yaw and forward velocity, yaw rate in matrices of 6 x 6."""
TF_TOLERANCE_NS: Final = NANOSECONDS // 10
"""Tolerance of Nav2's costmaps: a scan may be this much newer than the last transform."""
TF_BUFFER_NS: Final = 10 * NANOSECONDS
"""Length of the buffer of tf2: older transforms are forgotten."""
MAX_NAMES_SHOWN: Final = 5


class RosStack(str, Enum):
    """Software whose needs are checked."""

    NAV2 = "nav2"
    SLAM = "slam"
    RVIZ = "rviz"


@dataclass(frozen=True, kw_only=True)
class RobotTopics:
    """What a ROS 2 node receives of a robot."""

    namespace: str
    endpoints: tuple[AnnouncedEndpoint, ...] = ()
    """Endpoints of the topics below the namespace, and of `/clock`, `/tf` and `/tf_static`."""
    messages: Mapping[str, Sequence[msgspec.Struct]] = field(default_factory=dict)
    """Messages by topic, without the first slash; oldest first."""
    publishes_odom_tf: bool = True
    """Whether its drive publishes the transform of odometry."""
    links: tuple[str, ...] = ()
    """Links of the robot description."""
    meshes: Mapping[str, str] = field(default_factory=dict)
    """URI of each mesh of the description, and why it is not found here; empty if it is."""
    unreachable: tuple[str, ...] = ()
    """Nodes of other hosts, which ROS 2 processes of this one do not reach."""

    def find_publishers(self, kind: type[msgspec.Struct]) -> tuple[AnnouncedEndpoint, ...]:
        """Find the robot's publishers of a type, by topic."""
        found = (one for one in self._list(PUBLISHER, str(getattr(kind, "ros_type", ""))))
        return tuple(sorted(found, key=lambda one: one.key))

    def find_subscriptions(self, kind: type[msgspec.Struct]) -> tuple[AnnouncedEndpoint, ...]:
        """Find the subscriptions of a type below the namespace."""
        return tuple(self._list(SUBSCRIPTION, str(getattr(kind, "ros_type", ""))))

    def find_publisher(self, topic: str) -> AnnouncedEndpoint | None:
        """Find a publisher of a topic."""
        ends = (one for one in self.endpoints if one.kind == PUBLISHER and one.key == topic)
        return next(ends, None)

    def read(self, topic: str, kind: type[Message]) -> tuple[Message, ...]:
        """Read the messages of a topic."""
        return tuple(one for one in self.messages.get(topic, ()) if isinstance(one, kind))

    def read_transforms(self, topic: str) -> tuple[TransformStamped, ...]:
        """Read the transforms of all messages of a topic."""
        return tuple(chain.from_iterable(one.transforms for one in self.read(topic, TFMessage)))

    def at(self, suffix: str) -> str:
        """Write the topic of a name in the namespace."""
        return f"{self.namespace}/{suffix}"

    def _list(self, kind: str, ros_type: str) -> Iterator[AnnouncedEndpoint]:
        start = f"{self.namespace}/"
        for one in self.endpoints:
            if one.kind == kind and one.ros_type == ros_type and one.key.startswith(start):
                yield one


RosCheck: TypeAlias = Callable[[RobotTopics], Iterator[Finding]]


def check_stack(topics: RobotTopics, stack: RosStack) -> Iterator[Finding]:
    """Check what a stack asks of a robot; nothing more if it has no topics in ROS 2."""
    if not any(one.key.startswith(f"{topics.namespace}/") for one in topics.endpoints):
        yield make_wrong(
            "ROS 2",
            f"nothing of /{topics.namespace} is announced in this domain",
            "start an agent of the robot, with the --ros-domain of this command",
        )
        return
    for check in CHECKS[stack]:
        yield from check(topics)


def make_wrong(what: str, found: str, advice: str) -> Finding:
    """Make the finding of a missing property."""
    return Finding("wrong", what, found, advice, ExitCode.FAILED)


def check_clock(topics: RobotTopics) -> Iterator[Finding]:
    """Check that simulation time is published and advances."""
    what, times = "clock", [ns_from_time(one.clock) for one in topics.read(CLOCK.suffix, Clock)]
    if not times:
        yield make_wrong(
            what, "no message on /clock", "start the time: 'zensim play'; set use_sim_time in nodes"
        )
    elif times[-1] <= times[0]:
        yield Finding("note", what, f"/clock stands at {_seconds(times[-1])}", "'zensim play'")
    else:
        yield Finding("ok", what, f"/clock advances, at {_seconds(times[-1])}")


def check_odometry(topics: RobotTopics) -> Iterator[Finding]:
    """Check topic, frames and reliability of odometry."""
    end = _find_odometry(topics)
    if end is None:
        advice = "the drive of its description needs publish_odom, and --ros-topics needs odom"
        yield make_wrong("odometry", f"no publisher of Odometry in /{topics.namespace}", advice)
        return
    messages = topics.read(end.key, Odometry)
    if not messages:
        yield make_wrong("odometry", f"no message on /{end.key}", "'zensim play'")
        return
    last = messages[-1]
    found = f"/{end.key}, {last.header.frame_id} -> {last.child_frame_id}, {end.qos.reliability}"
    if not last.header.frame_id or not last.child_frame_id:
        yield make_wrong("odometry", found, "name odometry_frame and robot_base_frame")
    elif end.qos.reliability != "reliable":
        yield make_wrong("odometry", found, "Nav2 subscribes reliably: publish so")
    elif end.key != topics.at(ODOM.suffix):
        name = end.key.removeprefix(f"{topics.namespace}/")
        yield Finding("note", "odometry", found, f"set odom_topic: {name} in the parameters")
    else:
        yield Finding("ok", "odometry", found)


def check_covariances(topics: RobotTopics) -> Iterator[Finding]:
    """Check that variances of odometry are positive, as robot_localization asks."""
    end = _find_odometry(topics)
    messages = topics.read(end.key, Odometry) if end is not None else ()
    if not messages:
        return
    pose, twist = messages[-1].pose.covariance, messages[-1].twist.covariance
    least = min(*(pose[at] for at in POSE_DIAGONAL), *(twist[at] for at in TWIST_DIAGONAL))
    if least > 0.0:
        yield Finding("ok", "covariances", f"variances of pose and twist are at least {least:g}")
        return
    advice = "robot_localization needs positive ones: covariance_x, _y, _yaw of the drive"
    yield Finding("note", "covariances", f"a variance of odometry is {least:g}", advice)


def check_odometry_transform(topics: RobotTopics) -> Iterator[Finding]:
    """Check the transform of odometry, and which node should publish it."""
    what, edge = "odom tf", _find_odometry_edge(topics)
    is_there = edge is not None and bool(_list_odometry_stamps(topics))
    parent, child = edge or ("odom", "base_link")
    named = f"{parent} -> {child}"
    if is_there and topics.publishes_odom_tf:
        advice = "for robot_localization, which publishes it, too, set publish_odom_tf to false"
        yield Finding("ok", what, f"{named} on /{topics.at(TF.suffix)}", advice)
    elif is_there:
        found = f"{named} on /{topics.at(TF.suffix)} is of another node than the drive"
        yield Finding("ok", what, found)
    elif topics.publishes_odom_tf:
        advice = "start agents with --tf both, and with tf in --ros-topics"
        yield make_wrong(what, f"no {named} on /{topics.at(TF.suffix)}", advice)
    else:
        advice = "start a node that publishes it, such as robot_localization, or set it to true"
        yield make_wrong(what, f"no {named}; publish_odom_tf is false", advice)


def check_base_frames(topics: RobotTopics) -> Iterator[Finding]:
    """Check that the frames that stacks expect as base are below odometry."""
    parents = _index_parents(topics, TF_STATIC.suffix, TF.suffix)
    edge = _find_odometry_edge(topics)
    if edge is None:
        return
    missing = [name for name in BASE_FRAMES if edge[0] not in _list_ancestors(name, parents)]
    if len(missing) == len(BASE_FRAMES) and edge[1] not in parents:
        advice = "publish the transform of odometry"
        yield make_wrong("base frame", f"no frame is below {edge[0]}", advice)
    elif missing:
        found = f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} not in tf"
        advice = "; ".join(f"set {BASE_FRAMES[name]} to {edge[1]}" for name in missing)
        yield Finding("note", "base frame", found, advice)
    else:
        yield Finding("ok", "base frame", f"{' and '.join(BASE_FRAMES)} are below {edge[0]}")


def check_scan(topics: RobotTopics) -> Iterator[Finding]:
    """Check that there are scans, and that every subscriber gets them."""
    ends = topics.find_publishers(LaserScan)
    if not ends:
        advice = "give it a lidar that publishes LaserScan, and run 'zensim sensors run'"
        yield make_wrong("scan", f"no publisher of LaserScan in /{topics.namespace}", advice)
    for end in ends:
        scans = topics.read(end.key, LaserScan)
        if not scans:
            advice = "'zensim play', and 'zensim sensors list' for its sensor process"
            yield make_wrong("scan", f"no message on /{end.key}", advice)
            continue
        found = f"/{end.key}, {len(scans[-1].ranges)} ranges, {end.qos.reliability}"
        if end.qos.reliability == "reliable":
            yield Finding("ok", "scan", found)
        else:
            yield Finding("note", "scan", found, "subscribe with best effort, in RViz, too")


def check_scan_if_any(topics: RobotTopics) -> Iterator[Finding]:
    """Check scans of a robot that may have none."""
    if topics.find_publishers(LaserScan):
        yield from check_scan(topics)
        return
    advice = "without one, costmaps have the map and the inflation layer only, and AMCL cannot run"
    yield Finding("note", "scan", f"no publisher of LaserScan in /{topics.namespace}", advice)


def check_scan_angles(topics: RobotTopics) -> Iterator[Finding]:
    """Check that angle_min + (n - 1) angle_increment is angle_max, within half an increment."""
    for key, scan in _list_last_scans(topics):
        last = scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment
        found = (
            f"/{key}: {len(scan.ranges)} ranges end at {last:.4f} rad, angle_max is "
            f"{scan.angle_max:.4f}"
        )
        if abs(last - scan.angle_max) <= abs(scan.angle_increment) / 2.0 and scan.ranges:
            yield Finding("ok", "scan angles", found)
        else:
            advice = "slam_toolbox drops such scans: correct samples or angles of the lidar"
            yield make_wrong("scan angles", found, advice)


def check_scan_frame(topics: RobotTopics) -> Iterator[Finding]:
    """Check that the frames of scans are joined to the base by fixed transforms."""
    fixed = _index_parents(topics, TF_STATIC.suffix)
    edge = _find_odometry_edge(topics)
    for key, scan in _list_last_scans(topics):
        frame, base = scan.header.frame_id, edge[1] if edge is not None else ""
        if frame == base or base in _list_ancestors(frame, fixed):
            yield Finding("ok", "scan frame", f"{frame} of /{key} is fixed to {base}")
        elif base in _list_ancestors(frame, _index_parents(topics, TF_STATIC.suffix, TF.suffix)):
            advice = "stacks that ask once for the pose of the lidar need a fixed joint"
            found = f"{frame} of /{key} moves relative to {base}"
            yield Finding("note", "scan frame", found, advice)
        else:
            advice = f"name a link as frame of the sensor, joined to {base or 'the base'}"
            found = f"{frame or 'no frame'} of /{key} is not below {base or 'a base'} in tf"
            yield make_wrong("scan frame", found, advice)


def check_scan_stamps(topics: RobotTopics) -> Iterator[Finding]:
    """Check that odometry's transform is known at the stamps of scans."""
    stamps = _list_odometry_stamps(topics)
    for end in topics.find_publishers(LaserScan):
        scans = [ns_from_time(one.header.stamp) for one in topics.read(end.key, LaserScan)]
        if not stamps or not scans:
            continue
        # Scans of before the first transform that this command received may have had theirs.
        late = [one for one in scans if one > stamps[-1] + TF_TOLERANCE_NS]
        old = [one for one in scans if one < stamps[-1] - TF_BUFFER_NS]
        if late or old:
            found = f"{len(late) + len(old)} of {len(scans)} scans of /{end.key} have no transform"
            advice = "publish scans and tf with the same time: set use_sim_time in all nodes"
            yield make_wrong("scan stamps", found, advice)
        else:
            found = f"tf has the pose of each of {len(scans)} scans of /{end.key}"
            yield Finding("ok", "scan stamps", found)


def check_commands(topics: RobotTopics) -> Iterator[Finding]:
    """Check which types of velocity commands the robot subscribes to."""
    what = "cmd_vel"
    kinds = {
        kind.__name__: topics.find_subscriptions(kind)
        for kind in (Twist, TwistStamped)
        if topics.find_subscriptions(kind)
    }
    keys = {one.key for ends in kinds.values() for one in ends}
    found = f"{' and '.join(kinds)} on {', '.join(f'/{key}' for key in sorted(keys))}"
    if not kinds:
        advice = "start an agent of the robot, with cmd_vel in --ros-topics"
        yield make_wrong(what, f"nothing subscribes to a Twist in /{topics.namespace}", advice)
    elif topics.at(CMD_VEL.suffix) not in keys:
        yield Finding("note", what, found, "remap cmd_vel of the stack to it")
    elif len(kinds) == 1:
        is_stamped = str("TwistStamped" in kinds).lower()
        yield Finding("note", what, found, f"set enable_stamped_cmd_vel: {is_stamped}")
    else:
        yield Finding("ok", what, found)


def check_description(topics: RobotTopics) -> Iterator[Finding]:
    """Check that a late subscriber gets the description."""
    what, key = "description", topics.at(ROBOT_DESCRIPTION.suffix)
    end, texts = topics.find_publisher(key), topics.read(key, String)
    if end is None or not texts or not topics.links:
        advice = "spawn it from a URDF, with robot_description in --ros-topics"
        yield make_wrong(what, f"no robot description on /{key}", advice)
        return
    found = f"/{key}, {len(topics.links)} links, {end.qos.durability}"
    if end.qos.durability == "transient_local":
        advice = f"RobotModel: topic /{key}, Transient Local, TF prefix {topics.namespace}"
        yield Finding("ok", what, found, advice)
    else:
        yield make_wrong(what, found, "publish it as transient_local, so that RViz gets it late")


def check_link_frames(topics: RobotTopics) -> Iterator[Finding]:
    """Check that each link of the description is in the shared tree, with the prefix."""
    parents = _index_edges(_list_shared_edges(topics))
    known = {*parents, *parents.values()}
    missing = [name for name in topics.links if f"{topics.namespace}/{name}" not in known]
    if not topics.links:
        return
    if not missing:
        found = f"all {len(topics.links)} links are in /tf and /tf_static"
        yield Finding("ok", "link frames", f"{found} with prefix {topics.namespace}/")
        return
    named = ", ".join(missing[:MAX_NAMES_SHOWN])
    found = f"{len(missing)} of {len(topics.links)} links are not in /tf: {named}"
    advice = "start agents with --tf both, and publish joint states of all moving joints"
    yield make_wrong("link frames", found, advice)


def check_root_frame(topics: RobotTopics) -> Iterator[Finding]:
    """Check that one fixed frame holds the tree of the robot."""
    prefix = f"{topics.namespace}/"
    parents = _index_edges(_list_shared_edges(topics))
    roots = {
        parent
        for child, parent in parents.items()
        if child.startswith(prefix) and not parent.startswith(prefix)
    }
    if len(roots) == 1:
        yield Finding("ok", "fixed frame", f"{min(roots)} is the parent of the robot's frames")
        return
    found = f"{len(roots) or 'no'} frames outside of {prefix} are parents of the robot's"
    yield Finding("note", "fixed frame", found, "start agents with --tf-root world, or a localiser")


def check_meshes(topics: RobotTopics) -> Iterator[Finding]:
    """Check that the meshes of the description are found on this host."""
    missing = {uri: reason for uri, reason in topics.meshes.items() if reason}
    if not missing:
        yield Finding("ok", "meshes", f"all {len(topics.meshes)} meshes are found on this host")
        return
    uri, reason = next(iter(missing.items()))
    found = f"{len(missing)} of {len(topics.meshes)} meshes are not found on this host: {uri}"
    advice = (
        f"{reason}; RViz reads them from its own host: source the workspace of their package, or "
        "start the server with --mesh-http HOST:PORT"
    )
    yield make_wrong("meshes", found, advice)


def check_hosts(topics: RobotTopics) -> Iterator[Finding]:
    """Check that the ROS 2 processes of this host reach those of all others."""
    if not topics.unreachable:
        yield Finding("ok", "hosts", "ROS 2 processes of this host reach all nodes")
        return
    count, named = len(topics.unreachable), ", ".join(topics.unreachable[:MAX_NAMES_SHOWN])
    found = f"{count} nodes of other hosts are reached by zensim, not by peers here: {named}"
    advice = "if ROS 2 runs here, too: ZENOH_CONFIG_OVERRIDE='mode=\"client\"' on each host"
    yield Finding("note", "hosts", found, f"{advice}, or an rmw_zenohd on each")


CHECKS: Final[dict[RosStack, tuple[RosCheck, ...]]] = {
    RosStack.NAV2: (
        check_clock,
        check_odometry,
        check_covariances,
        check_odometry_transform,
        check_base_frames,
        check_scan_if_any,
        check_scan_frame,
        check_scan_stamps,
        check_commands,
        check_hosts,
    ),
    RosStack.SLAM: (
        check_clock,
        check_odometry_transform,
        check_base_frames,
        check_scan,
        check_scan_angles,
        check_scan_frame,
        check_scan_stamps,
        check_hosts,
    ),
    RosStack.RVIZ: (
        check_clock,
        check_description,
        check_link_frames,
        check_root_frame,
        check_meshes,
        check_hosts,
    ),
}
"""What each stack asks, in the order of the table."""


def _find_odometry(topics: RobotTopics) -> AnnouncedEndpoint | None:
    ends = topics.find_publishers(Odometry)
    wanted = topics.at(ODOM.suffix)
    return next((one for one in ends if one.key == wanted), ends[0] if ends else None)


def _find_odometry_edge(topics: RobotTopics) -> tuple[str, str] | None:
    """Find the parent and child frame of odometry, as its messages name them."""
    end = _find_odometry(topics)
    messages = topics.read(end.key, Odometry) if end is not None else ()
    return (messages[-1].header.frame_id, messages[-1].child_frame_id) if messages else None


def _list_odometry_stamps(topics: RobotTopics) -> list[int]:
    """List the stamps of the transform of odometry [ns], in order."""
    edge = _find_odometry_edge(topics)
    return sorted(
        ns_from_time(one.header.stamp)
        for one in topics.read_transforms(topics.at(TF.suffix))
        if (one.header.frame_id, one.child_frame_id) == edge
    )


def _list_last_scans(topics: RobotTopics) -> Iterator[tuple[str, LaserScan]]:
    for end in topics.find_publishers(LaserScan):
        for scan in topics.read(end.key, LaserScan)[-1:]:
            yield end.key, scan


def _list_shared_edges(topics: RobotTopics) -> tuple[TransformStamped, ...]:
    return topics.read_transforms(TF_STATIC.suffix) + topics.read_transforms(TF.suffix)


def _index_parents(topics: RobotTopics, *suffixes: str) -> dict[str, str]:
    """Index the parents of the frames in the namespace."""
    edges = chain.from_iterable(topics.read_transforms(topics.at(one)) for one in suffixes)
    return _index_edges(edges)


def _index_edges(edges: Iterable[TransformStamped]) -> dict[str, str]:
    return {one.child_frame_id: one.header.frame_id for one in edges}


def _list_ancestors(frame: str, parents: Mapping[str, str]) -> tuple[str, ...]:
    """List the frames above a frame, the nearest first; a cycle ends the list."""
    found: list[str] = []
    while (frame := parents.get(frame, "")) and frame not in found:
        found.append(frame)
    return tuple(found)


def _seconds(time_ns: int) -> str:
    return f"{time_ns / NANOSECONDS:.2f} s"
