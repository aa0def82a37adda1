"""Start slam_toolbox and Nav2 for robots of zensim, each in its namespace.

Run by `ros2 launch examples/nav2/robots.launch.py robots:=10`; needs ROS 2, nav2_bringup and
slam_toolbox, and a simulator as README.md says.
"""

import os
import tempfile
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

FOLDER = Path(__file__).parent
NODES = {
    "controller_server": "nav2_controller",
    "smoother_server": "nav2_smoother",
    "planner_server": "nav2_planner",
    "behavior_server": "nav2_behaviors",
    "bt_navigator": "nav2_bt_navigator",
}
"""Nodes of Nav2 by package; `controller_server` and `planner_server` contain the costmaps."""
WITH_SLASHES = ("humble", "iron")
"""Distributions with a slash in names of plug-ins, and a slam_toolbox without states."""
TF = [("/tf", "tf"), ("/tf_static", "tf_static")]
"""The transforms of one robot, with the frames of its description."""


def write_parameters(robot: str, distribution: str) -> str:
    """Write the parameters of a robot to a file of its own, and return its path."""
    text = (FOLDER / "params.yaml").read_text()
    text = text.replace("ROBOT", robot)
    text = text.replace("SEP", "/" if distribution in WITH_SLASHES else "::")
    path = Path(tempfile.mkdtemp(prefix="zensim_nav2_")) / f"{robot}.yaml"
    path.write_text(text)
    return str(path)


def make_manager(robot: str, name: str, nodes: list[str], bond_timeout_s: float) -> Node:
    """Make the node that configures and activates others."""
    return Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name=name,
        namespace=robot,
        output="screen",
        parameters=[
            {
                "use_sim_time": True,
                "autostart": True,
                "node_names": nodes,
                "bond_timeout": bond_timeout_s,
            }
        ],
    )


def make_robot(robot: str, distribution: str) -> list[Node]:
    """Make the nodes of one robot."""
    parameters = [write_parameters(robot, distribution)]
    nodes = [
        Node(
            package=package,
            executable=name,
            name=name,
            namespace=robot,
            output="screen",
            parameters=parameters,
            remappings=TF,
        )
        for name, package in NODES.items()
    ]
    nodes.append(
        Node(
            package="slam_toolbox",
            executable="async_slam_toolbox_node",
            name="slam_toolbox",
            namespace=robot,
            output="screen",
            parameters=parameters,
            remappings=TF,
        )
    )
    nodes.append(make_manager(robot, "lifecycle_manager_navigation", list(NODES), 10.0))
    if distribution not in WITH_SLASHES:
        # It has no bond, so 0 turns the check of bonds off.
        nodes.append(make_manager(robot, "lifecycle_manager_slam", ["slam_toolbox"], 0.0))
    return nodes


def make_robots(context: object) -> list[Node]:
    """Make the nodes of all robots, as the arguments of the launch say."""
    prefix = LaunchConfiguration("prefix").perform(context)
    count = int(LaunchConfiguration("robots").perform(context))
    distribution = os.environ.get("ROS_DISTRO", "jazzy")
    return [
        node for number in range(count) for node in make_robot(f"{prefix}{number}", distribution)
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch to `ros2 launch`."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("robots", default_value="10", description="Number of robots."),
            DeclareLaunchArgument(
                "prefix", default_value="robot", description="Namespaces without their numbers."
            ),
            OpaqueFunction(function=make_robots),
        ]
    )
