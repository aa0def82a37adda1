"""The examples that learn: one trains for two updates, one drives the robots of a server."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.repository import ROOT
from tests.integration.processes import read_json_line, running
from zensim.envs.trained_policy import Policy

FOLDER = ROOT / "examples" / "learning"
PNG = b"\x89PNG"
ROBOT_M = 0.1
"""Side of a box_bot."""


def run(name: str, *arguments: str) -> str:
    """Run an example; return what it printed."""
    done = subprocess.run(
        [sys.executable, str(FOLDER / name), *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=250,
    )
    return done.stdout


@pytest.mark.long_form
def test_example_learns_saves_its_policy_and_draws_its_curve(tmp_path: Path) -> None:
    picture, file = tmp_path / "curve.png", tmp_path / "policy.npz"
    settings = [
        word
        for robots, spacing in ((3, 1.0), (2, 2.0))
        for word in ("--settings", f'{{"count": {robots}, "spacing": {spacing}}}')
    ]

    printed = run(
        *("ppo.py", "avoid", "--updates", "2", "--worlds", "4", *settings),
        *("--picture", str(picture), "--save", str(file)),
    )

    assert printed.splitlines()[-1].startswith("update=2 steps=640 ")
    assert picture.read_bytes().startswith(PNG)
    policy = Policy.load(file)
    assert policy.settings == {"count": 3, "spacing": 1.0}
    assert policy.act([[0.0] * 16]).shape == (1, 2)


def test_policy_drives_the_robots_of_a_server_past_each_other() -> None:
    with running(
        *("up", "--json", "--no-viewer", "--robots", "4", "--layout", "grid"),
        *("--behaviour", "none", "--listen", "tcp/127.0.0.1:0"),
    ) as up:
        endpoint = str(read_json_line(up)["endpoint"])
        printed = run("drive_fleet.py", "--endpoint", endpoint, "--seconds", "60")

    found = re.search(r"robots=(\d+) arrived=(\d+) least_gap_m=([0-9.]+)", printed)
    assert found is not None, printed
    assert found[1] == found[2] == "4"
    assert float(found[3]) > ROBOT_M
