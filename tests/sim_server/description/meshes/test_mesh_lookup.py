"""Mesh policies without meshes."""

from zensim.sim_server.description.meshes.mesh_lookup import no_meshes


def test_no_meshes_has_no_mesh() -> None:
    assert not no_meshes("package://my_robot/meshes/body.stl")
