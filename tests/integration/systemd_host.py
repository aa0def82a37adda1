"""A systemd in namespaces of its own, with a root whose changes are kept in memory.

It loads units of one folder only, so nothing of the host's starts, and has a network of its own.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from tests.contract.repository import ROOT
from tests.integration.processes import eventually

SYSTEMD = Path("/lib/systemd/systemd")
CGROUPS = Path("/sys/fs/cgroup")
UNITS = "/run/units"
TARGETS = ("sysinit", "basic", "shutdown", "network-online", "multi-user")
"""That units refer to."""
# No file of the host is written: its root is the lower layer of an overlay in memory.
START = """
echo $$ >"$3/cgroup.procs"
exec unshare --pid --mount --net --ipc --uts --cgroup --fork --kill-child sh -ceu "$1" start "$2"
"""
BECOME_SYSTEMD = """
folder=$1
mount --make-rprivate /
mount -t tmpfs tmpfs "$folder/memory"
mkdir "$folder/memory/upper" "$folder/memory/work" "$folder/memory/root"
cd "$folder/memory"
mount -t overlay -o lowerdir=/,upperdir=upper,workdir=work overlay root
cd root
mount -t proc proc proc
mount -t sysfs sysfs sys
mount -t tmpfs tmpfs run
mount -t tmpfs tmpfs tmp
mount --rbind /dev dev
if [ -e /sys/fs/cgroup/cgroup.controllers ]; then
    mount -t cgroup2 cgroup2 sys/fs/cgroup
else
    mount -t tmpfs tmpfs sys/fs/cgroup
    mkdir sys/fs/cgroup/systemd
    mount -t cgroup -o none,name=systemd cgroup sys/fs/cgroup/systemd
fi
mkdir -p run/units opt/zensim/bin opt/zensim/python opt/zensim/packages opt/zensim/source etc/zensim
cp -r "$folder/units/." run/units/
cp "$folder/zensim" opt/zensim/bin/zensim
# ProtectHome= hides what lies below /root or /home, and PrivateTmp= what lies below /tmp.
mount --rbind "$PYTHON" opt/zensim/python
mount --bind "$PACKAGES" opt/zensim/packages
mount --bind "$SOURCE" opt/zensim/source
mkdir run/old
pivot_root . run/old
umount -l /run/old
ip link set lo up
exec env -i container=zensim SYSTEMD_UNIT_PATH=/run/units PATH="$PATH" /lib/systemd/systemd \
    --system --unit=multi-user.target --log-target=null --show-status=no </dev/null >/dev/null 2>&1
"""
PROGRAM = """#!/bin/sh
export LD_LIBRARY_PATH=/opt/zensim/python/lib PYTHONPATH=/opt/zensim/source:/opt/zensim/packages
exec /opt/zensim/python/bin/{python} -m zensim "$@"
"""


class SystemdHost:
    """A host that systemd runs."""

    def __init__(self, init: int) -> None:
        self._init = init

    def run(self, *words: str) -> "subprocess.CompletedProcess[str]":
        """Run a command on the host, as root."""
        entered = ("nsenter", f"--target={self._init}", "--all")
        return subprocess.run(
            [*entered, *words],
            capture_output=True,
            text=True,
            timeout=280,
            check=False,
            stdin=subprocess.DEVNULL,
            env={"PATH": os.environ["PATH"]},  # no process of this host is its parent
        )

    def zensim(self, *words: str) -> "subprocess.CompletedProcess[str]":
        """Run the installed command."""
        return self.run("/opt/zensim/bin/zensim", *words)

    def write(self, path: str, text: str) -> None:
        """Write a file of the host."""
        self.run("sh", "-c", 'printf %s "$2" >"$1"', "write", path, text)

    def show(self, unit: str) -> dict[str, str]:
        """Show what systemd knows of a unit."""
        lines = self.run("systemctl", "show", unit).stdout.splitlines()
        return dict(line.split("=", 1) for line in lines)


@contextmanager
def systemd_host(folder: Path, *units: Path) -> Iterator[SystemdHost]:
    """Start systemd with units; all that it started ends with it.

    Args:
        folder: Empty.
        units: Files that are copied, with drop-ins of the same name beside them.
    """
    assert SYSTEMD.exists(), "systemd is not installed: make packages"
    _write_files(folder, units)
    group = _make_group()
    process = subprocess.Popen(
        ["sh", "-ceu", START, "start", BECOME_SYSTEMD, str(folder), str(group)],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "PYTHON": sys.base_prefix,
            "PACKAGES": str(Path(psutil.__file__).parents[1]),
            "SOURCE": str(ROOT),
        },
        start_new_session=True,
    )
    try:
        yield SystemdHost(_await_systemd(process))
    finally:
        process.kill()  # and with it, by --kill-child, all processes of the namespace
        process.communicate()
        eventually(lambda: _remove_groups(group), 10.0, "the end of all processes")


def _write_files(folder: Path, units: tuple[Path, ...]) -> None:
    (folder / "memory").mkdir()
    (folder / "units").mkdir()
    for name in TARGETS:
        (folder / "units" / f"{name}.target").write_text("[Unit]\nDefaultDependencies=no\n")
    for unit in units:
        shutil.copy(unit, folder / "units")
    program = folder / "zensim"
    program.write_text(PROGRAM.format(python=f"python{sys.version_info[0]}.{sys.version_info[1]}"))
    program.chmod(0o755)


def _make_group() -> Path:
    is_unified = (CGROUPS / "cgroup.controllers").exists()
    parent = CGROUPS if is_unified else CGROUPS / "systemd"
    group = parent / f"zensim-test-{os.getpid()}"
    group.mkdir()
    return group


def _remove_groups(group: Path) -> bool:
    try:
        for folder, _, _ in os.walk(group, topdown=False):
            Path(folder).rmdir()
    except OSError:  # its processes are still ending
        return False
    return True


def _await_systemd(process: "subprocess.Popen[str]") -> int:
    """Wait until systemd replies; return its process id."""

    def find() -> int | None:
        if process.poll() is not None:
            _, errors = process.communicate()
            raise AssertionError(f"systemd cannot run in namespaces here: {errors.strip()}")
        (init, *_) = [one.pid for one in psutil.Process(process.pid).children()] or [0]
        if not init:
            return None
        words = ("nsenter", f"--target={init}", "--all", "systemctl", "is-system-running")
        done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
        return init if done.stdout.strip() in ("running", "degraded") else None

    return eventually(find, 60.0, "systemd")
