"""A ROS 2 node for which simulation time waits: it answers each scan of a robot with a command.

Run it beside a paused world, and play when it says that it is ready:

    zensim up --paused --world warehouse --model lidar_bot
    python lockstep_node.py box_bot0
    ros2 service call /unpause_physics std_srvs/srv/Empty
"""

import sys

import rclpy
from geometry_msgs.msg import Twist
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan


class LockstepNode(Node):
    """Drives a robot towards the side that has more room."""

    def __init__(self, robot: str) -> None:
        super().__init__("lockstep_node", namespace=robot)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)
        self.subscription = self.create_subscription(
            LaserScan, "scan", self.answer, qos_profile_sensor_data
        )

    def ask(self) -> str:
        """Ask time to wait for this node; return why that is refused."""
        client = self.create_client(SetParameters, "/zensim/set_parameters")
        client.wait_for_service()
        while not self.count_publishers(self.subscription.topic_name):
            rclpy.spin_once(self, timeout_sec=0.1)
        value = ParameterValue(
            type=ParameterType.PARAMETER_STRING, string_value=self.subscription.topic_name
        )
        name = f"lockstep.{self.publisher.topic_name}"
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self, future)
        return future.result().results[0].reason

    def answer(self, scan: LaserScan) -> None:
        """Publish one command for each scan, however long it takes to find it."""
        middle = len(scan.ranges) // 2
        right, left = (
            sum(min(one, scan.range_max) for one in side)
            for side in (scan.ranges[:middle], scan.ranges[middle:])
        )
        command = Twist()
        command.linear.x = 0.3
        command.angular.z = max(-1.0, min(1.0, (left - right) / 200.0))
        self.publisher.publish(command)


def main() -> None:
    """Run a node for each robot that is named."""
    rclpy.init()
    nodes = [LockstepNode(robot) for robot in sys.argv[1:]]
    executor = rclpy.executors.SingleThreadedExecutor()
    for node in nodes:
        if reason := node.ask():
            sys.exit(reason)
    for node in nodes:
        executor.add_node(node)
    print("ready", flush=True)
    executor.spin()


if __name__ == "__main__":
    main()
