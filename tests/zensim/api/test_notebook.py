"""The example notebook runs in a kernel, from its first cell to its last."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.repository import ROOT

Cell = dict[str, list[dict[str, str]]]
NOTEBOOK = ROOT / "examples" / "drive_robots.ipynb"


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> list[Cell]:
    """Code cells with their outputs; the kernel works in an empty folder."""
    output = tmp_path_factory.mktemp("notebook") / "run.ipynb"
    execute = str(Path(sys.executable).with_name("jupyter-execute"))
    done = subprocess.run(
        [execute, str(NOTEBOOK), f"--output={output}", "--timeout=200"],
        cwd=output.parent,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found: list[Cell] = json.loads(output.read_text())["cells"]
    return [one for one in found if "outputs" in one]


def test_notebook_prints_a_row_for_each_robot(cells: list[Cell]) -> None:
    printed = "".join(cells[4]["outputs"][0]["text"]).splitlines()

    assert len(printed) == 6
    assert all(2.7 < float(row.split()[1]) < 3.0 for row in printed[1:])


def test_notebook_draws_the_paths(cells: list[Cell]) -> None:
    picture = json.dumps(cells[5]["outputs"])

    assert picture.count("<polyline") == 5


def test_notebook_shows_the_world_as_a_picture_and_as_a_page(cells: list[Cell]) -> None:
    picture, page = (json.dumps(cells[row]["outputs"]) for row in (1, 2))

    assert "image/png" in picture
    assert "<iframe src=" in page


def test_notebook_is_kept_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]

    assert all(not one.get("outputs") and not one.get("execution_count") for one in cells)
