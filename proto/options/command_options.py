"""Command-line options that several programs share."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Final, TypeVar

import typer

from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.join_tokens import TOKEN_VARIABLE
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.engine_settings import EngineChoice
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.ros_choice import USUAL_ROS, USUAL_TF, RosChoice, TfChoice
from zensim.proto.settings.setting import find_setting
from zensim.proto.settings.setting_options import make_option
from zensim.proto.topic_catalog import read_ros_settings
from zensim.proto.verbosity import LOG_FORMAT_VARIABLE

Choice = TypeVar("Choice", bound=str)

# In help texts a unit is written r"\[m]": Rich reads a plain [m] as markup and drops it.
flag = partial(typer.Option, metavar="")
"""An option without a value; typer would show the type of its value as <bool>."""
seconds = partial(typer.Option, metavar="SECONDS", min=0.0)
_connection = partial(typer.Option, rich_help_panel="Connection")
ConnectOption = Annotated[
    str,
    _connection(
        "--connect",
        "--join",
        metavar="ENDPOINT|TOKEN",
        help="Zenoh endpoint of the router or server; or join token of a secured one, or @FILE "
        "with a token.",
        show_default=DEFAULT_ENDPOINT,
        envvar=[TOKEN_VARIABLE, "ZENSIM_CONNECT"],
    ),
]
InsecureOption = Annotated[bool, make_option(find_setting(NetworkSettings, "insecure"))]
WorldNameOption = Annotated[str, make_option(find_setting(NetworkSettings, "world_name"))]
TimeoutOption = Annotated[
    float, _connection("--timeout", metavar="SECONDS", help=r"Timeout of each service call \[s].")
]
JsonOption = Annotated[bool, flag("--json", help="Print JSON to standard output.")]
QuietOption = Annotated[
    bool,
    flag("--quiet", "-q", help="Print no notes; of lists, only names.", rich_help_panel="Output"),
]
VerboseOption = Annotated[
    bool,
    flag(
        "--verbose",
        "-v",
        help="Log at level INFO, and print where a failure came from.",
        rich_help_panel="Output",
    ),
]
LogFormatOption = Annotated[
    str,
    typer.Option(
        "--log-format",
        metavar="text|json",
        help="Log lines of text, or objects of JSON.",
        show_default="text",
        envvar=LOG_FORMAT_VARIABLE,
        rich_help_panel="Output",
    ),
]
ADDED_SWITCHES: Final = (
    ("quiet", QuietOption, False),
    ("verbose", VerboseOption, False),
    ("log_format", LogFormatOption, ""),
)
"""Options that each command has: name, type, default."""
AllowFailedEngineOption = Annotated[
    bool, make_option(find_setting(EngineChoice, "allow_failed_engine"))
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Value that wins over the file; repeatable."),
]
RosDomainOption = Annotated[str, make_option(find_setting(RosChoice, "ros_domain"))]


def parse_choice(option: str, word: str, choices: tuple[Choice, ...]) -> Choice:
    """Find the choice that equals a word.

    Raises:
        ValueError: There is none.
    """
    for choice in choices:
        if choice == word:
            return choice
    known = ", ".join(filter(None, choices))
    raise ValueError(f"{option} must be one of {known}; got {word[:40]!r}")


@dataclass(frozen=True, kw_only=True)
class ConnectionOptions:
    """The server to call, for commands without service calls."""

    connect: ConnectOption = ""
    world_name: WorldNameOption = "default"


@dataclass(frozen=True, kw_only=True)
class ClientOptions(ConnectionOptions):
    """The server to call, and how long to wait for its replies."""

    timeout: TimeoutOption = 10.0


@dataclass(frozen=True, kw_only=True)
class RosOptions:
    """ROS 2 options of a program that does not publish tf."""

    ros_choice: RosChoice = USUAL_ROS

    @property
    def ros(self) -> RosSettings:
        """Settings made from the options.

        Raises:
            ValueError: See `read_ros_settings`.
        """
        return read_ros_settings(self.ros_choice)


@dataclass(frozen=True, kw_only=True)
class RosTfOptions(RosOptions):
    """ROS 2 options of a program that publishes tf."""

    tf_choice: TfChoice = USUAL_TF

    @property
    def ros(self) -> RosSettings:
        """See `RosOptions`."""
        return read_ros_settings(self.ros_choice, self.tf_choice)
