"""Options that several commands have: how a program shows itself to ROS 2."""

from dataclasses import dataclass
from typing import Annotated

import typer

from zensim.proto.ros2.settings import RosSettings, ros_settings

RosDomain = Annotated[
    str,
    typer.Option(
        help="ROS 2 domain to be seen in, 0 to 232, or 'off'.",
        envvar=["ZENSIM_ROS_DOMAIN", "ROS_DOMAIN_ID"],
    ),
]
RosDistro = Annotated[
    str, typer.Option(help="ROS 2 distribution to talk to; only humble is unlike the others.")
]
RosBridge = Annotated[
    bool, typer.Option("--ros-bridge", help="Announce everything to zenoh-bridge-ros2dds too.")
]
TfScope = Annotated[
    str, typer.Option(help="Transforms on /tf (global), on /NS/tf (namespaced), or both.")
]
TfRoot = Annotated[
    str,
    typer.Option(help="Frame on /tf_static that all robots' odometry hangs from, or 'off'."),
]


@dataclass(frozen=True, kw_only=True)
class RosOptions:
    """Of a program that tells no transforms."""

    ros_domain: RosDomain = "0"
    ros_distro: RosDistro = "jazzy"
    ros_bridge: RosBridge = False

    @property
    def ros(self) -> RosSettings:
        """What they say.

        Raises:
            ValueError: See `ros_settings`.
        """
        return ros_settings(self.ros_domain, self.ros_distro, is_bridged=self.ros_bridge)


@dataclass(frozen=True, kw_only=True)
class RosTfOptions(RosOptions):
    """Of a program that tells transforms."""

    tf: TfScope = "both"
    tf_root: TfRoot = "world"

    @property
    def ros(self) -> RosSettings:
        """See `RosOptions`."""
        return ros_settings(
            self.ros_domain, self.ros_distro, self.tf, self.tf_root, is_bridged=self.ros_bridge
        )
