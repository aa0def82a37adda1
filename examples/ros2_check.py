"""What examples/ros2_check.sh asks of rclpy; each check prints what it found, or why it failed.

ros2_check.py frames              a late listener finds all frames under the frame `world`
ros2_check.py square ROBOT        drives a closed square by its odometry, in simulation time
ros2_check.py clients SERVICE N   creates a client of ListParameters, calls, destroys it: N times
ros2_check.py spawn N             spawns N robots as a launch script does, and deletes them
ros2_check.py resume ROBOT        receives odometry again after the simulator was restarted
"""

import math
import sys
import time
from collections.abc import Callable

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import ListParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None
try:
    from simulation_interfaces.srv import DeleteEntity, SpawnEntity
except ImportError:
    SpawnEntity = DeleteEntity = None

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WORLD = "world"
WITHIN_S, REPLY_S, RESTART_S = 20.0, 5.0, 60.0
SIDE_M, SPEED_M_S, TURN_RAD_S, SIDE_S = 0.4, 0.4, 1.0, 15.0
NEAR_M, NEAR_RAD, CLOSED_M = 0.02, 0.05, 0.1
SILENT_S = 1.0
RESULT_OK = 1


class CheckFailed(Exception):
    """Something is not as a ROS 2 user expects it."""


def make_node() -> Node:
    """Make a node in simulation time."""
    simulated = Parameter("use_sim_time", Parameter.Type.BOOL, value=True)
    return Node("ros2_check", parameter_overrides=[simulated])


def wait_for(
    node: Node, what: str, is_so: Callable[[], object], within_s: float = WITHIN_S
) -> float:
    """Spin until something is so; return the time that it took [s]."""
    began_s = time.monotonic()
    while not is_so():
        if time.monotonic() - began_s > within_s:
            raise CheckFailed(f"no {what} within {within_s:g} s")
        rclpy.spin_once(node, timeout_sec=0.02)
    return time.monotonic() - began_s


def list_robots(node: Node) -> list[str]:
    """List the namespaces of robots that publish odometry."""
    topics = (name for name, _ in node.get_topic_names_and_types())
    return sorted(name[1 : -len("/odom")] for name in topics if name.endswith("/odom"))


class Frames:
    """The parents of frames, as a listener of tf2 keeps them."""

    def __init__(self, node: Node) -> None:
        self.parents = {}
        node.create_subscription(TFMessage, "/tf_static", self.receive, LATCHED)
        node.create_subscription(TFMessage, "/tf", self.receive, 100)

    def receive(self, message: object) -> None:
        """Note the parents of frames."""
        for one in message.transforms:
            self.parents[one.child_frame_id] = one.header.frame_id

    def list_lost(self) -> list[str]:
        """List the frames that have no way to the frame of the world."""
        return [frame for frame in self.parents if self.find_root(frame) != WORLD]

    def find_root(self, frame: str) -> str:
        """Follow parents to their end."""
        for _ in self.parents:
            frame = self.parents.get(frame, frame)
        return frame


def check_frames(node: Node) -> str:
    """Listen to tf late, until every frame of every robot is there."""
    frames = Frames(node)
    wait_for(node, "robot", lambda: list_robots(node))
    is_complete = lambda: (  # noqa: E731
        all(f"{robot}/odom" in frames.parents.values() for robot in list_robots(node))
        and not frames.list_lost()
    )
    try:
        seconds = wait_for(node, "way from all frames to world", is_complete)
    except CheckFailed as failed:
        raise CheckFailed(f"{failed}: {', '.join(frames.list_lost()[:5])}") from failed
    robots = len(list_robots(node))
    return f"{len(frames.parents)} frames of {robots} robots under {WORLD} after {seconds:.2f} s"


class Driver:
    """A robot that is commanded at the rate of its odometry."""

    def __init__(self, node: Node, robot: str) -> None:
        self.node, self.pose, self.stamps = node, None, 0
        self.publisher = node.create_publisher(Twist, f"/{robot}/cmd_vel", 10)
        node.create_subscription(Odometry, f"/{robot}/odom", self.receive, qos_profile_sensor_data)

    def receive(self, odom: Odometry) -> None:
        """Keep place and heading."""
        place, turn = odom.pose.pose.position, odom.pose.pose.orientation
        self.pose = (place.x, place.y, 2.0 * math.atan2(turn.z, turn.w))
        self.stamps += 1

    def command(self, forward: float, turn: float) -> None:
        """Send a command and wait for the next odometry."""
        twist = Twist()
        twist.linear.x, twist.angular.z = forward, turn
        self.publisher.publish(twist)
        before = self.stamps
        wait_for(self.node, "odometry", lambda: self.stamps > before)

    def drive_to(self, x: float, y: float) -> None:
        """Turn towards a point, then drive to it."""
        is_facing, began_s = False, time.monotonic()
        while time.monotonic() - began_s < SIDE_S:
            far_m = math.dist(self.pose[:2], (x, y))
            off = math.remainder(
                math.atan2(y - self.pose[1], x - self.pose[0]) - self.pose[2], math.tau
            )
            if far_m < NEAR_M or (is_facing and abs(off) > math.pi / 2):
                return self.command(0.0, 0.0)
            is_facing = is_facing or abs(off) < NEAR_RAD
            turn = max(-TURN_RAD_S, min(TURN_RAD_S, 2.0 * off))
            self.command(min(SPEED_M_S, 1.5 * far_m) if is_facing else 0.0, turn)
        raise CheckFailed(f"a corner was not reached in {SIDE_S:g} s")


