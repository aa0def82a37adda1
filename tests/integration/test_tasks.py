"""The commands and programs of docs/tasks.md run as they stand, on ports of their own."""

import os
import re
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from tests.contract.repository import ROOT, text_of
from tests.integration.processes import START_S, children, eventually, free_endpoint, kill

DOCUMENT = ROOT / "docs" / "tasks.md"
HEADING = re.compile(r"^## (.+)$", re.MULTILINE)
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WORLD_PORT, PAGE_PORT = "7447", "8080"
COUNT = 15
BACKGROUND = re.compile(r"^(zensim (?:up|serve) .*&.*)$", re.MULTILINE)
WAITING = r"\1\nuntil grep -qE '^zensim serve: world| robots? ready in' output; do sleep 0.1; done"
"""A person waits for the line of a program before the next command."""
BEGIN, HOLD = "set -eu\ntrap 'kill $(jobs -p); wait' EXIT\n", "\ntouch done\nread -r _ || true\n"
TIMEOUT_S = 240.0


def read_tasks() -> dict[str, str]:
    """Read the tasks: one script of bash for each title."""
    _, *parts = HEADING.split(text_of(DOCUMENT))
    return {
        title: "".join(to_shell(*block) for block in BLOCK.findall(text))
        for title, text in zip(parts[::2], parts[1::2], strict=True)
    }


def to_shell(language: str, code: str) -> str:
    """Make lines of bash of a block."""
    if language == "sh":
        return code
    if "def test_" in code:
        run = f"{sys.executable} -m pytest -q -p no:cacheprovider test_robot.py\n"
        return f"cat > test_robot.py <<'PROGRAM'\n{code}PROGRAM\n{run}"
    return f"{sys.executable} - <<'PROGRAM'\n{code}PROGRAM\n"


TASKS = read_tasks()


@contextmanager
def run_task(title: str, folder: Path, ports: dict[str, str]) -> Iterator[str]:
    """Run a task to its end, with background programs still there; yield what it printed."""
    script = TASKS[title]
    for port, own in ports.items():
        script = script.replace(port, own)
    (folder / "my_robot.urdf").write_text(text_of(ROOT / "sim_server/models/box_bot.urdf"))
    (folder / "my_world.sdf").write_text(WORLD)
    (folder / "done").unlink(missing_ok=True)
    script = f"{BEGIN}{BACKGROUND.sub(WAITING, script)}{HOLD}"
    with (folder / "output").open("w") as output:
        process = subprocess.Popen(
            ["bash", "-c", script],
            cwd=folder,
            env=make_environment(folder, ports),
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        eventually(lambda: (folder / "done").exists() or process.poll() is not None, TIMEOUT_S)
        printed = (folder / "output").read_text()
        assert process.poll() is None, printed
        yield printed
    finally:
        end(process)


def make_environment(folder: Path, ports: dict[str, str]) -> dict[str, str]:
    """Make the variables of a task: own ports, own folders, no ROS domain of others."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    endpoint = f"tcp/127.0.0.1:{ports[WORLD_PORT]}"
    listen = {f"ZENSIM_{program}_LISTEN": endpoint for program in ("SERVE", "UP")}
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ZENSIM_")}
    state = {"XDG_STATE_HOME": str(folder / "state"), "XDG_CONFIG_HOME": str(folder / "config")}
    return {**kept, **listen, **state, "PATH": path, "ZENSIM_CONNECT": endpoint}


def end(process: "subprocess.Popen[bytes]") -> None:
    """End a shell and all that it started."""
    family = children(process.pid)
    assert process.stdin is not None
    process.stdin.close()
    try:
        process.wait(START_S)
    except subprocess.TimeoutExpired:
        process.kill()
    process.wait()
    for pid in family:
        if psutil.pid_exists(pid):
            kill(pid, signal.SIGKILL)


WORLD = """<sdf version='1.9'><world name='mine'>
<model name='floor'><static>true</static><link name='l'><collision name='c'><geometry>
<plane><normal>0 0 1</normal><size>20 20</size></plane></geometry></collision></link></model>
<model name='box'><static>true</static><pose>0 4 0.5 0 0 0</pose><link name='l'>
<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision></link></model>
</world></sdf>"""


@pytest.fixture
def ports() -> dict[str, str]:
    return {port: free_endpoint().rsplit(":", 1)[1] for port in (WORLD_PORT, PAGE_PORT)}


def test_page_has_fifteen_tasks_with_a_block_each() -> None:
    assert len(TASKS) == COUNT
    assert all(TASKS.values())


@pytest.mark.parametrize("title", TASKS)
def test_task_runs_as_it_stands(title: str, tmp_path: Path, ports: dict[str, str]) -> None:
    with run_task(title, tmp_path, ports) as printed:
        assert "Traceback" not in printed
        if "zensim view" in TASKS[title]:
            eventually(lambda: answers(ports[PAGE_PORT]), START_S, "the page")


def answers(port: str) -> bool:
    """Whether a page answers."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5.0) as reply:
            return b"<html" in reply.read().lower()
    except OSError:
        return False
