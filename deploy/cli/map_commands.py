"""`zensim map`: write a map of the world in the format of Nav2's map_server."""

from pathlib import Path
from typing import Annotated

import msgspec
import typer

from zensim.deploy.cli.command_session import data_console, open_client, print_json
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.standard_messages import OccupancyGrid
from zensim.proto.messages.world_messages import GetMapRequest
from zensim.proto.options.command_options import ClientOptions, JsonOption
from zensim.proto.options.option_groups import make_app

app = make_app()

FREE, OCCUPIED = 0, 100
"""Values of cells."""
OCCUPIED_PIXEL, UNKNOWN_PIXEL, FREE_PIXEL = 0, 205, 254
"""Grey values of map_server."""
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
DEFAULTS = GetMapRequest()


class MapFacts(msgspec.Struct, frozen=True):
    """What `--json` prints."""

    yaml: str
    image: str
    width: int
    height: int
    resolution_m: float
    occupied: int
    """Cells."""


@app.command(
    "map",
    epilog="""Examples:
  zensim map --output map.yaml
  ros2 run nav2_map_server map_server --ros-args -p yaml_filename:=map.yaml""",
)
def write_map(
    *,
    output: Annotated[
        Path, typer.Option(metavar="FILE", help="YAML file; the image is written beside it.")
    ] = Path("map.yaml"),
    resolution: Annotated[
        float, typer.Option(metavar="METRES", help=r"Side of a cell \[m].")
    ] = DEFAULTS.resolution_m,
    low: Annotated[
        float, typer.Option(metavar="METRES", help=r"Lowest height that counts \[m].")
    ] = DEFAULTS.low_m,
    high: Annotated[
        float, typer.Option(metavar="METRES", help=r"Greatest height that counts \[m].")
    ] = DEFAULTS.high_m,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Write a map of what is fixed in the world: a YAML file and a PGM image."""
    with exit_on_failure("map"):
        with open_client("map", server) as client:
            grid = client.map(GetMapRequest(resolution, low, high))
        image = output.with_suffix(".pgm")
        image.write_bytes(make_pgm(grid))
        output.write_text(make_map_yaml(grid, image.name), encoding="utf-8")
        facts = MapFacts(
            str(output),
            str(image),
            grid.info.width,
            grid.info.height,
            grid.info.resolution,
            grid.data.count(OCCUPIED),
        )
        if as_json:
            print_json(facts)
        else:
            data_console.print(
                f"{output}, {image}: {facts.width} x {facts.height} cells of "
                f"{facts.resolution_m:g} m, {facts.occupied} occupied"
            )


def make_pgm(grid: OccupancyGrid) -> bytes:
    """Make the image of a map: its uppermost row, of the greatest y, comes first."""
    width, height = grid.info.width, grid.info.height
    pixels = grid.data.translate(
        bytes(
            {FREE: FREE_PIXEL, OCCUPIED: OCCUPIED_PIXEL}.get(value, UNKNOWN_PIXEL)
            for value in range(256)
        )
    )
    rows = [pixels[start : start + width] for start in range(0, width * height, width)]
    return f"P5\n{width} {height}\n255\n".encode() + b"".join(reversed(rows))


def make_map_yaml(grid: OccupancyGrid, image: str) -> str:
    """Make the YAML file of a map."""
    position = grid.info.origin.position
    return (
        f"image: {msgspec.json.encode(image).decode()}\n"
        "mode: trinary\n"
        f"resolution: {grid.info.resolution:g}\n"
        f"origin: [{position.x:.6f}, {position.y:.6f}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESHOLD}\n"
        f"free_thresh: {FREE_THRESHOLD}\n"
    )
