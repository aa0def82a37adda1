"""Light commands and warm spawns

CPU time, user and system, of one process per sample: the root options of `zensim`, and `zensim
model` of a robot without meshes and of robots with 20 meshes, each a collision and a visual: STL
files of 14 MB, and DAE files. Commands and floor take turns, so that they see the same machine; one
round before is not counted, and leaves the byte code of all modules. Floor: an interpreter that
runs `pass`.

Spawns, as of `zensim spawn FILE` without the start of its process: find and hash the files, upload
what the server lacks, and spawn. The first of a robot converts its meshes, the later ones are warm.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import large_robot
from benchmarks.figures import Figure, table
from tests.integration.processes import serving
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.stl import write_corners
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_client import add_payload, read_payload, send_files

__all__ = ["rows", "table"]

ROUNDS = 10
MESHES = 20
CORNERS = 42_000
"""Corners of each mesh: 14,000 triangles, 0.7 MB."""
LINK = (
    '<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    '<visual><geometry><mesh filename="{0}.{1}"/></geometry></visual>'
    '<collision><geometry><mesh filename="{0}.{1}"/></geometry></collision></link>'
)
JOINT = '<joint name="j{0}" type="continuous"><parent link="l0"/><child link="l{0}"/></joint>'


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each command in turns with the floor, then spawns."""
    rounds, count = (1, 1) if is_short else (ROUNDS + 1, MESHES)
    with tempfile.TemporaryDirectory() as folder:
        robots = {
            "STL": _write_robot(Path(folder), _make_stl_files(count)),
            "DAE": _write_robot(Path(folder), _make_dae_files(count)),
        }
        yield from _measure_commands(robots, rounds, count, is_short=is_short)
        with serving() as server:
            for kind, robot in robots.items():
                first_s, *later_s = (
                    _spawn_s(server.client, robot, number) for number in range(rounds + 1)
                )
                yield Figure(what=f"first spawn, {count} {kind}", unit="s", samples=(first_s,))
                yield Figure(what=f"warm spawn, {count} {kind}", unit="s", samples=tuple(later_s))


def _measure_commands(
    robots: dict[str, Path], rounds: int, count: int, *, is_short: bool
) -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as cache:
        commands = {
            "zensim --version": ("-m", "zensim", "--version"),
            "zensim --help": ("-m", "zensim", "--help"),
            "zensim model box_bot": ("-m", "zensim", "model", "box_bot"),
            f"zensim model, {count} STL": ("-m", "zensim", "model", str(robots["STL"])),
            f"zensim model, {count} DAE": ("-m", "zensim", "model", str(robots["DAE"])),
            "floor: interpreter": ("-c", "pass"),
        }
        samples: dict[str, list[float]] = {what: [] for what in commands}
        for _ in range(rounds):
            for what, arguments in commands.items():
                samples[what].append(_measure_cpu_s(arguments, None if is_short else cache))
    for what in commands:
        yield Figure(
            what=what, unit="CPU s", samples=tuple(samples[what] if is_short else samples[what][1:])
        )


def _measure_cpu_s(arguments: tuple[str, ...], cache: str | None) -> float:
    """Measure a command, with byte code in a folder, as of an installed package, or as it is."""
    environment = {**os.environ}
    if cache is not None:
        environment |= {"PYTHONPYCACHEPREFIX": cache, "PYTHONDONTWRITEBYTECODE": ""}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True, env=environment
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _spawn_s(client: SimClient, robot: Path, number: int) -> float:
    start_s = time.perf_counter()
    payload = read_payload(str(robot))
    send_files(client, payload.bundle)
    order = SpawnEntityOrder(f"meshes{number}", snap_to_ground=True)
    client.spawn(add_payload(payload, order, ""))
    took_s = time.perf_counter() - start_s
    client.delete(order.name)
    return took_s


def _make_stl_files(count: int) -> dict[str, bytes]:
    random = np.random.default_rng(0)
    files = {}
    for number in range(count):
        points = random.normal(size=(CORNERS, 3))
        corners = points / np.linalg.norm(points, axis=1)[:, None]
        files[f"{number}.stl"] = write_corners(corners.reshape(-1, 3, 3))
    return files


def _make_dae_files(count: int) -> dict[str, bytes]:
    random = np.random.default_rng(0)
    files = {}
    for number in range(count):
        data = large_robot.a_ball(random).export(file_type="dae")
        assert isinstance(data, bytes)
        files[f"{number}.dae"] = data
    return files


def _write_robot(folder: Path, files: dict[str, bytes]) -> Path:
    parts = []
    for number, (name, data) in enumerate(files.items()):
        (folder / name).write_bytes(data)
        parts.append(LINK.format(number, name.rpartition(".")[2]))
        if number:
            parts.append(JOINT.format(number))
    robot = folder / f"{Path(next(iter(files))).suffix[1:]}.urdf"
    robot.write_text(f'<robot name="meshes">{"".join(parts)}</robot>')
    return robot
