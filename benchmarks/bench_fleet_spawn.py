"""Fleets: spawning

One request spawns all box_bots in one step or none, while a robot far away drives at real-time
factor 1: with `--dynamics auto` at 100 Hz and with MuJoCo at 100 Hz, which two cores can pace, and
with full dynamics of PyBullet at 240 Hz, which they cannot. `longest wait` is the greatest delay of
the robot's next state, in an equal time before the request (quiet) and from request to reply.
Memory is that of the server and of the processes that step its cells (USS), before and after.
Floor: the same bodies added to PyBullet. Then `zensim fleet --robots 20000`, from exec to its end,
by two requests. Last: two pools run and users command every robot at 2 Hz
before it exists; from the start of `zensim fleet` until each robot's odometry shows motion.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import msgspec
import psutil

from benchmarks.bench_fleet_traffic import POOLS, pool
from benchmarks.bodies import CONFIG
from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_server import FleetServer, run_fleet_server
from benchmarks.fleet_users import Tally
from benchmarks.installation import run_fleet_users, run_installation
from benchmarks.lateness import Lateness, record_lateness
from benchmarks.pybullet_floor import PlainLoop
from benchmarks.ten_robots import SPACING_M, milliseconds, poll_until, spawn
from tests.integration.processes import zensim
from zensim.proto.bus import BusSubscription
from zensim.proto.messages.simulation_messages import State

__all__ = ["rows", "table"]

RUNS = 2
FULL, AUTO, MUJOCO = "full, 240 Hz", "dynamics auto, 100 Hz", "MuJoCo, full, 100 Hz"
AUTO_ARGUMENTS = ("--dynamics", "auto", "--step-hz", "100")
MUJOCO_ARGUMENTS = ("--engine", "mujoco", "--step-hz", "100")
COUNTS, COUNTS_WHEN_SHORT = (100, 1000), (2,)
LARGEST = 10_000
TWO_REQUESTS = 20_000
KIBIBYTES, SECONDS = 1.0 / 1024.0, 1e-3
GOAL = 1000
SPAWNED = {GOAL: Limit("median", "<=", 3.0), LARGEST: Limit("median", "<=", 8.0)}
ALL_SPAWNED = Limit("max", "<=", 20.0, is_timed=True)
WAITED = Limit("max", "<=", 50.0)
MEMORY = Limit("median", "<=", 150.0)
MOVED = Limit("max", "<=", 10.0)
COMMANDS_HZ = 2.0
CROWD_S = 60.0
FAR_M, APART_M = 1000.0, 1.0
"""Distance of fleets from the driving robot, and from each other per size [m]."""


@dataclass
class Spawns:
    """Durations and memory of fleets of one size."""

    took_s: list[float] = field(default_factory=list)
    quiet_ms: list[float] = field(default_factory=list)
    waited_ms: list[float] = field(default_factory=list)
    robot_kib: list[float] = field(default_factory=list)
    floor_s: list[float] = field(default_factory=list)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure spawning of fleets, and the time until they move."""
    if is_short:
        yield from _spawned(FULL, (), COUNTS_WHEN_SHORT, runs=1)
        yield from _moved(2, pools=1, runs=1)
    else:
        yield from _spawned(AUTO, AUTO_ARGUMENTS, (*COUNTS, LARGEST), runs=RUNS)
        yield from _spawned(MUJOCO, MUJOCO_ARGUMENTS, COUNTS, runs=RUNS)
        yield from _spawned(FULL, (), COUNTS, runs=1)
        yield _spawned_by_command(TWO_REQUESTS)
        yield from _moved(GOAL, pools=POOLS, runs=RUNS)


def _spawned(
    how: str, serve: tuple[str, ...], counts: tuple[int, ...], *, runs: int
) -> Iterator[Figure]:
    """Spawn fleets of two sizes next to each other."""
    seen = {count: Spawns() for count in counts}
    for _ in range(runs):
        with (
            run_fleet_server(1, "--rtf", "1", *serve) as server,
            record_lateness(server.client.bus) as lateness,
        ):
            for count, spawns in seen.items():
                _spawn(server, lateness, count, spawns)
        for count, spawns in seen.items():
            spawns.floor_s.append(_floor_s(count))
    for count, spawns in seen.items():
        yield from _figures(f"{count} robots, {how}", spawns, count)


