"""Settings of the ROS 2 endpoints of programs, as users write them."""

from typing import Annotated, Final, Literal

import msgspec

from zensim.proto.settings.setting import Setting

TfScope = Literal["global", "namespaced", "both"]
"""Transforms on `/tf`, with the namespace before their frames, or on `/ns/tf`."""
Distribution = Literal["humble", "iron", "jazzy", "kilted", "lyrical", "rolling"]
BridgedCommand = Literal["twist", "twist_stamped"]


class RosChoice(msgspec.Struct, frozen=True, kw_only=True):
    """ROS 2 of a program that does not publish tf."""

    ros_domain: Annotated[
        str,
        Setting(
            help="ROS 2 domain ID, 0 to 232; off = no ROS 2 topics and services.",
            panel="ROS 2",
            metavar="ID|off",
            variables=("ZENSIM_ROS_DOMAIN", "ROS_DOMAIN_ID"),
            key="ros.domain",
        ),
    ] = "0"
    ros_distro: Annotated[
        Distribution,
        Setting(
            help="ROS 2 distribution of the other nodes; only humble uses different keys.",
            panel="ROS 2",
            metavar="NAME",
            key="ros.distro",
        ),
    ] = "jazzy"
    ros_bridge: Annotated[
        bool,
        Setting(help="Also announce to zenoh-bridge-ros2dds.", panel="ROS 2", key="ros.bridge"),
    ] = False
    ros_topics: Annotated[
        str,
        Setting(
            help="Topics of robots in ROS 2, separated by commas, such as odom,tf,scan,cmd_vel; "
            "'parameters' stands for the parameter services. Others stay on their Zenoh keys.",
            panel="ROS 2",
            metavar="NAMES",
            usual="all",
            key="ros.topics",
        ),
    ] = ""


class TfChoice(msgspec.Struct, frozen=True, kw_only=True):
    """ROS 2 of a program that drives robots, and so publishes tf."""

    tf: Annotated[
        TfScope,
        Setting(
            help="Publish tf on /tf (global), on /NS/tf (namespaced), or on both.",
            panel="ROS 2",
            key="ros.tf",
        ),
    ] = "both"
    tf_root: Annotated[
        str,
        Setting(
            help="Parent frame of the odometry frames of all robots on /tf_static; off = none.",
            panel="ROS 2",
            metavar="FRAME|off",
            key="ros.tf_root",
        ),
    ] = "world"
    ros_bridge_cmd_vel: Annotated[
        BridgedCommand,
        Setting(
            help="Type of cmd_vel that zenoh-bridge-ros2dds sees; it routes one type a topic.",
            panel="ROS 2",
            key="ros.bridge_cmd_vel",
        ),
    ] = "twist"


USUAL_ROS: Final = RosChoice()
HIDDEN: Final = RosChoice(ros_domain="off")
"""No ROS 2 endpoints."""
USUAL_TF: Final = TfChoice()
NAMESPACED: Final = TfChoice(tf="namespaced")
