"""Command-line options that several programs share (ROS 2 exposure), and options as the fields of a dataclass."""

import dataclasses
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, TypeVar

import typer

from zensim.proto.ros2.ros_settings import RosSettings, parse_ros_settings

Options = TypeVar("Options")


def options_from(
    kind: Callable[..., Options],
) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Let typer see the fields of a dataclass as the parameters of a command.

    Args:
        kind: A dataclass whose fields typer could have as parameters.
    """

    def wrap(action: Callable[[Options], None]) -> Callable[..., None]:
        def command(**given: object) -> None:
            action(kind(**given))

        command.__name__ = action.__name__
        command.__doc__ = action.__doc__
        command.__signature__ = inspect.Signature(_make_parameters(kind))  # type: ignore[attr-defined]
        return command

    return wrap


def _make_parameters(kind: Callable[..., Options]) -> list[inspect.Parameter]:
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty
            if field.default is dataclasses.MISSING
            else field.default,
            annotation=field.type,
        )
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]
    ]


RosDomainOption = Annotated[
    str,
    typer.Option(
        help="ROS 2 domain to be seen in, 0 to 232, or 'off'.",
        envvar=["ZENSIM_ROS_DOMAIN", "ROS_DOMAIN_ID"],
    ),
]
RosDistroOption = Annotated[
    str, typer.Option(help="ROS 2 distribution to talk to; only humble is unlike the others.")
]
RosBridgeOption = Annotated[
    bool, typer.Option("--ros-bridge", help="Announce everything to zenoh-bridge-ros2dds too.")
]
TfScopeOption = Annotated[
    str, typer.Option(help="Transforms on /tf (global), on /NS/tf (namespaced), or both.")
]
TfRootOption = Annotated[
    str,
    typer.Option(help="Frame on /tf_static that all robots' odometry hangs from, or 'off'."),
]


@dataclass(frozen=True, kw_only=True)
class RosOptions:
    """Of a program that tells no transforms."""

    ros_domain: RosDomainOption = "0"
    ros_distro: RosDistroOption = "jazzy"
    ros_bridge: RosBridgeOption = False

    @property
    def ros(self) -> RosSettings:
        """What they say.

        Raises:
            ValueError: See `ros_settings`.
        """
        return parse_ros_settings(self.ros_domain, self.ros_distro, is_bridged=self.ros_bridge)


@dataclass(frozen=True, kw_only=True)
class RosTfOptions(RosOptions):
    """Of a program that tells transforms."""

    tf: TfScopeOption = "both"
    tf_root: TfRootOption = "world"

    @property
    def ros(self) -> RosSettings:
        """See `RosOptions`."""
        return parse_ros_settings(
            self.ros_domain, self.ros_distro, self.tf, self.tf_root, is_bridged=self.ros_bridge
        )
