"""Light commands

CPU time, user and system, of one process per sample: the root options of `zensim`, and `zensim
model` of a robot without meshes and of one with 14 MB of them (20 STL files of spheres, each a
collision and a visual). Commands and floor take turns, so that they see the same machine; one round
before is not counted. Floor: an interpreter that runs `pass`.
"""

import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.figures import Figure, Limit, table
from zensim.proto.stl import write_corners

__all__ = ["rows", "table"]

ROUNDS = 10
MESHES = 20
CORNERS = 42_000
"""Of each mesh: 14,000 triangles, 0.7 MB."""
LINK = (
    '<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    '<visual><geometry><mesh filename="{0}.stl"/></geometry></visual>'
    '<collision><geometry><mesh filename="{0}.stl"/></geometry></collision></link>'
)
JOINT = '<joint name="j{0}" type="continuous"><parent link="l0"/><child link="l{0}"/></joint>'


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each command in turns with the floor."""
    rounds, count = (1, 1) if is_short else (ROUNDS + 1, MESHES)
    with tempfile.TemporaryDirectory() as folder:
        robot = _write_robot(Path(folder), count)
        commands = {
            "zensim --version": (("-m", "zensim", "--version"), 0.15),
            "zensim --help": (("-m", "zensim", "--help"), 0.15),
            "zensim model box_bot": (("-m", "zensim", "model", "box_bot"), 0.35),
            f"zensim model, {count} meshes": (("-m", "zensim", "model", str(robot)), 1.5),
            "floor: interpreter": (("-c", "pass"), None),
        }
        samples: dict[str, list[float]] = {what: [] for what in commands}
        for _ in range(rounds):
            for what, (arguments, _) in commands.items():
                samples[what].append(_measure_cpu_s(arguments))
    for what, (_, bound) in commands.items():
        yield Figure(
            what=what,
            unit="CPU s",
            samples=tuple(samples[what] if is_short else samples[what][1:]),
            limit=Limit("median", "<=", bound, is_timed=True) if bound else None,
        )


def _measure_cpu_s(arguments: tuple[str, ...]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _write_robot(folder: Path, count: int) -> Path:
    random = np.random.default_rng(0)
    for number in range(count):
        points = random.normal(size=(CORNERS, 3))
        corners = points / np.linalg.norm(points, axis=1)[:, None]
        (folder / f"{number}.stl").write_bytes(write_corners(corners.reshape(-1, 3, 3)))
    parts = [LINK.format(number) for number in range(count)]
    parts += [JOINT.format(number) for number in range(1, count)]
    robot = folder / "robot.urdf"
    robot.write_text(f'<robot name="meshes">{"".join(parts)}</robot>')
    return robot
