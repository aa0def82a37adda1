"""The programs of docs/python.md run as they stand."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import zensim
from tests.contract.repository import ROOT, text_of

DOCUMENT = ROOT / "docs" / "python.md"
SECTION = re.compile(r"^## ([^\n]+)\n+```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SCRIPTS = dict(SECTION.findall(text_of(DOCUMENT)))
XACRO = "http://www.ros.org/wiki/xacro"
MAX_LINES = 12
"""Imports included, blank lines not."""


def run_script(title: str, endpoint: str = "", folder: Path = ROOT) -> str:
    environment = dict(os.environ)
    environment.pop("ZENSIM_CONNECT", None)
    if endpoint:
        environment["ZENSIM_CONNECT"] = endpoint
    done = subprocess.run(
        [sys.executable, "-c", SCRIPTS[title]],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def launched() -> Iterator[zensim.Sim]:
    """A paused server as fast as possible: it would take a core beside other tests."""
    with zensim.launch("walls", rtf=0, timeout_s=120.0) as sim:
        sim.pause()
        yield sim


@pytest.fixture
def running(launched: zensim.Sim) -> Iterator[zensim.Sim]:
    """The server, reset, which runs by itself."""
    launched.reset()
    launched.play()
    yield launched
    launched.pause()


def test_hello_robot() -> None:
    assert "RobotPose(x=0.2" in run_script("Hello robot")


def test_fleet(running: zensim.Sim) -> None:
    assert run_script("A fleet", running.endpoint).endswith("{}\n")


def test_controller_gives_the_same_hash_in_each_run() -> None:
    first = run_script("A controller in lockstep")

    assert len(first.strip()) == 64
    assert run_script("A controller in lockstep") == first


def test_callback_of_a_sensor() -> None:
    with zensim.launch(rtf=4, timeout_s=120.0) as sim:
        robot = sim.spawn("box_bot_lidar", name="r1")
        robot.topic("scan").read(timeout_s=60.0)
        run_script("Sensors and callbacks", sim.endpoint)
        assert sim.robots["r1"].pose.x > 4.5


def test_remote_server(running: zensim.Sim) -> None:
    running.spawn("box_bot", name="r1")

    assert "full ['r1']" in run_script("A remote server", running.endpoint)


def test_faults_and_events() -> None:
    assert "Event(" in run_script("Faults and events")


def test_snapshots_repeat_the_start() -> None:
    lines = run_script("Snapshots").splitlines()

    assert [line.split()[0] for line in lines] == ["0.1", "0.2", "0.3"]


def test_copy_goes_on_alone() -> None:
    assert run_script("Copies and live arrays") == "False\n"


def test_program_beside_another_client(running: zensim.Sim) -> None:
    robot = running.spawn("box_bot", name="r1")
    running.set_speed(8.0)  # nothing waits for the program, whose commands time out

    run_script("Beside another client", running.endpoint)
    running.set_speed(0.0)

    assert running.time > 20.0
    # Where the robot ends depends on the clients; its wheels have turned for metres.
    joints = robot.topic("joint_states").read(timeout_s=60.0)  # subscribed to from now on
    assert max(map(abs, joints.position)) > 10.0


def test_own_robot(tmp_path: Path) -> None:
    model = text_of(ROOT / "sim_server" / "models" / "box_bot.urdf")
    head = f'<robot xmlns:xacro="{XACRO}"><xacro:arg name="arm" default="false"/>'
    text = re.sub(
        r"<robot\b[^>]*>", head.replace("<robot", '<robot name="my_robot"'), model, count=1
    )
    (tmp_path / "my_robot.urdf.xacro").write_text(text, encoding="utf-8")

    assert "diff_drive" in run_script("Your own robot, in this process", folder=tmp_path)


def test_without_a_server_it_prints_slug_and_hint() -> None:
    assert run_script("A remote server", "tcp/127.0.0.1:9").startswith("unreachable ")


@pytest.mark.parametrize("title", SCRIPTS)
def test_script_is_short(title: str) -> None:
    assert len([line for line in SCRIPTS[title].splitlines() if line.strip()]) <= MAX_LINES
