"""`zensim model`: parse a description as the server does, without a server."""

import json
from dataclasses import dataclass
from typing import Annotated

import msgspec
import typer

from zensim.deploy.cli.spawn_arguments import (
    DescriptionOptions,
    SpawnSource,
    make_search_paths,
    parse_compat,
    read_local_description,
)
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.model_messages import Model
from zensim.proto.options.command_options import JsonOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.sim_server.errors import ModelError, SimError
from zensim.sim_server.server_extra import MissingServerExtra, server_extra
from zensim.spawner.spawn.asset_bundle import read_assets
from zensim.spawner.spawn.description_xml import count_elements, parse_description
from zensim.spawner.spawn.spawn_client import make_payload

app = make_app()


@dataclass(frozen=True, kw_only=True)
class ModelOptions(DescriptionOptions):
    """All options of `zensim model`."""

    file: Annotated[
        str,
        typer.Argument(
            metavar="MODEL", help="Built-in model, or path of a URDF, xacro or SDF file."
        ),
    ]
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim model box_bot
  zensim model robot.urdf --strict --json"""
)
def model(given: ModelOptions) -> None:
    """Parse a robot description and print links, joints, drive and report, without a server."""
    print_model(given)


def print_model(given: ModelOptions) -> None:
    """Run the command; a failure ends the program with its status."""
    with exit_on_failure("model", SimError, MissingServerExtra):
        text, parsed = _read_model(given)
        if given.strict:
            _check_report(parsed)
        from zensim.sim_server.description.model_printer import format_model_tree, model_to_json

        elements = count_elements(parse_description(text))
        if given.as_json:
            print_lines(json.dumps({"written": elements._asdict(), **model_to_json(parsed)}))
        else:
            print_lines(format_model_tree(parsed))
            print_lines(f"written: {elements.links} links, {elements.joints} joints")


def _read_model(given: ModelOptions) -> tuple[str, Model]:
    compat, paths = parse_compat(given), make_search_paths(given)
    description = read_local_description(SpawnSource("FILE", given.file), given, paths)
    # The parser refuses missing meshes, with the error of the server.
    payload = make_payload(
        description, paths, allow_missing=True, controllers=given.controllers or ()
    )
    with server_extra():
        from zensim.sim_server.description.builtin_models import read_builtin_model
        from zensim.sim_server.description.unused_modules import leave_out_unused_modules

        leave_out_unused_modules()
        from zensim.sim_server.description.pipeline import parse_description

        text = payload.text or read_builtin_model(given.file)
        described = parse_description(
            text,
            assets=read_assets(payload.bundle),
            allow_missing=given.allow_missing,
            compat=compat,
            controllers=payload.controllers.texts,
            drive=parse_drive_order(given.drive),
        )
    report = (*described.model.report, *payload.controllers.notes)
    return text, msgspec.structs.replace(described.model, report=report)


def _check_report(parsed: Model) -> None:
    entries = [entry for entry in parsed.report if entry.status == "suspicious"]
    if entries:
        first = entries[0]
        raise ModelError(
            f"{len(entries)} suspicious entries, first {first.subject}: {first.reason}; "
            "correct the description or remove --strict",
            slug="report.suspicious",
        )
