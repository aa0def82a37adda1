"""`zensim world inspect`: read world files as the server does, without a server."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from zensim.deploy.cli.world_commands import app
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.options.command_options import JsonOption
from zensim.proto.printable_text import print_lines
from zensim.proto.settings.engine_settings import USUAL_ENGINE, EngineChoice
from zensim.proto.settings.start_settings import USUAL_READING, WorldFileSettings
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

if TYPE_CHECKING:
    from zensim.sim_server.world_loading.world_inspection import WorldInspection

__all__ = ["app"]
MAX_LISTED = 12
"""Names in one line."""
MAX_FILE_LENGTH = 60
"""End of a path that a table shows."""


@dataclass(frozen=True, kw_only=True)
class InspectOptions:
    """All options of `zensim world inspect`."""

    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE|FOLDER...",
            help="World files, built-in worlds, and folders that are searched for world files.",
        ),
    ]
    reading: WorldFileSettings = USUAL_READING
    settle: Annotated[
        float,
        typer.Option(
            "--settle",
            min=0.0,
            max=60.0,
            metavar="SECONDS",
            help=r"Simulate for this time \[s], and name the models that still move.",
        ),
    ] = 0.0
    physics: EngineChoice = USUAL_ENGINE
    as_json: JsonOption = False


@app.command(
    "inspect",
    epilog="""Examples:
  zensim world inspect small_warehouse.world --model-path ./models
  zensim world inspect ./worlds --model-path ./models --settle 2 --engine mujoco""",
)
def inspect_worlds(given: InspectOptions) -> None:
    """Print what a world file contains, or a table of several; status 1 if one is refused."""
    with exit_on_failure("world inspect", MissingServerExtra):
        found = _inspect(given)
    if given.as_json:
        print_lines(json.dumps([_to_json(one) for one in found]))
    elif len(found) == 1:
        print_lines("\n".join(format_world(found[0])))
    else:
        print_lines("\n".join(format_table(found)))
    if any(one.fault for one in found):
        raise typer.Exit(ExitCode.FAILED)


def _inspect(given: InspectOptions) -> "list[WorldInspection]":
    with server_extra():
        from zensim.sim_server.description.builtin_models import list_builtin_worlds
        from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine
        from zensim.sim_server.world_loading.world_inspection import (
            InspectionRequest,
            find_world_files,
            inspect_in_process,
        )
        from zensim.sim_server.world_loading.world_loader import WorldLoaderRequest
    names = [
        name
        for word in given.files
        for name in (map(str, find_world_files(Path(word))) if Path(word).is_dir() else (word,))
    ]
    if not names:
        raise FileNotFoundError(f"no world file below {' '.join(given.files)}; use .world or .sdf")
    builtin = list_builtin_worlds()
    for name in names:
        if name not in builtin and not Path(name).exists():
            known = f"no such world file or built-in world ({', '.join(builtin)})"
            raise FileNotFoundError(ENOENT, known, name)
    if given.settle:
        choose_proven_engine(given.physics)
    order = WorldLoaderRequest("", given.reading)
    orders = [msgspec.structs.replace(order, name=name) for name in names]
    return [
        inspect_in_process(
            InspectionRequest(world=one, settle_s=given.settle, options=given.physics)
        )
        for one in orders
    ]


def _to_json(one: "WorldInspection") -> dict[str, object]:
    values: dict[str, object] = msgspec.to_builtins(one)
    return {**values, "loads": not one.fault, "moving": [model.name for model in one.moving]}


def format_table(found: "Sequence[WorldInspection]") -> list[str]:
    """Format a line per world: file, result, times, counts and the fault."""
    head = ("world", "loads", "time s", "models", "static", "moving", "warnings", "remarks")
    rows = [head, *map(_make_row, found)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head) - 1)]
    lines = [
        "  ".join((*(f"{c:<{w}}" for c, w in zip(row, widths, strict=False)), row[-1])).rstrip()
        for row in rows
    ]
    refused = sum(1 for one in found if one.fault)
    return [*lines, f"{len(found)} worlds: {len(found) - refused} load, {refused} are refused"]


def _make_row(one: "WorldInspection") -> tuple[str, ...]:
    name = one.file[-MAX_FILE_LENGTH:]
    seconds = f"{one.load_s + one.settle_wall_s:.1f}"
    if one.fault:
        return (name, "no", seconds, "-", "-", "-", "-", one.fault)
    static = sum(1 for model in one.models if model.is_static)
    moving = str(len(one.moving)) if one.settle_s else "-"
    remarks = _list_names([model.name for model in one.moving])
    counts = (str(len(one.models)), str(static), moving, str(len(one.warnings)))
    return (name, "yes", seconds, *counts, remarks)


def format_world(one: "WorldInspection") -> list[str]:
    """Format the content of a world, its warnings, and the tags without effect with counts."""
    if one.fault:
        return [f"{one.file}: refused after {one.load_s:.2f} s: {one.fault}"]
    from zensim.sim_server.world_loading.world_inspection import group_entries

    static = [model for model in one.models if model.is_static]
    free = [model for model in one.models if not model.is_static]
    step = f"step {one.step_s:g} s" if one.step_s else "default step"
    factor = "default" if one.real_time_factor is None else f"{one.real_time_factor:g}"
    gravity = " ".join(f"{value:g}" for value in one.gravity)
    lines = [
        f"{one.name}: {one.file}",
        f"read in {one.load_s:.2f} s, {one.mesh_bytes / 1e6:.1f} MB of meshes",
        f"static models: {len(static)} {_list_names([model.name for model in static])}".rstrip(),
        f"moving models: {len(free)} {_list_names([model.name for model in free])}".rstrip(),
        f"lights: {_list_names(one.lights) or 'none'}",
        f"frames: {_list_names(one.frames) or 'none'}",
        f"physics: {step}, real-time factor {factor}, gravity {gravity} m/s^2, "
        f"{'ground plane' if one.has_ground else 'no ground plane'}",
    ]
    if one.settle_s:
        lines += _format_motion(one)
    groups = group_entries(entry for entry in one.report if entry.status in ("ignored", "unknown"))
    lines += [f"{g.status:<10} {g.count:>4} x {g.subject}: {g.reason}" for g in groups]
    lines += [f"warning    {entry.subject}: {entry.reason}" for entry in one.warnings]
    return lines


def _format_motion(one: "WorldInspection") -> list[str]:
    head = f"after {one.settle_s:g} s of simulation ({one.settle_wall_s:.1f} s): "
    overlaps = [
        f"overlap    {name}: {_list_names(others)}" for name, others in one.overlaps[:MAX_LISTED]
    ]
    if len(one.overlaps) > MAX_LISTED:
        overlaps.append(f"overlap    {len(one.overlaps) - MAX_LISTED} more models")
    if not one.moving:
        return [*overlaps, f"{head}all models stand still"]
    return [*overlaps, f"{head}{len(one.moving)} models move"] + [
        f"  {model.name}: {model.moved_m:.4f} m away, {model.speed_mps:.4f} m/s, "
        f"joints {model.joint_speed:.4f} rad/s or m/s"
        for model in one.moving[:MAX_LISTED]
    ]


def _list_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
    return ", ".join(names[:MAX_LISTED]) + more
