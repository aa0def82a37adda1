"""`python -m tests.interop [NAME ...] [--short] [--build]`: run ROS 2 peers without code of zensim.

The page docs/interop.md is written only when everything ran at full length; the status is 1 when a
figure was missed. Without cargo nothing runs; `INTEROP=require` makes that an error. With
`INTEROP=cached` nothing is built, and nothing runs without a build: CI has no time for one.
`--build` only builds what the run needs; that of rclpy and its bridge, ten minutes and more, has to
be named: `rclpy --build`. The section of rclpy is left out where these cannot be had.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from importlib import import_module

from benchmarks.benchmark_report import Section
from benchmarks.document_command import Document
from benchmarks.figures import Figure, missed_among, table
from benchmarks.machine import ROOT
from tests.interop.foreign_peers import HUMBLE, JAZZY
from tests.interop.peer_build import (
    BUILD_S,
    SHORT_BUILD_S,
    PeersMissing,
    build_peers,
    build_router,
    cache_folder,
    find_peers,
)
from tests.interop.ros_build import build_ros

NAMES = (
    "talk",
    "graph",
    "odom",
    "tf",
    "late",
    "drive",
    "spawn",
    "steps",
    "humble",
    "killed",
    "recreate",
    "scale",
    "nav2",
    "rclpy",
)
SHORT_NAMES = ("talk", "odom", "drive", "spawn", "rclpy")
"""What a short run without names measures."""
REQUIRE, CACHED = "require", "cached"
"""Values of INTEROP."""
HEAD = """# Independent ROS 2 peers

`make interop` runs peers of [hiroz](https://crates.io/crates/hiroz) 0.2.0, an implementation of ROS
2 on Zenoh in Rust that shares no code with zensim, and rewrites this page; the command below a
heading measures that section alone. Messages of simulation_interfaces, gazebo_msgs and
ros_gz_interfaces are generated from zensim's structs, all others are those that hiroz brings along.
*n* is the number of samples. No process of rmw_zenoh_cpp takes part; rclpy takes part in the last
section.
"""
WITH_ROS = "rclpy"
"""Section that needs rclpy and the bridge."""
WITHOUT_RUST = frozenset({"nav2", WITH_ROS})
"""Sections that need no peers in Rust."""


def measure(name: str, *, is_short: bool) -> Section:
    """Run the peers of one section.

    The short form ignores limits that depend on the load of the machine.
    """
    module = import_module(f"tests.interop.interop_{name}")
    title, _, method = str(module.__doc__).partition("\n")
    try:
        rows: list[Figure] = list(module.rows(is_short=is_short))
    except PeersMissing as missing:
        if name != WITH_ROS or os.environ.get("INTEROP") == REQUIRE:
            raise
        return Section(f"## {title}\n\nLeft out: {missing}.", ())
    command = f"`.venv/bin/python -m tests.interop {name}`"
    return Section(
        f"## {title}\n\n{command}\n\n{method.strip()}\n\n{table(rows)}",
        missed_among(rows, is_short=is_short),
    )


def build(names: Sequence[str], *, is_short: bool) -> None:
    """Build what the sections need.

    Raises:
        PeersMissing: There is no cargo, or a build fails.
    """
    within_s = SHORT_BUILD_S if is_short else BUILD_S
    if WITH_ROS in names:
        build_ros(within_s=within_s)
    if names and WITHOUT_RUST.issuperset(names):
        return
    build_peers(JAZZY, within_s=within_s)
    if is_short:
        return
    build_peers(HUMBLE)
    try:
        build_router()
    except PeersMissing as missing:
        sys.stderr.write(f"interop: no zenohd ({missing}); the router of hiroz is used\n")


def check_cache() -> None:
    """Check that the peers of a short run were built.

    Raises:
        PeersMissing: They were not.
    """
    if not find_peers(JAZZY).is_file():
        folder = cache_folder()
        raise PeersMissing(f"no build of the peers in {folder}, which make interop-build writes")


DOCUMENT = Document(
    program="tests.interop",
    names=NAMES,
    short_names=SHORT_NAMES,
    make=measure,
    short="a few seconds of the peers of jazzy, without zenohd",
    path=ROOT / "docs" / "interop.md",
    head=HEAD,
)


def check_planted_faults() -> int:
    """Check that figures turn red; return the exit status of pytest."""
    command = (sys.executable, "-m", "pytest", "-q", "-m", "interop", "tests/interop")
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def run() -> int:
    """Build, measure and plant faults; return the exit status."""
    wanted = os.environ.get("INTEROP")
    names = [word for word in sys.argv[1:] if not word.startswith("-")]
    try:
        if wanted == CACHED:
            check_cache()
        else:
            build(names, is_short="--short" in sys.argv)
    except PeersMissing as missing:
        is_required = wanted == REQUIRE
        sys.stderr.write(f"interop: {missing}, {'failed' if is_required else 'skipped'}\n")
        return int(is_required)
    if "--build" in sys.argv:
        return 0
    sections = DOCUMENT.write()
    misses = [line for section in sections for line in section.missed]
    sys.stdout.write("".join(f"missed: {line}\n" for line in misses) or "all figures are met\n")
    return int(bool(misses)) or (0 if names else check_planted_faults())


if __name__ == "__main__":
    raise SystemExit(run())
