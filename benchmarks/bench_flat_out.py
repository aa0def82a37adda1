"""As fast as possible

Simulated seconds per second at `zensim serve --rtf 0`, while every robot drives a circle with its
own agent, or all with one pool; a sample is a second. Floor: the same robots in the same engine, in
a loop that only steps, and in a loop that steps, reads and commands all robots each control period.
What the network costs at equal step rates is wall time of a step: served, less the floor that is
driven. CPU times of a step say who has it; those beside the loop count as far as the second core is
not enough for them. The section on fleets as fast as possible has more parts.
"""

import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from benchmarks.bodies import CONFIG, Bodies
from benchmarks.figures import Figure, Limit, table
from benchmarks.machine import thread_used_s, used_s
from benchmarks.ten_robots import MILLISECONDS, ROBOTS, Fleet, fleet
from zensim.proto.messages.standard_messages import NANOSECONDS

__all__ = ["rows", "table"]

WINDOWS = 8
FACTOR = Limit("median", ">=", 15.0)
"""Limit for ten robots, pooled and with an agent each; it is asked of those that are pooled."""
TEN = f"{ROBOTS} robots"
SERVED = {"served": False, "served, one pool": True}
"""Whether the agents are pooled."""
WINDOW_S = 1.0
WINDOW_WHEN_SHORT_S = 0.2
STEPS_AT_ONCE = 24
"""Steps between two clock readings; whole control periods."""


@dataclass
class Served:
    """Windows of a server with agents.

    Attributes:
        factors: Simulated seconds per second.
        used_ms: CPU time of a step, by part.
    """

    factors: list[float] = field(default_factory=list)
    used_ms: dict[str, list[float]] = field(default_factory=dict)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure one robot and a fleet of ten."""
    window_s = WINDOW_WHEN_SHORT_S if is_short else WINDOW_S
    windows = 1 if is_short else WINDOWS
    for robots in (1,) if is_short else (1, ROBOTS):
        served = {
            what: _serve(robots, windows, window_s, is_pooled=is_pooled)
            for what, is_pooled in SERVED.items()
            if robots > 1 or not is_pooled
        }
        bodies = Bodies(robots)
        running_agents = [_stepped(bodies.step_and_drive, window_s) for _ in range(windows)]
        bare = [_stepped(bodies.step, window_s) for _ in range(windows)]
        bodies.engine.close()
        yield from _figures("1 robot" if robots == 1 else TEN, served, running_agents, bare)


def _figures(
    label: str, served: Mapping[str, Served], driven: list[float], bare: list[float]
) -> Iterator[Figure]:
    factors = {what: one.factors for what, one in served.items()}
    for what, samples in {**factors, "floor, driven": driven, "floor, only stepped": bare}.items():
        limit = FACTOR if what in served and label == TEN else None
        yield Figure(
            what=f"{label}: {what}", unit="x real time", samples=tuple(samples), limit=limit
        )
    least = statistics.median(driven)
    for what, samples in factors.items():
        share = statistics.median(samples) / least
        yield Figure(what=f"{label}: {what} / floor, driven", unit="", samples=(share,))
        more_ms = tuple((1.0 / factor - 1.0 / least) * CONFIG.step_ns * 1e-6 for factor in samples)
        yield Figure(what=f"{label}: {what}: network, a step", unit="ms", samples=more_ms)
    for what, one in served.items():
        for part, used_ms in one.used_ms.items():
            name = f"{label}: {what}: a step, {part}"
            yield Figure(what=name, unit="CPU ms", samples=tuple(used_ms))


def _serve(robots: int, windows: int, window_s: float, *, is_pooled: bool) -> Served:
    served = Served()
    with fleet(robots, "--rtf", "0", is_pooled=is_pooled) as found:
        found.circle()
        for _ in range(windows):
            _add_window(served, found, window_s)
    return served


def _add_window(served: Served, found: Fleet, window_s: float) -> None:
    client = found.server.client
    before, before_s, start_s = _read_used(found), client.info().sim_time_s, time.perf_counter()
    time.sleep(window_s)
    after, after_s, end_s = _read_used(found), client.info().sim_time_s, time.perf_counter()
    served.factors.append((after_s - before_s) / (end_s - start_s))
    steps = (after_s - before_s) / CONFIG.step_ns * NANOSECONDS
    for part, spent_s in after.items():
        used_ms = (spent_s - before[part]) * MILLISECONDS / steps
        served.used_ms.setdefault(part, []).append(used_ms)


def _read_used(found: Fleet) -> dict[str, float]:
    """Read the CPU time of each part so far."""
    pid = found.server.process.pid
    loop_s = thread_used_s(pid, pid)
    return {
        "loop of the server": loop_s,
        "other threads of the server, and router": used_s(pid) - loop_s,
        "agents": sum(map(used_s, found.agents)),
    }


def _stepped(step: Callable[[int], None], window_s: float) -> float:
    steps, start_s = 0, time.perf_counter()
    while (elapsed_s := time.perf_counter() - start_s) < window_s:
        step(STEPS_AT_ONCE)
        steps += STEPS_AT_ONCE
    return steps * CONFIG.step_ns * 1e-9 / elapsed_s
