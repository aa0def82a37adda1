"""Meshes that tests write into files."""

import trimesh

BOX = trimesh.creation.box((1.0, 2.0, 3.0))


def exported(mesh: trimesh.Trimesh | trimesh.Scene, ending: str) -> bytes:
    data = mesh.export(file_type=ending)
    if isinstance(data, str):
        return data.encode()
    assert isinstance(data, bytes)
    return data
