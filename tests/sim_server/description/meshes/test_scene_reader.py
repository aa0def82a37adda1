"""COLLADA files with files that are not there."""

import logging

import pytest

from tests.sim_server.description.meshes.mesh_samples import BOX, exported
from zensim.sim_server.description.meshes.mesh_reader import read_mesh


def test_missing_texture_of_a_mesh_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    read_mesh("box.dae", exported(BOX, "dae"))

    logging.getLogger("trimesh").warning("unable to load bumpmap")

    assert caplog.records == []
