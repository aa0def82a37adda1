"""Description of the machine, and its other load."""

import os
import platform
import subprocess
import threading
import time
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from statistics import fmean

import msgspec
import psutil

ROOT = Path(__file__).parents[1]
STEAL_PERIOD_S = 0.25
ADDITIONS, LOOPS = 1_000_000, 3
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
    kinds = ("user", "nice", "system", "irq", "softirq")
    busy_s = sum(float(getattr(all_, kind, 0.0)) for kind in kinds)
    own_s = own.user + own.system + own.children_user + own.children_system
    return Work(wall_s, busy_s, own_s)


def others_cores(before: Work, after: Work) -> float:
    """Find the number of cores used by others in between."""
    others_s = (after.all_s - after.own_s) - (before.all_s - before.own_s)
    return max(0.0, others_s / (after.wall_s - before.wall_s))


class StealWatch:
    """Notes what share of its cores a virtual machine does not get from its host.

    Threads that may run wait meanwhile, which shows as gaps and late steps.
    """

    def __init__(self) -> None:
        """Begin to watch, in a thread."""
        self._shares: list[float] = []
        self._has_ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def end(self) -> str:
        """End, and format the mean and the worst share."""
        self._has_ended.set()
        self._thread.join()
        if not self._shares:
            return "0.0% of its cores"
        mean, worst = fmean(self._shares), max(self._shares)
        return f"{mean:.1%} of its cores, {worst:.0%} in the worst quarter of a second"

    def _watch(self) -> None:
        cores = os.cpu_count() or 1
        before_s, stolen_s = time.monotonic(), _read_stolen_s()
        while not self._has_ended.wait(STEAL_PERIOD_S):
            now_s, now_stolen_s = time.monotonic(), _read_stolen_s()
            self._shares.append((now_stolen_s - stolen_s) / (now_s - before_s) / cores)
            before_s, stolen_s = now_s, now_stolen_s


def _read_stolen_s() -> float:
    """Read the time [s] that all cores waited for their host; 0 where none is reported."""
    return float(getattr(psutil.cpu_times(), "steal", 0.0))


def time_additions_ms() -> tuple[float, ...]:
    """Time a loop of Python a few times [CPU ms]: virtual machines differ from hour to hour."""
    return tuple(_time_loop_ms() for _ in range(LOOPS))


def describe_additions(times_ms: tuple[float, ...]) -> str:
    """Format such times of before and after a run as a sentence."""
    span = f"{min(times_ms):.0f} to {max(times_ms):.0f} ms"
    return f"A million additions in Python took {span} of CPU time before and after."


def _time_loop_ms() -> float:
    began_s, total = time.thread_time(), 0
    for number in range(ADDITIONS):
        total += number
    return (time.thread_time() - began_s) * 1e3


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
