"""Settings of `zensim up`: those of its server, and of the programs that it starts with it."""

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.operation_settings import OperationSettings
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.ros_choice import RosChoice, TfChoice
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import Setting

MAX_AGENT_PROCESSES: Final = 20
"""Default limit of one agent process per robot; each takes 11 MB."""
PageRole = Literal["page", "operator"]


class AgentSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Which agents drive the robots."""

    agents: Annotated[
        Literal["per-robot", "pooled"] | None,
        Setting(
            help="One agent process per robot, or a few that drive many robots each.",
            panel="Agents",
            usual=f"per-robot up to {MAX_AGENT_PROCESSES} robots",
        ),
    ] = None
    drive_others: Annotated[
        bool,
        Setting(
            help="Drive robots that others spawn, by a pool that starts with the first of them.",
            panel="Agents",
            spelling="--drive-others/--no-drive-others",
            usual="drive-others without a scenario",
        ),
    ] = True


class ViewerSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The page."""

    viewer: Annotated[
        bool,
        Setting(
            help="Serve the 3D web page.",
            panel="Viewer",
            spelling="--viewer/--no-viewer",
            key="viewer.show",
        ),
    ] = True
    viewer_port: Annotated[
        int,
        Setting(
            help="TCP port of the page; 0 = any free.",
            panel="Viewer",
            spelling="--port",
            metavar="PORT",
            least=0,
            most=65535,
            key="viewer.port",
        ),
    ] = 8080
    page_role: Annotated[
        PageRole | None,
        Setting(
            help="With `secure`: visitors of the page look, or act as an operator.",
            panel="Viewer",
            usual="page",
        ),
    ] = None
    open_page: Annotated[
        bool | None,
        Setting(
            help="Open the page in a browser.",
            panel="Viewer",
            spelling="--open/--no-open",
            usual="open on a desktop",
            key="viewer.open",
        ),
    ] = None


NO_PAGE: Final = ViewerSettings(viewer=False)


class ProgramSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Programs that measure and record."""

    sensors: Annotated[
        int | None,
        Setting(
            help="Number of processes that publish lidars and cameras; idle without subscribers.",
            metavar="N",
            least=0,
            most=64,
            usual="1, from the first robot that has one",
            key="sensors.processes",
        ),
    ] = None
    record: Annotated[
        Path | None,
        Setting(
            help="Record all topics there, as 'zensim record --all' does.",
            metavar="FOLDER|FILE.mcap",
        ),
    ] = None


class ServeSettings(msgspec.Struct, frozen=True, kw_only=True):
    """All settings of a server process."""

    network: NetworkSettings = NetworkSettings()
    operation: OperationSettings = OperationSettings()
    server: ServerSettings = ServerSettings()
    ros_choice: RosChoice = RosChoice()


class DeploymentSettings(ServeSettings, frozen=True, kw_only=True):
    """Settings of a server and the programs around it."""

    tf_choice: TfChoice = TfChoice()
    programs: ProgramSettings = ProgramSettings()
    viewer: ViewerSettings = ViewerSettings()


class UpSettings(DeploymentSettings, frozen=True, kw_only=True):
    """All settings of `zensim up` that do not describe its robots."""

    agents: AgentSettings = AgentSettings()
    rates: RateOverrides = RateOverrides()


USUAL: Final = UpSettings()
"""Default settings of all programs."""
