"""Description of the machine, and its other load."""

import os
import platform
import subprocess
import time
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

import msgspec
import psutil

ROOT = Path(__file__).parents[1]
LIBRARIES = ("eclipse-zenoh", "pybullet", "msgspec", "numpy", "viser")


def load() -> str:
    """Format the current load average."""
    return ", ".join(f"{number:.2f}" for number in os.getloadavg())


def describe_machine() -> tuple[tuple[str, str], ...]:
    """List what a reader needs to compare figures with those of another machine."""
    return (
        ("cores", str(len(os.sched_getaffinity(0)))),
        ("CPU", _cpu_model()),
        ("memory", f"{psutil.virtual_memory().total / 2**30:.1f} GiB"),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Python", platform.python_version()),
        ("libraries", ", ".join(f"{name} {version(name)}" for name in LIBRARIES)),
    )


def describe_run() -> str:
    """Format when, and with which code, a measurement begins."""
    return (
        f"Measured {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC, zensim {version('zensim')}, "
        f"commit {_commit()}; load average before {load()} (1, 5, 15 min)."
    )


class Work(msgspec.Struct, frozen=True):
    """CPU time [s] used on this machine so far, and by this program."""

    wall_s: float
    all_s: float
    own_s: float
    """Including its exited child processes."""


def work() -> Work:
    """Read the current counters."""
    all_, own, wall_s = psutil.cpu_times(), os.times(), time.monotonic()
    # Without iowait, when a core is idle, and guest time, which user time includes.
    kinds = ("user", "nice", "system", "irq", "softirq", "steal")
    busy_s = sum(float(getattr(all_, kind, 0.0)) for kind in kinds)
    own_s = own.user + own.system + own.children_user + own.children_system
    return Work(wall_s, busy_s, own_s)


def others_cores(before: Work, after: Work) -> float:
    """Find the number of cores used by others in between."""
    others_s = (after.all_s - after.own_s) - (before.all_s - before.own_s)
    return max(0.0, others_s / (after.wall_s - before.wall_s))


def used_s(pid: int) -> float:
    """Get the CPU time [s] of all threads of a process, with nanosecond resolution."""
    # Linux clock id of another process.
    return time.clock_gettime((~pid << 3) | 2)


def thread_used_s(pid: int, thread: int) -> float:
    """Get the CPU time [s] of a thread, as of its last context switch or tick."""
    stat = Path(f"/proc/{pid}/task/{thread}/schedstat").read_text(encoding="ascii")
    return int(stat.split()[0]) * 1e-9


def _cpu_model() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _commit() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or "unknown"
