"""`zensim check` of robots with meshes of each kind that public robots have."""

import json
from pathlib import Path

import pytest

from tests.gallery.mesh_robots import ROBOTS, write_robot
from tests.integration.processes import zensim
from zensim.proto.exit_codes import ExitCode


@pytest.mark.short_form
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
@pytest.mark.parametrize("name", ROBOTS)
def test_robot_with_meshes_is_read_and_does_what_is_commanded(
    name: str, engine: str, tmp_path: Path
) -> None:
    file = write_robot(tmp_path, name)

    done = zensim("check", str(file), "--engine", engine, "--json")

    assert done.returncode == ExitCode.OK, done.stderr + done.stdout
    assert json.loads(done.stdout)["verdicts"] == {"stands" if name == "arm" else "ok": 1}