def check_square(node: Node, robot: str) -> str:
    """Drive a square; the robot has to come back to where it began."""
    driver = Driver(node, robot)
    wait_for(node, f"odometry of {robot}", lambda: driver.pose)
    wait_for(node, f"subscriber of /{robot}/cmd_vel", driver.publisher.get_subscription_count)
    x, y, heading = driver.pose
    began_ns, corner = node.get_clock().now().nanoseconds, (x, y)
    for side in range(4):
        way = heading + side * math.pi / 2
        corner = (corner[0] + SIDE_M * math.cos(way), corner[1] + SIDE_M * math.sin(way))
        driver.drive_to(*corner)
        if side == 1 and math.dist(driver.pose[:2], (x, y)) < SIDE_M:
            raise CheckFailed("the robot did not reach the far corner")
    off_m = math.dist(driver.pose[:2], (x, y))
    if off_m > CLOSED_M:
        raise CheckFailed(f"the square ends {off_m:.3f} m from its begin")
    seconds = (node.get_clock().now().nanoseconds - began_ns) * 1e-9
    return f"square of {4 * SIDE_M:g} m closed to {off_m:.3f} m in {seconds:.1f} s of /clock"


def call(node: Node, client: object, request: object) -> object:
    """Call a service; return its reply."""
    future = client.call_async(request)
    wait_for(node, f"reply of {client.srv_name}", future.done, REPLY_S)
    return future.result()


def check_clients(node: Node, service: str, count: str) -> str:
    """Create, call and destroy clients in turn; the last line has the number of replies."""
    for answered in range(int(count)):
        client = node.create_client(ListParameters, service)
        if not client.wait_for_service(timeout_sec=REPLY_S):
            raise CheckFailed(f"{service} is gone after {answered} calls")
        call(node, client, ListParameters.Request())
        # The process may hang from here on.
        print(f"{answered + 1} calls had a reply", flush=True)
        node.destroy_client(client)
    return f"all {count} calls of clients in turn had a reply"


def make_spawn_request(name: str, number: int) -> object:
    """Make a request of version 1 or 2 of the interfaces."""
    request = SpawnEntity.Request(name=name, entity_namespace=name)
    getattr(request, "entity_resource", request).uri = "box_bot"
    place = request.initial_pose.pose.position
    place.x, place.y = float(number), 50.0
    return request


def call_entity(node: Node, client: object, request: object) -> None:
    """Call a service of entities, which has to succeed."""
    result = call(node, client, request).result
    if result.result != RESULT_OK:
        raise CheckFailed(f"{client.srv_name}: {result.error_message or result.result}")


def check_spawn(node: Node, count: str) -> str:
    """Spawn robots, wait for odometry of each, and delete them."""
    spawn = node.create_client(SpawnEntity, "/spawn_entity")
    delete = node.create_client(DeleteEntity, "/delete_entity")
    for client in (spawn, delete):
        if not client.wait_for_service(timeout_sec=WITHIN_S):
            raise CheckFailed(f"no service {client.srv_name}")
    names = [f"check_bot{number}" for number in range(int(count))]
    received, times_ms = set(), []
    for number, name in enumerate(names):
        node.create_subscription(
            Odometry,
            f"/{name}/odom",
            lambda _, name=name: received.add(name),
            qos_profile_sensor_data,
        )
        began_s = time.monotonic()
        call_entity(node, spawn, make_spawn_request(name, number))
        times_ms.append((time.monotonic() - began_s) * 1e3)
    seconds = wait_for(node, "odometry of all of them", lambda: len(received) == len(names))
    for name in names:
        call_entity(node, delete, DeleteEntity.Request(entity=name))
    return (
        f"{count} robots spawned, slowest reply {max(times_ms):.0f} ms, all driven {seconds:.1f} s"
        " later, and deleted"
    )


def check_resume(node: Node, robot: str) -> str:
    """Receive odometry until it ends, and then again, with the same subscriptions."""
    driver, found = Driver(node, robot), []
    topic = f"/{robot}/robot_description"
    node.create_subscription(String, topic, lambda message: found.append(message.data), LATCHED)
    wait_for(node, f"odometry and description of {robot}", lambda: driver.pose and found)
    found.clear()
    print("ready", flush=True)
    last = [driver.stamps, time.monotonic()]

    def is_silent() -> bool:
        if driver.stamps != last[0]:
            last[:] = [driver.stamps, time.monotonic()]
        return time.monotonic() - last[1] > SILENT_S

    wait_for(node, "end of the simulator", is_silent, RESTART_S)
    began = driver.stamps
    seconds = wait_for(
        node,
        "odometry and description after it",
        lambda: driver.stamps > began and found,
        RESTART_S,
    )
    return f"heard again {SILENT_S + seconds:.1f} s after the simulator ended"


CHECKS = {
    "frames": check_frames,
    "square": check_square,
    "clients": check_clients,
    "spawn": check_spawn,
    "resume": check_resume,
}


def main() -> int:
    """Run one check; return the exit status."""
    what, *given = remove_ros_args(sys.argv)[1:]
    rclpy.init()
    node = make_node()
    try:
        print(CHECKS[what](node, *given), flush=True)
    except CheckFailed as failed:
        print(failed, flush=True)
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
