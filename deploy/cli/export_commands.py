"""`zensim export`: write a running world as a scenario file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from zensim.api.api_errors import Error, Unreachable
from zensim.api.connections import connect
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import ConnectOption, JsonOption, WorldNameOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.verbosity import print_announcement
from zensim.scenario.scenario_reader import SUFFIXES
from zensim.scenario.world_export import export

app = make_app()


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """All options of `zensim export`."""

    file: Annotated[
        Path, typer.Argument(metavar="FILE", help=f"Scenario file to write, NAME{SUFFIXES[0]}.")
    ]
    force: Annotated[bool, flag("--force", help="Write over files that exist.")] = False
    connect: ConnectOption = DEFAULT_ENDPOINT
    world_name: WorldNameOption = "default"
    as_json: JsonOption = False


@app.command(
    "export",
    epilog="""Examples:
  zensim export lab.scenario.yaml
  zensim up lab.scenario.yaml""",
)
def export_running_world(given: ExportOptions) -> None:
    """Write the running world, with all that was spawned at its present pose, as a scenario."""
    with exit_on_failure("export", Error):
        try:
            with connect(given.connect, world=given.world_name) as sim:
                written = export(sim, given.file, overwrite=given.force)
        except Unreachable as error:
            # Its cause has the exit status and the words of commands.
            raise error.__cause__ or NoServer(error.message) from None
    files = [file.name for file in written]
    print_announcement(
        "export", f"wrote {', '.join(files)}", {"files": files}, as_json=given.as_json
    )
