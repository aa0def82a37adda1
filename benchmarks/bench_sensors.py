"""Sensors

box_bot_lidars with 360 rays each, which stand without agents, except in the cases of `zensim up`:
there one process drives nothing and subscribes to all scans, imu, odometry and tf. Server, sensor
processes and the listener are separate processes, at real-time factor 1; CPU is in cores, a sample
is a second. Turns with and without the listener alternate. First scan: from a subscription until
the first scan of any robot.
"""

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import msgspec

from benchmarks.figures import Figure, table
from benchmarks.fleet_server import program
from benchmarks.machine import used_s
from benchmarks.scan_listener import SCAN_TALLY, ScanTally
from benchmarks.ten_robots import MILLISECONDS, poll_until
from benchmarks.up_programs import find_programs
from tests.integration.processes import (
    START_S,
    connected,
    eventually,
    free_endpoint,
    kill,
    read_json_line,
    running,
    serving,
)
from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.topic_catalog import SCAN
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_client import read_payload, spawn_many
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

__all__ = ["rows", "table"]

MODEL = "box_bot_lidar"
RATE = "<update_rate>10</update_rate>"
SPACING_M = 1.2
SECONDS, SECONDS_WHEN_SHORT = 10.0, 1.0
TURNS, TURNS_WHEN_SHORT = 3, 1
FIRST_SCANS, FIRST_SCANS_WHEN_SHORT = 20, 1
TALLIES = 64
MANY = 10
"""Robots up to which each has an agent and its own physics."""


@dataclass(frozen=True)
class FleetCase:
    """Robots of one server, and how many processes measure for them."""

    label: str
    robots: int
    rate_hz: float
    serve: tuple[str, ...]
    processes: int = 1


COARSE = ("--step-hz", "100", "--dynamics", "auto")
CASES = (
    FleetCase("100 robots at 10 Hz, warehouse", 100, 10.0, ("--world", "warehouse", *COARSE)),
    FleetCase("1000 robots at 5 Hz, empty", 1000, 5.0, COARSE),
    FleetCase("1000 robots at 5 Hz, empty, 2 processes", 1000, 5.0, COARSE, 2),
)
CASES_WHEN_SHORT = (FleetCase("2 robots at 10 Hz", 2, 10.0, ("--world", "warehouse")),)


@dataclass
class Spent:
    """What each second cost."""

    factors: list[float] = field(default_factory=list)
    cores: dict[str, list[float]] = field(default_factory=dict)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure fleets with listeners, idle processes, the first scan, and `zensim up`."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    for case in CASES_WHEN_SHORT if is_short else CASES:
        yield from _fleet_figures(case, seconds, is_short=is_short)
    if not is_short:  # benchmark `everything` also starts `zensim up` with lidars
        yield from _up_figures(10, (), seconds)
        pooled = ("--agents", "pooled", "--layout", "grid", "--odom-hz", "10", "--tf-hz", "10")
        yield from _up_figures(100, pooled, seconds)


@dataclass
class FleetTrial:
    """What a fleet cost, without and with a process that subscribes to everything."""

    idle: Spent = field(default_factory=Spent)
    subscribed: Spent = field(default_factory=Spent)
    tallies: Sequence[ScanTally] = ()
    waits_ms: tuple[float, ...] = ()
    """Times from a subscription until a scan."""


def _fleet_figures(case: FleetCase, seconds: float, *, is_short: bool) -> Iterator[Figure]:
    with serving(*case.serve) as server, ExitStack() as stack:
        _spawn(server.client, case)
        sensors = [
            stack.enter_context(running("sensors", "run", "--quiet", "--connect", server.endpoint))
            for _ in range(case.processes)
        ]
        pids: dict[str, tuple[int, ...]] = {"server": (server.process.pid,)}
        pids |= {f"sensors {number}": (one.pid,) for number, one in enumerate(sensors)}
        _wait_for_processes(server.bus, case.processes)
        turns = TURNS_WHEN_SHORT if is_short else TURNS
        trial = _try_fleet(server.bus, server.client, pids, [seconds / turns] * turns)
        scans = FIRST_SCANS_WHEN_SHORT if is_short else FIRST_SCANS
        trial.waits_ms = tuple(_first_scan_ms(server.bus) for _ in range(scans))
    yield from _case_figures(case, trial)


def _try_fleet(
    bus: Bus, client: SimClient, pids: dict[str, tuple[int, ...]], turns_s: Sequence[float]
) -> FleetTrial:
    """Measure turns of these lengths without and with subscribers."""
    trial = FleetTrial()
    for seconds in turns_s:
        _spend(client, pids, seconds, trial.idle)
        with _listener(bus) as found:
            _spend(client, pids, seconds, trial.subscribed)
            trial.tallies = found.tallies()
        _wait_until_idle(bus)
    return trial


def _sum_sensors(spent: Spent) -> tuple[float, ...]:
    """Sum the CPU of all sensor processes in each second [cores]."""
    used = [cores for group, cores in spent.cores.items() if group.startswith("sensors")]
    return tuple(map(sum, zip(*used, strict=True)))


def _case_figures(case: FleetCase, trial: FleetTrial) -> Iterator[Figure]:
    name = f"{case.label}: "
    for when, spent in (("no subscribers", trial.idle), ("all subscribed", trial.subscribed)):
        cores = _sum_sensors(spent)
        yield Figure(what=f"{name}CPU, sensors, {when}", unit="cores", samples=cores)
        server = tuple(spent.cores["server"])
        yield Figure(what=f"{name}CPU, server, {when}", unit="cores", samples=server)
        yield Figure(what=f"{name}real-time factor, {when}", unit="", samples=tuple(spent.factors))
    first = f"{name}first scan after a subscription"
    yield Figure(what=first, unit="ms", samples=trial.waits_ms)
    yield Figure(what=f"{name}scans received", unit="Hz", samples=_scan_rates(trial.tallies))


