"""Loads a world without a server, reports its content, and checks that it stands still.

Run with `python -m`: a request on stdin, the result on stdout. An engine that crashes ends this
process only.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections import Counter
from contextlib import contextmanager
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.bounded_files import read_file
from zensim.proto.child_process import make_module_command, reserve_stdout, run_process
from zensim.proto.messages.model_messages import ReportEntry, Vec3
from zensim.proto.parent_death import die_with_parent
from zensim.proto.settings.engine_settings import EngineChoice
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import make_settings, read_settings
from zensim.sim_server.description.strict_xml import MAX_BYTES
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.server_config import ConfigError, ServerConfig, fill_pace
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world_loading.world_loader import (
    LoadedWorld,
    WorldLoaderRequest,
    find_model_overlaps,
    make_world_engine,
    spawn_models,
)
from zensim.sim_server.world_loading.world_loader_process import load_world_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from zensim.proto.se3 import FloatArray

COMMAND = make_module_command("zensim.sim_server.world_loading.world_inspection")
WORLD_SUFFIXES = (".world", ".sdf")
_WORLD_TAG = re.compile(r"<world[\s>]")
MOVING_MPS = 1e-3
"""A model that is faster than this at the end of the check is moving."""
MOVING_JOINT = 1e-2
"""A model with a joint that is faster than this [rad/s or m/s] is moving."""
MOVED_M = 1e-6
"""A static model that is further away than this has moved."""
TIMEOUT_S = 120.0


class InspectionRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A world file, and the simulation time [s] for which to watch its models; 0 = none."""

    world: WorldLoaderRequest
    settle_s: float = 0.0
    options: EngineChoice = EngineChoice()


class InspectedModel(msgspec.Struct, frozen=True):
    """A model of a world; its motion is that at the end of the check."""

    name: str
    is_static: bool
    links: int
    mass_kg: float
    position: Vec3
    moved_m: float = 0.0
    speed_mps: float = 0.0
    joint_speed: float = 0.0
    """Speed of the fastest joint [rad/s or m/s]."""

    @property
    def is_moving(self) -> bool:
        """Whether the model did not stand still."""
        has_moved = self.is_static and self.moved_m > MOVED_M
        return self.speed_mps > MOVING_MPS or self.joint_speed > MOVING_JOINT or has_moved


class WorldInspection(msgspec.Struct, frozen=True, kw_only=True):
    """Content of a world file, or the fault for which it is refused."""

    file: str
    fault: str = ""
    load_s: float = 0.0
    name: str = ""
    models: tuple[InspectedModel, ...] = ()
    lights: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    gravity: Vec3 = (0.0, 0.0, 0.0)
    has_ground: bool = False
    step_s: float | None = None
    real_time_factor: float | None = None
    mesh_bytes: int = 0
    settle_s: float = 0.0
    """Simulation time of the check; 0 = not checked."""
    settle_wall_s: float = 0.0
    overlaps: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Models that overlap others at the start of the check."""
    report: tuple[ReportEntry, ...] = ()

    @property
    def warnings(self) -> tuple[ReportEntry, ...]:
        """The suspicious entries of the report."""
        return tuple(entry for entry in self.report if entry.status == "suspicious")

    @property
    def moving(self) -> tuple[InspectedModel, ...]:
        """The models that move at the end of the check."""
        return tuple(model for model in self.models if model.is_moving)


def main() -> None:
    """Inspect the requested world."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # PyBullet prints to stdout.
    replies = reserve_stdout()
    request = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=InspectionRequest)
    with os.fdopen(replies, "wb") as stream:
        stream.write(msgspec.msgpack.encode(inspect_world(request)))


def inspect_in_process(request: InspectionRequest) -> WorldInspection:
    """Inspect a world in a child process; an engine's crash is a fault of the world."""
    outcome = run_process(COMMAND, msgspec.msgpack.encode(request), timeout_s=TIMEOUT_S)
    if outcome.status:
        why = "took too long" if outcome.is_out_of_time else f"crashed (status {outcome.status})"
        return WorldInspection(file=request.world.name, fault=f"its process {why}")
    return msgspec.msgpack.decode(outcome.output, type=WorldInspection)


def inspect_world(request: InspectionRequest) -> WorldInspection:
    """Load a world, and watch its models if the request says so."""
    started = time.perf_counter()
    order = request.world
    try:
        loaded = load_world_file(order.name, order.files)
        found = describe_world(order.name, loaded)
        found = msgspec.structs.replace(found, load_s=time.perf_counter() - started)
        return watch_models(found, loaded, request) if request.settle_s else found
    except ConfigError as error:
        fault = str(error).removeprefix(f"world '{order.name}': ")
        return WorldInspection(file=order.name, fault=fault, load_s=time.perf_counter() - started)