def _spawn(server: FleetServer, lateness: Lateness, count: int, spawns: Spawns) -> None:
    """Spawn a fleet while time runs, then pause: large fleets may not run in real time."""
    client = server.client
    before = _held(server)
    client.set_simulation_state(State.PLAYING)
    quiet_s = spawns.took_s[-1] if spawns.took_s else 1.0
    time.sleep(quiet_s)
    start_s = time.perf_counter()
    spawn(client, count, prefix=f"of{count}_", at=(FAR_M, count * APART_M))
    end_s = time.perf_counter()
    client.set_simulation_state(State.PAUSED)
    held = _held(server) - before
    spawns.took_s.append(end_s - start_s)
    spawns.quiet_ms.append(lateness.longest_ms(start_s - quiet_s, start_s))
    spawns.waited_ms.append(lateness.longest_ms(start_s, end_s))
    spawns.robot_kib.append(held / count * KIBIBYTES)


def _spawned_by_command(count: int) -> Figure:
    """Measure `zensim fleet` of a number of kinematic robots."""
    arguments = ("--robots", str(count), "--layout", "grid", "--spacing", str(SPACING_M))
    with run_installation(("--dynamics", "kinematic", "--step-hz", "20"), ()) as crew:
        start_s = time.monotonic()
        done = zensim("fleet", "box_bot", *arguments, "--connect", crew.bus.endpoint)
        took_s = time.monotonic() - start_s
        if done.returncode or crew.client.info().entities != count:
            raise RuntimeError(f"the fleet is not complete: {done.stderr}")
    return Figure(
        what=f"{count} robots, kinematic: fleet command to its end",
        unit="s",
        samples=(took_s,),
        limit=ALL_SPAWNED,
    )


def _held(server: FleetServer) -> int:
    """Get the memory [bytes] unique to the server's processes (USS)."""
    process = psutil.Process(server.process.pid)
    family = (process, *process.children(recursive=True))
    return sum(one.memory_full_info().uss for one in family)


def _moved(count: int, *, pools: int, runs: int) -> Iterator[Figure]:
    """Measure from `zensim fleet` until every robot has moved on its command."""
    seen = [_all_moved(count, pools) for _ in range(runs)]
    label = f"{count} robots, {AUTO}, {pools} pools"
    yield Figure(
        what=f"{label}: fleet command to all have moved",
        unit="s",
        samples=tuple(took_s for took_s, _ in seen),
        limit=MOVED if count == GOAL else None,
    )
    yield Figure(
        what=f"{label}: moved on their own cmd_vel",
        unit="",
        samples=tuple(moved for _, moved in seen),
        limit=Limit("min", ">=", count),
    )


def _all_moved(count: int, pools: int) -> tuple[float, int]:
    """Return the time [s] until all moved or the timeout, and how many moved."""
    arguments = ("--robots", str(count), "--layout", "grid", "--spacing", str(SPACING_M))
    with (
        run_installation(AUTO_ARGUMENTS, (pool(10.0),) * pools) as crew,
        run_fleet_users(crew.bus, count, COMMANDS_HZ) as (tallies, _),
    ):
        poll_until(tallies.newest, CROWD_S)
        start_s = time.monotonic()
        done = zensim("fleet", "box_bot", *arguments, "--connect", crew.bus.endpoint)
        if done.returncode:
            raise RuntimeError(f"no fleet was spawned: {done.stderr}")
        while True:
            tally = poll_until(lambda: _newest(tallies), CROWD_S)
            if tally.moved == count or tally.wall_s > start_s + CROWD_S:
                return tally.wall_s - start_s, tally.moved


def _newest(tallies: BusSubscription) -> Tally | None:
    sample = tallies.newest()
    return None if sample is None else msgspec.msgpack.decode(sample.payload, type=Tally)


def _floor_s(count: int) -> float:
    loops: list[PlainLoop] = []

    def build() -> None:
        loops.append(PlainLoop(count, step_ns=CONFIG.step_ns, control_steps=CONFIG.control_steps))

    took_ms = milliseconds(build)
    loops[0].close()
    return took_ms * SECONDS


def _figures(label: str, spawns: Spawns, count: int) -> Iterator[Figure]:
    is_goal = count == GOAL
    yield Figure(
        what=f"{label}: request to all spawned",
        unit="s",
        samples=tuple(spawns.took_s),
        limit=SPAWNED.get(count),
    )
    floor = tuple(spawns.floor_s)
    yield Figure(what=f"{label}: floor, put into PyBullet", unit="s", samples=floor)
    quiet = tuple(spawns.quiet_ms)
    yield Figure(what=f"{label}: longest wait, quiet", unit="ms", samples=quiet)
    yield Figure(
        what=f"{label}: longest wait, spawning",
        unit="ms",
        samples=tuple(spawns.waited_ms),
        limit=WAITED if is_goal else None,
    )
    yield Figure(
        what=f"{label}: memory a robot",
        unit="KiB",
        samples=tuple(spawns.robot_kib),
        limit=MEMORY if is_goal else None,
    )
