"""Loading of large worlds

`zensim world inspect FILE --settle 1`: a world file is read, its models are made, and a second of
simulation shows that they stand still. The worlds are written here: "shapes" has loose boxes,
cylinders and spheres at 1 kHz, as gz-sim's example `3k_shapes`; "city" has static models with fine
concave meshes at 200 Hz, each mesh with 2,400 triangles. Wall time of one process with a cold cache
of compiled models.

"rooms" has static models of four meshes each, as people's hospitals and offices, at their usual
1 kHz, and four driven box_bots: CPU time of a step, beside that of the robots alone, and wall time
to read the file. A step that takes less CPU time than it lasts leaves a real-time factor of 1. The
last figure is that of all services in one process, with four lidars that are read.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import msgspec
import numpy as np

from benchmarks.figures import Figure, table
from zensim import World
from zensim.proto.engine_proofs import EngineName
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.start_settings import WorldFileSettings
from zensim.proto.stl import write_corners
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.server_config import ServerConfig, fill_pace
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.spawn_request import ValidatedSpawn
from zensim.sim_server.world_loading.world_inspection import InspectionRequest, inspect_in_process
from zensim.sim_server.world_loading.world_loader import (
    LoadedWorld,
    WorldLoaderRequest,
    load_world_in_process,
    make_world_engine,
    spawn_models,
)

__all__ = ["rows", "table"]

SHAPES = (
    "<box><size>1 1 1</size></box>",
    "<cylinder><radius>0.5</radius><length>1</length></cylinder>",
    "<sphere><radius>0.5</radius></sphere>",
)
SPACING_M = 1.5
MESHES = 8
ROOMS, PER_ROOM, ROBOTS = 170, 4, 4
STEPS, ROUNDS = 300, 6
"""Steps of a round, and rounds; the first one settles."""
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
        rooms = 2 if is_short else ROOMS
        yield from _measure_rooms(rooms, write_rooms(Path(folder), rooms), is_short=is_short)


def _measure_rooms(count: int, file: Path, *, is_short: bool) -> Iterator[Figure]:
    order = WorldLoaderRequest(str(file), WorldFileSettings(model_paths=(str(file.parent),)))
    started = time.perf_counter()
    loaded = load_world_in_process(order)
    yield Figure(
        what=f"rooms: {count} static models of {PER_ROOM} meshes, read",
        unit="s",
        samples=(time.perf_counter() - started,),
    )
    alone = LoadedWorld(msgspec.structs.replace(loaded.model, models=()))
    steps = 20 if is_short else STEPS
    for engine in get_args(EngineName):
        for label, world in (("robots alone", alone), (f"{count} static models", loaded)):
            yield Figure(
                what=f"rooms: a step at 1 kHz with 4 driven box_bots, {label}, {engine}",
                unit="ms CPU",
                samples=_time_steps(world, engine, steps),
            )
    yield Figure(
        what="rooms: a second at 1 kHz with 4 driven box_bot_lidars, all services, pybullet",
        unit="s CPU",
        samples=_time_services(file, 0.02 if is_short else 1.0),
    )


def _time_services(file: Path, time_s: float) -> tuple[float, ...]:
    """Time a world in process with four robots whose scans are read [s of CPU the second]."""
    samples: list[float] = []
    scans: list[object] = []
    with World(file, engine="pybullet") as world:
        robots = [
            world.spawn("box_bot_lidar", name=f"r{number}", x=2.0 * number, y=-6.0)
            for number in range(ROBOTS)
        ]
        for robot in robots:
            robot.topic("scan").on(scans.append)
            robot.drive(0.3, 0.2)
        for _ in range(ROUNDS):
            started = time.process_time()
            world.run_for(time_s)
            samples.append((time.process_time() - started) / time_s)
    if time_s >= 1.0 and len(scans) < ROBOTS * ROUNDS * 9:
        raise RuntimeError(f"{len(scans)} scans were read")
    return tuple(samples[1:])


def _time_steps(loaded: LoadedWorld, engine: EngineName, steps: int) -> tuple[float, ...]:
    """Time steps of a world with four robots that drive circles beside it [ms of CPU]."""
    config = fill_pace(
        ServerConfig(settings=ServerSettings(physics=EngineSettings(engine=engine))),
        step_s=1e-3,
        real_time_factor=0.0,
    )
    store = AssetStore()
    for name, data in loaded.meshes.items():
        store.pin(name, data)
    world = SimulatedWorld(
        make_world_engine(config, loaded.model, store.folder),
        name="rooms",
        step_ns=config.step_ns,
        control_steps=config.control_steps,
    )
    spawn_models(world, loaded.model)
    robot = read_robot(read_builtin_model("box_bot"))
    for number in range(ROBOTS):
        base = np.array([2.0 * number, -6.0, 0.06, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
        world.spawn(ValidatedSpawn(f"r{number}", "", robot, base))
    bodies = [world.entities.find(f"r{number}").body for number in range(ROBOTS)]
    world.engine.command(bodies, np.array([5.0, 4.0] * ROBOTS))
    samples = []
    for _ in range(ROUNDS):
        started = time.process_time()
        for _ in range(steps):
            world.step()
        samples.append((time.process_time() - started) / steps * 1e3)
    world.close()
    store.close()
    return tuple(samples[1:])


def _inspect(label: str, file: Path, engine: EngineName) -> Figure:
    found = inspect_in_process(
        InspectionRequest(
            world=WorldLoaderRequest(str(file), WorldFileSettings(model_paths=(str(file.parent),))),
            settle_s=1.0,
            options=EngineSettings(engine=engine),
        )
    )
    if found.fault or found.moving:
        raise RuntimeError(f"{label}: {found.fault or found.moving}")
    return Figure(
        what=f"{label}, {engine}", unit="s", samples=(found.load_s + found.settle_wall_s,)
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


def write_rooms(folder: Path, count: int) -> Path:
    """Write a world of static models of several meshes, some within each other's bounds."""
    parts = "".join(
        f'<collision name="c{at}"><pose>0 0 {0.3 * at} 0 0 0</pose><geometry><mesh>'
        f"<uri>vase{at}.stl</uri></mesh></geometry></collision>"
        for at in range(PER_ROOM)
    )
    models = [
        f'<model name="room{at}"><static>1</static><pose>{2 * (at % 13)} {2 * (at // 13)} 0 0 0 0'
        f'</pose><link name="link">{parts}</link></model>'
        for at in range(count)
    ]
    return _write_world(folder, "rooms", 0.001, models)


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
