"""A setting that is added to a copy of the product: one file changes, and every form has it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = ("proto", "sim_server", "spawner", "robot_agent", "deploy", "zensim")
FILE = "proto/settings/engine_settings.py"
FIELD = """    spare_cells: Annotated[
        int,
        Setting(
            help="Number of cells in store.",
            panel="Physics",
            least=0,
            most=8,
            key="engine.spare_cells",
        ),
    ] = 2
    compiles_ahead: bool"""
KEYWORD = '''    spare_cells: int
    """Number of cells in store."""
    clusters: Clustering
'''
PROGRAM = """
import json
from benchmarks.settings_page import PAGE, replace_table
from zensim.api.api_errors import Invalid
from zensim.api.local_deployment import make_serve_arguments
from zensim.api.simulation import read_world_keywords
from zensim.deploy.cli.config_commands import list_settings
from zensim.deploy.cli.up_commands import UpOptions, make_config
from zensim.proto.settings.server_settings import ServerSettings
from zensim.scenario.scenario_schema import make_schema

given = read_world_keywords("empty", {"spare_cells": 5}, ServerSettings())
try:
    read_world_keywords("empty", {"spare_cells": 9}, ServerSettings())
except Invalid as error:
    refused = str(error)
print(json.dumps({
    "words": make_serve_arguments(make_config(UpOptions(robots=0, server=given))),
    "options": {
        verb: {one.option: (one.value, one.source) for one in list_settings([verb], None)}
        for verb in ("serve", "up")
    },
    "refused": refused,
    "schema": make_schema()["$defs"]["EngineSection"]["properties"]["spare_cells"],
    "page": replace_table(PAGE.read_text()),
}))
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Copy the product with another setting."""
    for name in PROGRAMS:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, symlinks=True, ignore=ignored)
    text = (tmp_path / FILE).read_text()
    for before, after in (
        ("    compiles_ahead: bool", FIELD),
        ("    clusters: Clustering\n", KEYWORD),
    ):
        assert text.count(before) == 1
        text = text.replace(before, after)
    (tmp_path / FILE).write_text(text)
    return tmp_path


def test_added_setting_has_all_forms_when_one_file_has_changed(copy: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=copy,
        env=os.environ | {"PYTHONPATH": f"{copy}:{ROOT}", "ZENSIM_SERVE_SPARE_CELLS": "4"},
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert " ".join(found["words"]).count("--spare-cells 5") == 1
    assert found["options"]["serve"]["spare-cells"] == [4, "variable ZENSIM_SERVE_SPARE_CELLS"]
    assert found["options"]["up"]["spare-cells"] == [2, "default"]
    assert "`spare_cells` 9 is out of range; use 0 to 8" in found["refused"]
    assert (found["schema"]["minimum"], found["schema"]["maximum"]) == (0, 8)
    assert "| `--spare-cells` | yes | `engine.spare_cells` | `spare_cells` | `2` |" in found["page"]
