"""Start of a fleet by one command

`zensim up --json` with box_bots that move in `auto` dynamics, two pools, the ROS 2 face on, no
page: from the exec to the line that says that agents drive every robot. `own memory` is the most
that the process of `zensim up` itself had resident by then, without server and pools. Floor: the
same with one robot in one pool.
"""

import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure, Limit, table
from tests.integration.processes import free_endpoint, read_json_line, running

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = (1, 2000, 10_000), (2,)
RUNS = 3
SPACING_M = 2.0
LIMITS_S = {2000: 5.0, 10_000: 18.0}
MOST_MB = 80.0
MEGABYTE = 1e6
KIB = 1024


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure starts of several sizes."""
    for count in ROBOTS_WHEN_SHORT if is_short else ROBOTS:
        runs = [_run(count) for _ in range(1 if is_short else RUNS)]
        bound = LIMITS_S.get(count)
        what = f"{count} robot{'s' * (count > 1)}"
        yield Figure(
            what=f"{what}: exec to ready",
            unit="s",
            samples=tuple(ready_s for ready_s, _ in runs),
            limit=None if bound is None else Limit("median", "<=", bound, is_timed=True),
        )
        yield Figure(
            what=f"{what}: own memory",
            unit="MB",
            samples=tuple(megabytes for _, megabytes in runs),
            limit=Limit("max", "<=", MOST_MB),
        )


def _run(count: int) -> tuple[float, float]:
    """Start a fleet; return the time until it was ready [s], and the memory of `up` [MB]."""
    arguments = (
        *("up", "--json", "--listen", free_endpoint(), "--robots", str(count)),
        *("--dynamics", "auto", "--layout", "grid", "--spacing", f"{SPACING_M:g}"),
        *("--agents", "pooled", "--no-viewer"),
    )
    began_s = time.perf_counter()
    with running(*arguments) as up:
        read_json_line(up)
        return time.perf_counter() - began_s, _read_peak_bytes(up.pid) / MEGABYTE


def _read_peak_bytes(pid: int) -> int:
    """Read the most memory that a process had resident."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    (line,) = (one for one in lines if one.startswith("VmHWM"))
    return int(line.split()[1]) * KIB
