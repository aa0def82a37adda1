"""`zensim model`: what a description says, parsed as the server would, without a server."""

import json
from dataclasses import dataclass
from typing import Annotated

import typer

from zensim.proto.cli_options import options_from
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.cli import MissingServerExtra, server_extra
from zensim.sim_server.errors import ModelError, SimError
from zensim.spawner.cli.command_session import AsJson
from zensim.spawner.cli.spawn_arguments import (
    DescriptionOptions,
    SpawnSource,
    make_search_paths,
    parse_compat,
    read_local_description,
)
from zensim.spawner.spawn.description_xml import count_elements, parse_description
from zensim.spawner.spawn.spawn_client import SpawnPayload, make_payload

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@dataclass(frozen=True, kw_only=True)
class ModelOptions(DescriptionOptions):
    """All options of `zensim model`."""

    file: Annotated[
        str, typer.Argument(help="URDF, xacro or SDF file, or the name of a shipped model.")
    ]
    as_json: AsJson = False


@app.command()
@options_from(ModelOptions)
def model(given: ModelOptions) -> None:
    """Show what a description says, without any server."""
    with exit_on_failure("model", SimError, MissingServerExtra):
        text, found = _read_model(given)
        if given.strict:
            _refuse_suspicious(found)
        from zensim.sim_server.description.model_printer import format_model_tree, model_to_json

        written = count_elements(parse_description(text))
        if given.as_json:
            typer.echo(json.dumps({"written": written._asdict(), **model_to_json(found)}))
        else:
            typer.echo(format_model_tree(found))
            typer.echo(f"written: {written.links} links, {written.joints} joints")


def _read_model(given: ModelOptions) -> tuple[str, Model]:
    compat, paths = parse_compat(given), make_search_paths(given)
    description = read_local_description(SpawnSource("FILE", given.file), given, paths)
    # What lacks a mesh is refused by the reader, in the words of the server.
    cargo = make_payload(description, paths, allow_missing=True)
    with server_extra():
        from zensim.sim_server.description.builtin_models import read_builtin_model
        from zensim.sim_server.description.pipeline import parse_description
    text = cargo.text or read_builtin_model(given.file)
    described = parse_description(
        text, assets=_read_assets(cargo), allow_missing=given.allow_missing, compat=compat
    )
    return text, described.model


def _read_assets(cargo: SpawnPayload) -> dict[str, tuple[str, bytes | None]]:
    paths = {file.sha256: file.path for file in cargo.bundle.files}
    return {ref.uri: (ref.sha256, paths[ref.sha256].read_bytes()) for ref in cargo.bundle.refs}


def _refuse_suspicious(found: Model) -> None:
    entries = [entry for entry in found.report if entry.status == "suspicious"]
    if entries:
        first = entries[0]
        raise ModelError(
            f"{len(entries)} suspicious, first {first.subject}: {first.reason}; "
            "mend it, or leave --strict out",
            slug="report.suspicious",
        )
