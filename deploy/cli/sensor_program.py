"""`zensim sensors run`: run a sensor process."""

from dataclasses import dataclass
from typing import Annotated

import typer

from zensim.deploy.cli.sensor_commands import app
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.join_tokens import hide_token
from zensim.proto.names import check_name
from zensim.proto.options.command_options import (
    ConnectOption,
    JsonOption,
    RosOptions,
    WorldNameOption,
    flag,
    seconds,
)
from zensim.proto.settings.operation_settings import USUAL_METRICS, MetricsSettings
from zensim.proto.verbosity import print_announcement
from zensim.sim_server.sensors.sensor_config import SensorProcessConfig
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

__all__ = ["app"]


@dataclass(frozen=True, kw_only=True)
class SensorRunOptions(RosOptions):
    """All options of `zensim sensors run`."""

    name: Annotated[
        str, typer.Option(metavar="NAME", help="Name of this process.", show_default="generated")
    ] = ""
    always: Annotated[
        bool, flag("--always", help="Follow the scene without subscribers, too, as for recorders.")
    ] = False
    quiet: Annotated[bool, flag("--quiet", "-q", help="Log at level WARNING.")] = False
    as_json: JsonOption = False
    operation: MetricsSettings = USUAL_METRICS
    connect: ConnectOption = ""
    world_name: WorldNameOption = "default"
    wait: Annotated[
        float,
        seconds(
            help=r"Timeout of waiting for a server that starts later \[s].",
            rich_help_panel="Connection",
        ),
    ] = 1.0


@app.command(
    epilog="""Examples:
  zensim sensors run
  zensim sensors run --connect tcp/10.0.0.5:7447"""
)
def run(given: SensorRunOptions) -> None:
    """Publish lidars, range finders and cameras; several processes share them evenly."""
    with exit_on_failure("sensors run", MissingServerExtra):
        with server_extra():
            from zensim.sim_server.sensors.sensor_process import start_sensor_process
        endpoint = given.connect or DEFAULT_ENDPOINT
        if given.as_json:
            facts = {"endpoint": hide_token(endpoint), "world": given.world_name}
            print_announcement("sensors run", "", facts, as_json=True)
        start_sensor_process(
            SensorProcessConfig(
                endpoint=endpoint,
                world=check_name(given.world_name, "world"),
                name=check_name(given.name, "sensor process") if given.name else "",
                is_always_on=given.always,
                wait_s=given.wait,
                ros=given.ros,
                is_quiet=given.quiet,
                metrics=given.operation.choose_metrics("zensim sensors run"),
            )
        )
