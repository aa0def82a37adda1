"""A description that nothing was sent with has no meshes."""

from zensim.sim_server.description.meshes.mesh_lookup import no_meshes


def test_no_mesh_is_here_when_none_was_sent() -> None:
    assert not no_meshes("package://my_robot/meshes/body.stl")
