"""Imports and runs without what only some operating systems have; MuJoCo without PyBullet."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.repository import ROOT
from tests.integration.processes import eventually, running_agents, serving

LACKING = """
import importlib, os, pathlib, pkgutil, signal, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios", "pybullet", "pybullet_data"):
    sys.modules[name] = None
for name in (
    "fork", "getsid", "readv", "sched_getaffinity", "sched_getscheduler", "sched_setaffinity",
    "setpriority", "getpriority", "PRIO_PROCESS", "SCHED_OTHER", "SCHED_RESET_ON_FORK",
    "O_DIRECTORY",
):
    if hasattr(os, name):
        delattr(os, name)
"""
NO_PROC = """
def refuse_proc(event, arguments):
    if event == "open" and isinstance(arguments[0], str) and arguments[0].startswith("/proc/"):
        raise FileNotFoundError(2, "no such file", arguments[0])
sys.addaudithook(refuse_proc)
"""
NO_PRCTL = """
import zensim.proto.parent_death
zensim.proto.parent_death._find_prctl = lambda: None
"""
NO_SIGNALS = """
for name in ("SIGKILL", "SIGXCPU", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM"):
    delattr(signal, name)
"""
IMPORT_ALL = """
import zensim
packages = ["proto", "robot_agent", "spawner", "deploy", "sim_server", "api", "scenario"]
for name in packages:
    if not (pathlib.Path(zensim.__file__).parent / name).exists():
        continue
    package = importlib.import_module(f"zensim.{name}")
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        needs_bullet = ".physics.bullet." in module.name or module.name.endswith("bullet_trials")
        if not needs_bullet and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
print("imported")
"""
# The standard library chooses its own modules by it when it is imported.
PRELOADED = "import asyncio, concurrent.futures, shutil, socket, sqlite3, subprocess, tempfile\n"


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_everything_imports_without_modules_of_some_systems() -> None:
    done = run(PRELOADED + LACKING + NO_PROC + IMPORT_ALL)

    assert (done.stdout, done.stderr) == ("imported\n", "")


def test_everything_imports_without_signals_that_windows_lacks() -> None:
    # Rich looks for the console of the system when it is imported.
    done = run(
        PRELOADED + "import rich.console, typer, zenoh\n" + LACKING + NO_SIGNALS + IMPORT_ALL
    )

    assert (done.stdout, done.stderr) == ("imported\n", "")


@pytest.fixture
def lacking(tmp_path: Path) -> tuple[str, ...]:
    """A command prefix under which processes find none of it."""
    (tmp_path / "sitecustomize.py").write_text(LACKING + NO_PROC + NO_PRCTL)
    return ("env", f"PYTHONPATH={os.pathsep.join((str(tmp_path), str(ROOT)))}")


def test_mujoco_server_and_agent_run_without_modules_of_some_systems(
    lacking: tuple[str, ...], tmp_path: Path
) -> None:
    with serving("--journal", str(tmp_path / "journal"), prefix=lacking) as server:
        server.zensim("spawn", "box_bot", "--name", "r1")
        with running_agents(server, "r1"):
            moved = server.bus.subscribe("r1/odom")

            engine = server.client.info().engine
            eventually(moved.newest, 10.0, "odometry")

    assert engine == "mujoco"


def test_mujoco_is_chosen_without_a_flag_where_pybullet_is_missing() -> None:
    done = run(
        LACKING + "import json\n"
        "from zensim.proto.settings.engine_settings import EngineSettings\n"
        "from zensim.sim_server.physics.engine_config import *\n"
        "print(json.dumps(choose_engine(EngineSettings(), find_installed_engines())))"
    )

    assert json.loads(done.stdout) == "mujoco"
