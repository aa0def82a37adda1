"""`zensim export`: write a running world as a scenario file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from zensim.api.api_errors import Error
from zensim.api.connections import connect
from zensim.proto.cli_options import (
    ConnectOption,
    JsonOption,
    WorldNameOption,
    expand_options,
    flag,
    make_app,
)
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.verbosity import print_announcement
from zensim.scenario.scenario_reader import SUFFIXES, name_of_file
from zensim.scenario.world_export import export_world

app = make_app()


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """All options of `zensim export`."""

    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help=f"Scenario file to write, NAME{SUFFIXES[0]}."),
    ]
    force: Annotated[bool, flag("--force", help="Write over files that exist.")] = False
    connect: ConnectOption = DEFAULT_ENDPOINT
    world_name: WorldNameOption = "default"
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim export lab.scenario.yaml
  zensim up lab.scenario.yaml"""
)
@expand_options
def export(given: ExportOptions) -> None:
    """Write the running world, with all that was spawned at its present pose, as a scenario."""
    with exit_on_failure("export", Error):
        if not given.file.name.endswith(SUFFIXES):
            raise ValueError(f"'{given.file.name}' does not end in {SUFFIXES[0]}; add it")
        with connect(given.connect, world=given.world_name) as sim:
            found = export_world(sim, name_of_file(str(given.file)))
        _refuse_existing(given, [given.file.name, *found.files])
        found.write(given.file)
    files = [given.file.name, *found.files]
    print_announcement(
        "export", f"wrote {', '.join(files)}", {"files": files}, as_json=given.as_json
    )


def _refuse_existing(given: ExportOptions, names: list[str]) -> None:
    exists = [name for name in names if (given.file.parent / name).exists()]
    if exists and not given.force:
        raise ValueError(f"{', '.join(exists)} exists; use --force, or another name")
