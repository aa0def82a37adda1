"""A journal that is damaged

A server with robots is killed; its journal is copied, and one file of the copy is cut at a random
place or has one bit flipped. `zensim journal verify` must accept it or report the error in one
line; on every twentieth copy a server is started, which must start or exit with one line. Then the
same with the mesh file of one of some robots: `verify` must name it, and a server must start with
all other robots.
"""

import random
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import trimesh

from benchmarks.figures import Figure, Limit
from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import command_line, end, eventually, free_endpoint, zensim
from zensim.sim_server.journal.sqlite_store import FILES

COPIES, COPIES_WHEN_SHORT = 200, 1
STARTED_EVERY = 20
ROBOTS = 10
MESHED = 5
SEED = 41
START_S = 30.0
MESH_ROBOT = """<robot name="meshed"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="{file}"/></geometry></collision></link></robot>
"""

Damage = Callable[[bytes, random.Random], bytes]


def cut(data: bytes, chance: random.Random) -> bytes:
    """Cut a file at a random place."""
    return data[: chance.randrange(len(data))]


def flip(data: bytes, chance: random.Random) -> bytes:
    """Flip one bit."""
    found = bytearray(data)
    found[chance.randrange(len(found))] ^= 1 << chance.randrange(8)
    return bytes(found)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Damage copies of a journal."""
    copies = COPIES_WHEN_SHORT if is_short else COPIES
    with tempfile.TemporaryDirectory() as scratch:
        whole = Path(scratch, "whole")
        _fill(whole)
        for what, damage in (("cut", cut), ("with a flipped bit", flip)):
            faults, refused = _damage_copy(whole, Path(scratch), damage, copies)
            yield Figure(
                what=f"journals {what} that led to anything but a start or one line, of {copies}",
                unit="",
                samples=(float(faults),),
                limit=Limit("max", "<=", 0.0),
            )
            yield Figure(
                what=f"journals {what} that were refused", unit="", samples=(float(refused),)
            )
        yield from _damage_meshes(Path(scratch), copies)


def _damage_meshes(scratch: Path, copies: int) -> Iterator[Figure]:
    whole = scratch / "meshes"
    _fill_with_meshes(whole, scratch)
    for what, damage in (("cut", cut), ("with a flipped bit", flip)):
        silent, lost, starts = _damage_mesh_of_copy(whole, scratch, damage, copies)
        yield Figure(
            what=f"mesh files {what} that `verify` did not name, of {copies}",
            unit="",
            samples=(float(silent),),
            limit=Limit("max", "<=", 0.0),
        )
        yield Figure(
            what=f"starts of {starts} with a mesh file {what} without exactly the others",
            unit="",
            samples=(float(lost),),
            limit=Limit("max", "<=", 0.0),
        )


def _fill_with_meshes(folder: Path, scratch: Path) -> None:
    """Fill a journal with robots of one mesh file each."""
    with serving_with_journal(folder, free_endpoint()) as server:
        for number in range(MESHED):
            mesh = scratch / f"m{number}.stl"
            trimesh.creation.box((0.5, 0.5, 0.5 + 0.1 * number)).export(mesh)
            robot = scratch / f"m{number}.urdf"
            robot.write_text(MESH_ROBOT.format(file=mesh.name))
            placed = ("--name", f"m{number}", "-x", str(3 * number), "-z", "1")
            done = server.zensim("spawn", str(robot), *placed)
            assert done.returncode == 0, done.stderr
        kill_hard(server)


def _damage_mesh_of_copy(
    whole: Path, scratch: Path, damage: Damage, copies: int
) -> tuple[int, int, int]:
    """Damage one mesh file in each copy; count what is silent, lost and started."""
    chance, silent, lost, starts = random.Random(SEED), 0, 0, 0
    for number in range(copies):
        folder = scratch / "copy"
        shutil.copytree(whole, folder)
        chosen = chance.choice(sorted((folder / FILES).iterdir()))
        chosen.write_bytes(damage(chosen.read_bytes(), chance))
        done = zensim("journal", "verify", str(folder))
        silent += done.returncode != 1 or chosen.name not in done.stderr + done.stdout
        if number % STARTED_EVERY == 0:
            starts += 1
            with serving_with_journal(folder, free_endpoint()) as server:
                lost += len(server.client.entities()) != MESHED - 1
        shutil.rmtree(folder)
    return silent, lost, starts


def _fill(folder: Path) -> None:
    with serving_with_journal(folder, free_endpoint()) as server:
        server.zensim("fleet", "box_bot", "--robots", str(ROBOTS))
        for i in range(ROBOTS):
            if i % 4 == 0:
                server.client.delete(f"box_bot{i}")
        begin = server.steps()
        eventually(lambda: server.steps() > begin + 240, 10.0, "a second")
        kill_hard(server)


def _damage_copy(whole: Path, scratch: Path, damage: Damage, copies: int) -> tuple[int, int]:
    chance, faults, refused = random.Random(SEED), 0, 0
    for number in range(copies):
        folder = scratch / "copy"
        shutil.copytree(whole, folder)
        files = sorted(path for path in folder.rglob("*") if path.is_file() and _is_kept(path))
        chosen = chance.choice([path for path in files if path.stat().st_size])
        chosen.write_bytes(damage(chosen.read_bytes(), chance))
        done = zensim("journal", "verify", str(folder))
        faults += not _is_clear(done.returncode, done.stderr)
        refused += done.returncode != 0
        if number % STARTED_EVERY == 0:
            faults += not _starts_or_says_why(folder)
        shutil.rmtree(folder)
    return faults, refused


def _is_kept(path: Path) -> bool:
    """Whether a file is persistent; shared memory is not."""
    return not path.name.endswith("-shm")


def _is_clear(status: int, stderr: str) -> bool:
    if "Traceback" in stderr:
        return False
    return status == 0 or (status == 1 and stderr.count("\n") == 1)


def _starts_or_says_why(folder: Path) -> bool:
    command = command_line(["serve", "--listen", free_endpoint(), "--journal", str(folder)])
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    said: list[str] = []
    try:
        assert process.stderr is not None
        for line in process.stderr:
            said.append(line)
            if line.startswith("zensim serve: world "):
                return True
        return _is_clear(process.wait(START_S), said[-1] if said else "")
    finally:
        end(process)
