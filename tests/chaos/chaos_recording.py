"""A recording that is cut off

A source publishes odometry and transforms at 50 Hz; `zensim record` is killed at a random moment,
again and again. `zensim bag recover` must give all but the last moments back, in a file that mcap
reads with all checksums. Then files are cut, or have one bit flipped: each is recovered without a
traceback, and a flipped bit costs one chunk at most. At last the disk is full (a file system in
memory, where this program may mount one): the recorder must end with its status for failures, and
close a file whose counts are true.
"""

import json
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.bench_recording import TOPICS
from benchmarks.figures import Figure, Limit
from tests.chaos.chaos_damage import cut, flip
from tests.chaos.message_source import Source, publishing
from tests.integration.processes import eventually, kill, read_json_line, running
from tests.recording.recordings import count_by_mcap, write_recording
from zensim.proto.exit_codes import ExitCode
from zensim.recording.bag_info import read_info
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.recovery import recover_file

KILLS, KILLS_WHEN_SHORT = 50, 1
DAMAGED, DAMAGED_WHEN_SHORT = 200, 3
MESSAGES, IN_A_CHUNK = 3000, 100
HZ = 50.0
LONGEST_S = 3600.0
BETWEEN_S = (1.0, 3.0)
SEED = 19
TINY_DISKS = ((6, "zstd_fast"), (64, "none"))
"""Size [MB], and storage profile: without compression a minute fills the larger one, too."""
FULL_S = 600.0
NONE = Limit("max", "<=", 0.0)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill recorders, damage files, and fill disks."""
    kills = KILLS_WHEN_SHORT if is_short else KILLS
    for robots, most_s in ((10, 1.0), (100, 0.6))[: 1 if is_short else 2]:
        yield from _kill_recorders(robots, kills, most_s)
    yield from _damage_files(DAMAGED_WHEN_SHORT if is_short else DAMAGED)
    for size_mb, profile in () if is_short else TINY_DISKS:
        yield from _fill_disk(size_mb, profile)


def _kill_recorders(robots: int, kills: int, most_s: float) -> Iterator[Figure]:
    chance = random.Random(SEED)
    missing: list[float] = []
    unreadable = 0
    with publishing(robots, HZ, LONGEST_S) as source, tempfile.TemporaryDirectory() as folder:
        began_ns = 0.0
        for number in range(kills):
            path = Path(folder) / f"{number}.mcap"
            with running("record", *TOPICS, "-o", str(path), "--connect", source.endpoint) as one:
                began_ns = began_ns or source.read()["began_ns"]
                eventually(lambda: path.exists() and path.stat().st_size > 1000, 30.0)  # noqa: B023
                time.sleep(chance.uniform(*BETWEEN_S))
                kill(one.pid, signal.SIGKILL)
                killed_s = (time.time_ns() - began_ns) / 1e9
                one.wait()
            last_s = _recover(path)
            unreadable += last_s is None
            missing.append(killed_s - (last_s or 0.0))
    label = f"{robots} robots, of {kills} kills"
    limit = Limit("max", "<=", most_s, is_timed=True)
    yield Figure(what=f"data that is missing, {label}", unit="s", samples=(*missing,), limit=limit)
    yield Figure(
        what=f"files that do not open after it, {label}",
        unit="",
        samples=(float(unreadable),),
        limit=NONE,
    )


def _recover(path: Path) -> float | None:
    """Recover a file; return its last log time [s], or None if it cannot be read."""
    target = path.with_name("whole.mcap")
    target.unlink(missing_ok=True)
    result = recover_file(path, target)
    if sum(count_by_mcap(target).values()) != result.messages:
        return None
    return RecordingReader(target).end_ns / 1e9


def _damage_files(copies: int) -> Iterator[Figure]:
    chance = random.Random(SEED)
    with tempfile.TemporaryDirectory() as folder:
        whole, damaged = Path(folder) / "whole.mcap", Path(folder) / "damaged.mcap"
        write_recording(whole, MESSAGES)
        content = whole.read_bytes()
        for what, damage in (("cut", cut), ("with a flipped bit", flip)):
            lost, failures = [], 0
            for _ in range(copies):
                damaged.write_bytes(damage(content, chance))
                found = _count_recovered(damaged)
                failures += found is None
                lost.append(float(MESSAGES - (found or 0)))
            yield Figure(
                what=f"files {what} that are not recovered, of {copies}",
                unit="",
                samples=(float(failures),),
                limit=NONE,
            )
            limit = Limit("max", "<=", IN_A_CHUNK) if damage is flip else None
            label = f"messages lost of files {what}, of {MESSAGES} in chunks of {IN_A_CHUNK}"
            yield Figure(what=label, unit="", samples=(*lost,), limit=limit)


def _count_recovered(damaged: Path) -> int | None:
    """Recover a damaged file; None if other readers disagree about it, or it is refused wrongly."""
    target = damaged.with_name("recovered.mcap")
    target.unlink(missing_ok=True)
    try:
        result = recover_file(damaged, target)
    except ValueError:
        # What does not begin as an MCAP file is none.
        return None if damaged.read_bytes()[:5] == b"\x89MCAP" else 0
    return result.messages if sum(count_by_mcap(target).values()) == result.messages else None


def _fill_disk(size_mb: int, profile: str) -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder, _mounted(Path(folder), size_mb) as is_mounted:
        if not is_mounted:
            return
        with publishing(200, HZ, LONGEST_S) as source:
            wrong = _record_until_full(source, Path(folder) / "run.mcap", profile)
    yield Figure(
        what=f"disk of {size_mb} MB that is full: wrong status, closed file or counts",
        unit="",
        samples=(float(wrong),),
        limit=NONE,
    )


def _record_until_full(source: Source, path: Path, profile: str) -> int:
    """Record until the disk is full; count what is wrong then."""
    options = ("--storage-preset-profile", profile, "--json", "--min-free", "0")
    with running(
        "record", *TOPICS, "-o", str(path), "--connect", source.endpoint, *options
    ) as process:
        read_json_line(process)
        source.read()
        status = process.wait(FULL_S)
        out = process.stdout.read() if process.stdout is not None else ""
    figures = json.loads(out.splitlines()[-1])
    read = sum(count_by_mcap(path).values())
    is_closed = not read_info(path).unclosed
    return sum((status != ExitCode.FAILED, not is_closed, read != figures["messages"], not read))


@contextmanager
def _mounted(folder: Path, size_mb: int) -> Iterator[bool]:
    """Mount a file system in memory, where that is allowed."""
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False)
    except FileNotFoundError:
        yield False
        return
    try:
        yield not done.returncode
    finally:
        if not done.returncode:
            subprocess.run(["umount", str(folder)], check=True)
