"""The example that learns, for two updates."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.repository import ROOT

EXAMPLE = ROOT / "examples" / "learning" / "ppo_reach.py"
PNG = b"\x89PNG"


@pytest.mark.long_form
def test_example_learns_and_draws_its_curve(tmp_path: Path) -> None:
    picture = tmp_path / "curve.png"
    options = ["--updates", "2", "--worlds", "1", "--picture", str(picture)]

    done = subprocess.run(
        [sys.executable, str(EXAMPLE), *options],
        capture_output=True,
        text=True,
        check=True,
        timeout=250,
    )

    assert done.stdout.splitlines()[-1].startswith("update=2 steps=256 reached=")
    assert picture.read_bytes().startswith(PNG)
