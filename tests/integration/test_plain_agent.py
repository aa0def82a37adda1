"""The agent of the protocol's page, which uses none of our code."""

import subprocess
import sys

import pytest

import zensim
from tests.contract.repository import ROOT

EXAMPLE = ROOT / "examples" / "plain_agent.py"
MAX_LINES = 60


def test_plain_agent_drives_its_robot_in_lockstep() -> None:
    with zensim.launch(agents=0, timeout_s=120.0) as sim:
        robot = sim.spawn("box_bot", name="r1", agent="external")
        agent = subprocess.Popen(
            [sys.executable, str(EXAMPLE), sim.endpoint, "r1"], stdout=subprocess.PIPE, text=True
        )
        try:
            assert agent.stdout is not None
            assert "x=0.000" in agent.stdout.readline()
            robot.drive(0.2, 0.0)
            sim.run_for(1.0)
            for _ in sim.steps(seconds=1.0, rate=20):
                robot.drive(0.2, 0.0)
            assert robot.pose.x == pytest.approx(0.4, abs=0.03)
            assert "1." in agent.stdout.readline()
        finally:
            agent.kill()
            agent.wait()
            assert agent.stdout is not None
            agent.stdout.close()


def test_plain_agent_is_short() -> None:
    assert len(EXAMPLE.read_text(encoding="utf-8").splitlines()) <= MAX_LINES