def _up_figures(robots: int, options: tuple[str, ...], seconds: float) -> Iterator[Figure]:
    """Measure `zensim up` with everything subscribed."""
    endpoint, spent = free_endpoint(), Spent()
    arguments = ("--robots", str(robots), "--model", MODEL, "--world", "warehouse", "--no-viewer")
    with running(
        "up", *arguments, "--listen", endpoint, "--json", *_pace(robots), *options
    ) as process:
        read_json_line(process)
        with connected(endpoint, process) as bus, _listener(bus) as found:
            _wait_until_heard(found, robots)
            pids = {group: found for group, found in find_programs(process).items() if found}
            _spend(SimClient(bus), pids, seconds, spent)
            tallies = list(found.tallies())
            resumed_s = _kill_sensors(bus, pids["sensors"])
    name = f"zensim up, {robots} robots: "
    yield Figure(what=f"{name}real-time factor", unit="", samples=tuple(spent.factors))
    cores = tuple(map(sum, zip(*spent.cores.values(), strict=True)))
    yield Figure(what=f"{name}CPU, all programs", unit="cores", samples=cores)
    yield Figure(what=f"{name}scans received", unit="Hz", samples=_scan_rates(tallies))
    again = f"{name}scans again after kill -9 of the sensor process"
    yield Figure(what=again, unit="s", samples=(resumed_s,))


def _kill_sensors(bus: Bus, pids: Sequence[int]) -> float:
    """Kill the sensor processes; return the time until there are scans again [s]."""
    scans = bus.subscribe(SCAN.key("*"), TALLIES)
    poll_until(scans.newest)
    for pid in pids:
        kill(pid, signal.SIGKILL)
    pattern = keys.active_sensors("default", "*")
    eventually(lambda: not bus.list_tokens(pattern), START_S, "the end of the sensor processes")
    scans.take()
    killed_s = time.monotonic()
    poll_until(scans.newest, START_S)
    return time.monotonic() - killed_s


def _pace(robots: int) -> tuple[str, ...]:
    """Use kinematic robots where many stand in one world."""
    return ("--dynamics", "auto") if robots > MANY else ()


def _spawn(client: SimClient, case: FleetCase) -> None:
    text = read_builtin_model(MODEL).replace(RATE, f"<update_rate>{case.rate_hz:g}</update_rate>")
    payload = msgspec.structs.replace(read_payload(MODEL), text=text)
    places = make_fleet_layout("r", case.robots, "grid", SPACING_M)
    outcomes = spawn_many(client, payload, places, SpawnEntityOrder())
    if refused := [outcome for outcome in outcomes if outcome.message]:
        raise RuntimeError(f"{len(refused)} robots were refused, first {refused[0]}")


class ScanListener:
    """Counts of a process that subscribes to everything."""

    def __init__(self, bus: Bus) -> None:
        self._samples = bus.subscribe(SCAN_TALLY, TALLIES)
        self._taken: list[ScanTally] = []

    def tallies(self) -> list[ScanTally]:
        """List the counts of all seconds so far."""
        self._taken += [
            msgspec.msgpack.decode(one.payload, type=ScanTally) for one in self._samples.take()
        ]
        return self._taken


@contextmanager
def _listener(bus: Bus) -> Iterator[ScanListener]:
    found = ScanListener(bus)
    with program("scan_listener", bus.endpoint):
        _wait_until_heard(found, 1)
        yield found


def _wait_until_heard(found: ScanListener, scans: int) -> None:
    eventually(lambda: any(one.scans >= scans for one in found.tallies()), START_S, "scans of all")


def _spend(
    client: SimClient, pids: dict[str, tuple[int, ...]], seconds: float, spent: Spent
) -> None:
    """Add what each second costs."""
    samples = [_sample(client, pids)]
    for _ in range(max(1, round(seconds))):
        time.sleep(1.0)
        samples.append(_sample(client, pids))
    for (wall_s, time_s, used), (later_s, later_time_s, later_used) in pairwise(samples):
        lasted_s = later_s - wall_s
        spent.factors.append((later_time_s - time_s) / lasted_s)
        for group, before_s in used.items():
            cores = (later_used[group] - before_s) / lasted_s
            spent.cores.setdefault(group, []).append(cores)


def _sample(
    client: SimClient, pids: dict[str, tuple[int, ...]]
) -> tuple[float, float, dict[str, float]]:
    used = {group: sum(map(used_s, found)) for group, found in pids.items()}
    return time.monotonic(), client.info().sim_time_s, used


def _wait_for_processes(bus: Bus, count: int) -> None:
    pattern = keys.alive_sensors("default", "*")
    eventually(lambda: len(bus.list_tokens(pattern)) == count, START_S, "sensor processes")


def _wait_until_idle(bus: Bus) -> None:
    pattern = keys.active_sensors("default", "*")
    eventually(lambda: not bus.list_tokens(pattern), START_S, "the end of the stream")


def _first_scan_ms(bus: Bus) -> float:
    """Subscribe; return the time until a scan comes [ms]."""
    began_s = time.monotonic()
    scans = bus.subscribe(SCAN.key("*"), TALLIES)
    poll_until(scans.newest)
    took_ms = (time.monotonic() - began_s) * MILLISECONDS
    scans.close()
    _wait_until_idle(bus)
    return took_ms


def _scan_rates(tallies: Sequence[ScanTally]) -> tuple[float, ...]:
    return tuple(
        (after.scans - before.scans) / (after.wall_s - before.wall_s)
        for before, after in pairwise(tallies)
    ) or (0.0,)