def describe_world(file: str, loaded: LoadedWorld) -> WorldInspection:
    """Describe what was read from a world file."""
    world = loaded.model
    sun = ("sun",) if world.scene.has_sun else ()
    return WorldInspection(
        file=file,
        name=world.name,
        models=tuple(
            InspectedModel(
                placed.name,
                placed.model.is_static,
                len(placed.model.links),
                placed.model.mass_kg,
                placed.origin.position,
            )
            for placed in world.models
        ),
        lights=(*sun, *(f"{light.name} ({light.kind})" for light in world.scene.lights)),
        frames=tuple(bounded.pose.name for bounded in world.named_poses),
        gravity=world.gravity,
        has_ground=world.ground_plane,
        step_s=world.physics.step_s,
        real_time_factor=world.physics.real_time_factor,
        mesh_bytes=sum(map(len, loaded.meshes.values())),
        report=world.report,
    )


def watch_models(
    found: WorldInspection, loaded: LoadedWorld, request: InspectionRequest
) -> WorldInspection:
    """Simulate a world as a server does, and add how far and how fast each model moved.

    Raises:
        ConfigError: The engine refuses a model.
    """
    started = time.perf_counter()
    config = fill_pace(
        ServerConfig(settings=make_settings(ServerSettings, read_settings(request.options))),
        step_s=loaded.model.physics.step_s,
        real_time_factor=loaded.model.physics.real_time_factor,
    )
    with _spawned(loaded, config) as world:
        overlaps = tuple(
            (one, tuple(others)) for one, others in find_model_overlaps(world) if others
        )
        before = _read_bases(world)
        for _ in range(round(request.settle_s * 1e9 / config.step_ns)):
            world.step()
        joints = _read_joint_speeds(world)
        models = tuple(_add_motion(found.models, before, _read_bases(world), joints))
    return msgspec.structs.replace(
        found,
        models=models,
        overlaps=overlaps,
        settle_s=request.settle_s,
        settle_wall_s=time.perf_counter() - started,
    )


@contextmanager
def _spawned(loaded: LoadedWorld, config: ServerConfig) -> Iterator[SimulatedWorld]:
    """Make a world with its models, and close it."""
    store = AssetStore()
    try:
        for name, data in loaded.meshes.items():
            store.pin(name, data)
        engine = make_world_engine(config, loaded.model, store.folder)
        world = SimulatedWorld(
            engine, name="default", step_ns=config.step_ns, control_steps=config.control_steps
        )
        spawn_models(world, loaded.model)
        yield world
        world.close()
    finally:
        store.close()


def _read_bases(world: SimulatedWorld) -> dict[str, FloatArray]:
    return dict(zip(world.entities.index.names, np.array(world.states().base), strict=True))


def _read_joint_speeds(world: SimulatedWorld) -> dict[str, float]:
    index, speeds = world.entities.index, np.abs(world.states().joint_velocities)
    ends = zip(index.names, index.joint_start, index.joint_count, strict=True)
    return {name: float(speeds[at : at + count].max(initial=0.0)) for name, at, count in ends}


def _add_motion(
    models: Iterable[InspectedModel],
    before: dict[str, FloatArray],
    after: dict[str, FloatArray],
    joint_speeds: dict[str, float],
) -> Iterator[InspectedModel]:
    for model in models:
        old, new = before[model.name], after[model.name]
        yield msgspec.structs.replace(
            model,
            moved_m=float(np.linalg.norm(new[:3] - old[:3])),
            speed_mps=float(np.linalg.norm(new[7:10])),
            joint_speed=joint_speeds[model.name],
        )


class ReportGroup(msgspec.Struct, frozen=True):
    """Entries of a report that differ in names only."""

    status: str
    subject: str
    reason: str
    count: int


_NAME = re.compile(r"'[^']*'")


def group_entries(entries: Iterable[ReportEntry]) -> list[ReportGroup]:
    """Count the entries that differ in names only, most frequent first."""
    counts = Counter(
        (entry.status, _NAME.sub("*", _drop_model(entry.subject)), _NAME.sub("*", entry.reason))
        for entry in entries
    )
    return [ReportGroup(*key, count) for key, count in counts.most_common()]


def _drop_model(subject: str) -> str:
    """Leave out the name of the model, with which entries of a world begin."""
    model, separator, rest = subject.partition(": ")
    is_place = "'" in model or "<" in rest[:1] or not separator
    return subject if is_place else rest


def find_world_files(folder: Path) -> list[Path]:
    """Find the world files below a folder, sorted; files of single models are left out."""
    found = (path for path in sorted(folder.rglob("*")) if path.suffix in WORLD_SUFFIXES)
    return [path for path in found if path.is_file() and _holds_world(path)]


def _holds_world(path: Path) -> bool:
    try:
        return _WORLD_TAG.search(read_file(path, MAX_BYTES).decode(errors="replace")) is not None
    except OSError:
        return False


if __name__ == "__main__":
    main()
