"""Loading of large worlds

`zensim world inspect FILE --settle 1`: a world file is read, its models are made, and a second of
simulation shows that they stand still. The worlds are written here: "shapes" has loose boxes,
cylinders and spheres at 1 kHz, as gz-sim's example `3k_shapes`; "city" has static models with fine
concave meshes at 200 Hz, each mesh with 2,400 triangles. Wall time of one process with a cold cache
of compiled models.
"""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np

from benchmarks.figures import Figure, Limit, table
from zensim.proto.engine_proofs import EngineName
from zensim.proto.stl import write_corners
from zensim.sim_server.physics.engine_config import EngineOptions
from zensim.sim_server.world_loading.world_inspection import InspectionRequest, inspect_in_process
from zensim.sim_server.world_loading.world_loader import WorldLoaderRequest

__all__ = ["rows", "table"]

MOST_S = 10.0
SHAPES = (
    "<box><size>1 1 1</size></box>",
    "<cylinder><radius>0.5</radius><length>1</length></cylinder>",
    "<sphere><radius>0.5</radius></sphere>",
)
SPACING_M = 1.5
MESHES = 8
ROUND, ALONG = 60, 20
"""Quadrilaterals of a mesh around and along its axis."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure both worlds in both engines."""
    shapes, buildings = (3, 1) if is_short else (3000, 80)
    with TemporaryDirectory() as folder:
        for label, file in (
            (f"shapes: {shapes} loose models", write_shapes(Path(folder), shapes)),
            (f"city: {buildings} static models with meshes", write_city(Path(folder), buildings)),
        ):
            for engine in get_args(EngineName):
                yield _inspect(label, file, engine)


def _inspect(label: str, file: Path, engine: EngineName) -> Figure:
    found = inspect_in_process(
        InspectionRequest(
            world=WorldLoaderRequest(str(file), (str(file.parent),)),
            settle_s=1.0,
            options=EngineOptions(engine=engine),
        )
    )
    if found.fault or found.moving:
        raise RuntimeError(f"{label}: {found.fault or found.moving}")
    return Figure(
        what=f"{label}, {engine}",
        unit="s",
        samples=(found.load_s + found.settle_wall_s,),
        limit=Limit("max", "<=", MOST_S, is_timed=True),
    )


def write_shapes(folder: Path, count: int) -> Path:
    """Write a world of loose shapes on a grid; return its file."""
    side = int(np.ceil(np.sqrt(count)))
    models = []
    for at in range(count):
        x, y = SPACING_M * (at % side), SPACING_M * (at // side)
        shape = f"<geometry>{SHAPES[at % len(SHAPES)]}</geometry>"
        models.append(
            f'<model name="shape{at}"><pose>{x} {y} 0.5 0 0 0</pose><link name="link">'
            f'<inertial><mass>1</mass></inertial><collision name="c">{shape}</collision>'
            f'<visual name="v">{shape}</visual></link></model>'
        )
    return _write_world(folder, "shapes", 0.001, models)


def write_city(folder: Path, count: int) -> Path:
    """Write a world of static models, each with a vase of one of some meshes; return its file."""
    for at in range(MESHES):
        (folder / f"vase{at}.stl").write_bytes(write_corners(make_vase(at)))
    models = []
    for at in range(count):
        uri = f"<mesh><uri>vase{at % MESHES}.stl</uri></mesh>"
        models.append(
            f'<model name="vase{at}"><static>1</static>'
            f"<pose>{6 * (at % 10)} {6 * (at // 10)} 0 0 0 0</pose>"
            f'<link name="link"><collision name="c"><geometry>{uri}</geometry></collision>'
            "</link></model>"
        )
    return _write_world(folder, "city", 0.005, models)


def make_vase(number: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Make the triangles (n, 3, 3) of an open surface that is concave along its axis."""
    heights = np.linspace(0.0, 3.0, ALONG + 1)
    radii = 1.0 + 0.1 * number + 0.4 * np.cos(2.0 * heights)
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND + 1)[:-1]
    points = np.stack(
        [
            radii[:, None] * np.cos(angles),
            radii[:, None] * np.sin(angles),
            np.broadcast_to(heights[:, None], (ALONG + 1, ROUND)),
        ],
        axis=2,
    )
    low, high = points[:-1], points[1:]
    next_low, next_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    halves = [np.stack(one, axis=2) for one in ((low, next_low, next_high), (low, next_high, high))]
    return np.concatenate(halves).reshape(-1, 3, 3)


def _write_world(folder: Path, name: str, step_s: float, models: list[str]) -> Path:
    file = folder / f"{name}.sdf"
    ground = (
        '<model name="ground"><static>1</static><link name="link"><collision name="c"><geometry>'
        "<plane/></geometry></collision></link></model>"
    )
    file.write_text(
        f'<sdf version="1.9"><world name="{name}"><physics name="p" type="ode">'
        f"<max_step_size>{step_s}</max_step_size></physics>{ground}{''.join(models)}</world></sdf>"
    )
    return file
