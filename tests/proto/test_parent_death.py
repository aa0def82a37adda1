"""Processes end with their parent or supervisor."""

import os
import signal
import subprocess
import sys

import psutil
import pytest

from tests.contract.repository import ROOT
from tests.integration.processes import eventually, kill
from zensim.proto.parent_death import PARENT_PID_VARIABLE, die_with_supervisor

CHILD = """
import os, time
from zensim.proto.parent_death import die_with_supervisor
die_with_supervisor(os.environ)
print(os.getpid(), flush=True)
time.sleep(600)
"""
SUPERVISOR = f"""
import os, subprocess, sys, time
environment = {{**os.environ, "{PARENT_PID_VARIABLE}": str(os.getpid())}}
subprocess.Popen([sys.executable, "-c", {CHILD!r}], env=environment, start_new_session=True)
time.sleep(600)
"""


def run_child(parent: str) -> "subprocess.CompletedProcess[str]":
    """Run a child that does not sleep, under a parent's name."""
    return subprocess.run(
        [sys.executable, "-c", CHILD.replace("time.sleep(600)", "")],
        env={**os.environ, PARENT_PID_VARIABLE: parent},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_program_ends_when_its_supervisor_is_killed() -> None:
    supervisor = subprocess.Popen(
        [sys.executable, "-c", SUPERVISOR], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert supervisor.stdout is not None
    child = int(supervisor.stdout.readline())
    try:
        supervisor.kill()
        supervisor.wait()

        eventually(lambda: not psutil.pid_exists(child), 5.0, "the child's end")
    finally:
        supervisor.stdout.close()
        kill(child, signal.SIGKILL)


def test_program_does_not_begin_when_its_supervisor_has_gone_already() -> None:
    done = run_child("999999999")

    assert (done.returncode, done.stdout) == (1, "")
    assert PARENT_PID_VARIABLE in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_program_begins_under_its_supervisor() -> None:
    done = run_child(str(os.getpid()))

    assert done.returncode == 0
    assert done.stdout.strip().isdigit()


@pytest.mark.parametrize("parent", ["", "abc", "-1"])
def test_program_without_a_supervisor_begins(parent: str) -> None:
    die_with_supervisor({PARENT_PID_VARIABLE: parent})
    die_with_supervisor({})


ORPHAN = """
import sys
from zensim.proto.parent_death import die_with_parent
die_with_parent(parent=int(sys.argv[1]))
print("begun")
"""


@pytest.mark.parametrize("is_there", [True, False])
def test_process_ends_at_once_when_its_parent_has_gone_already(*, is_there: bool) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ORPHAN, str(os.getpid() if is_there else 999999999)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )

    assert (done.returncode, done.stdout.strip()) == ((0, "begun") if is_there else (1, ""))
