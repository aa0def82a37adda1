"""A process of ROS 2: rclpy over DDS. It prints objects in JSON, and imports nothing of zensim.

rclpy_peer.py listen SECONDS ROBOT ...    what arrives, with which QoS
rclpy_peer.py drive SECONDS ROBOT ...     the way of robots that are commanded 0.2 m/s
rclpy_peer.py drive_stamped SECONDS ROBOT ...
rclpy_peer.py hold 0 ROBOT ...            commands until it is killed
rclpy_peer.py answer DELAY ROBOT ...      one command for each scan, until it is ended
"""

import json
import math
import sys
import time
from collections.abc import Callable

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SPEED_M_S, PERIOD_S = 0.2, 0.05
DISCOVERY_S = 30.0


def make_node() -> Node:
    """Make a node in simulation time."""
    simulated = Parameter("use_sim_time", Parameter.Type.BOOL, value=True)
    return Node("peer", parameter_overrides=[simulated])


def seconds_of(stamp: object) -> float:
    """Convert a stamp."""
    return stamp.sec + stamp.nanosec * 1e-9


def spin_until(node: Node, is_done: Callable[[], bool], within_s: float) -> None:
    """Spin until something is so, or for a time."""
    end_s = time.monotonic() + within_s
    while not is_done() and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.02)


class Listener:
    """Counts of what arrives, by topic."""

    def __init__(self, node: Node, robots: list[str]) -> None:
        self.counts, self.disorder, self.last = {}, 0, {}
        self.ahead_s = []
        """Clock of the node less the stamp of an odometry."""
        self.node = node
        for robot in robots:
            self.count(Odometry, f"/{robot}/odom", 100)
            self.count(LaserScan, f"/{robot}/scan", qos_profile_sensor_data)
            self.count(String, f"/{robot}/robot_description", LATCHED)
        self.count(Clock, "/clock", 100)
        self.count(OccupancyGrid, "/map", LATCHED)

    def count(self, kind: type, topic: str, qos: object) -> None:
        """Count the messages of a topic."""
        self.counts[topic] = 0

        def receive(message: object) -> None:
            self.counts[topic] += 1
            if hasattr(message, "header") and not topic.endswith("map"):
                self.follow(topic, seconds_of(message.header.stamp))

        self.node.create_subscription(kind, topic, receive, qos)

    def follow(self, topic: str, stamp_s: float) -> None:
        """Compare a stamp with the last one, and with the clock."""
        self.disorder += stamp_s < self.last.get(topic, 0.0)
        self.last[topic] = stamp_s
        if topic.endswith("odom"):
            self.ahead_s.append(self.node.get_clock().now().nanoseconds * 1e-9 - stamp_s)


def describe_publishers(node: Node, topic: str) -> list[list[str]]:
    """List reliability, durability and type of the publishers of a topic."""
    return [
        [one.qos_profile.reliability.name, one.qos_profile.durability.name, one.topic_type]
        for one in node.get_publishers_info_by_topic(topic)
    ]


def listen(seconds: float, robots: list[str]) -> dict:
    """Listen for a time, as a node that comes late."""
    node = make_node()
    found = Listener(node, robots)
    spin_until(node, lambda: all(found.counts.values()), DISCOVERY_S)
    first = dict(found.counts)
    odoms = sum(count for topic, count in found.counts.items() if topic.endswith("odom"))
    began_s = time.monotonic()
    spin_until(node, lambda: False, seconds)
    late = sum(count for topic, count in found.counts.items() if topic.endswith("odom")) - odoms
    first_robot = robots[0]
    topics = ("odom", "scan", "tf_static", "robot_description")
    return {
        "silent": [topic for topic, count in first.items() if not count],
        "odom_hz": late / (time.monotonic() - began_s) / len(robots),
        "disorder": found.disorder,
        "clock_off_s": max(map(abs, found.ahead_s[-100:]), default=math.inf),
        "topics": dict(node.get_topic_names_and_types()),
        "services": dict(node.get_service_names_and_types()),
        "qos": {name: describe_publishers(node, f"/{first_robot}/{name}") for name in topics}
        | {"map": describe_publishers(node, "/map")},
    }


class Driver:
    """A robot that is commanded, and its place."""

    def __init__(self, node: Node, robot: str, kind: type) -> None:
        self.place, self.stamp_s = None, 0.0
        self.publisher = node.create_publisher(kind, f"/{robot}/cmd_vel", 10)
        node.create_subscription(Odometry, f"/{robot}/odom", self.receive, 10)
        self.command = kind()
        twist = self.command if kind is Twist else self.command.twist
        twist.linear.x = SPEED_M_S

    def receive(self, odom: Odometry) -> None:
        """Keep place and stamp."""
        position = odom.pose.pose.position
        self.place, self.stamp_s = (position.x, position.y), seconds_of(odom.header.stamp)


def drive(seconds: float, robots: list[str], kind: type) -> dict:
    """Drive for a simulation time; 0 = until killed."""
    node = make_node()
    drivers = [Driver(node, robot, kind) for robot in robots]
    is_ready = lambda: all(one.place and one.publisher.get_subscription_count() for one in drivers)  # noqa: E731
    spin_until(node, is_ready, DISCOVERY_S)
    if not is_ready():
        return {
            "ways_m": [],
            "seconds": [],
            "unmatched": [r for r, one in zip(robots, drivers, strict=True) if not one.place],
        }
    begin = [(one.place, one.stamp_s) for one in drivers]
    if not seconds:
        say(ready=True)
    while not seconds or drivers[0].stamp_s - begin[0][1] < seconds:
        for one in drivers:
            one.publisher.publish(one.command)
        spin_until(node, lambda: False, PERIOD_S)
    return {
        "ways_m": [
            math.dist(one.place, start) for one, (start, _) in zip(drivers, begin, strict=True)
        ],
        "seconds": [one.stamp_s - start for one, (_, start) in zip(drivers, begin, strict=True)],
    }


def answer(delay_s: float, robots: list[str]) -> None:
    """Answer each scan of each robot with a command."""
    node = make_node()
    publishers = {robot: node.create_publisher(Twist, f"/{robot}/cmd_vel", 10) for robot in robots}

    def steer(robot: str, scan: LaserScan) -> None:
        time.sleep(delay_s)
        middle, command = len(scan.ranges) // 2, Twist()
        right, left = (
            sum(min(one, 8.0) for one in side)
            for side in (scan.ranges[:middle], scan.ranges[middle:])
        )
        command.linear.x, command.angular.z = 0.3, max(-1.0, min(1.0, (left - right) / 200.0))
        publishers[robot].publish(command)

    for robot in robots:
        topic = f"/{robot}/scan"
        node.create_subscription(LaserScan, topic, lambda scan, robot=robot: steer(robot, scan), 10)
    counts = lambda: [  # noqa: E731
        node.count_publishers(f"/{robot}/scan") and publishers[robot].get_subscription_count()
        for robot in robots
    ]
    spin_until(node, lambda: all(counts()), DISCOVERY_S)
    say(ready=all(counts()))
    rclpy.spin(node)


def say(**what: object) -> None:
    """Print an object."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Run what the first argument names."""
    what, seconds, *robots = sys.argv[1:]
    rclpy.init()
    if what == "answer":
        answer(float(seconds), robots)
    elif what == "listen":
        say(**listen(float(seconds), robots))
    else:
        kind = TwistStamped if what == "drive_stamped" else Twist
        say(**drive(float(seconds), robots, kind))


if __name__ == "__main__":
    main()
