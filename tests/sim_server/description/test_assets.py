"""Only meshes below the folders given are here."""

from pathlib import Path

import pytest

from sim_server.description.assets import meshes_in, no_meshes


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    mesh = tmp_path / "src" / "my_robot" / "meshes" / "body.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("solid")
    (tmp_path / "secret.stl").write_text("solid")
    return tmp_path


@pytest.mark.parametrize("folder", ["src", "src/my_robot"])
@pytest.mark.parametrize("scheme", ["package", "model"])
def test_mesh_is_here_when_its_package_is(workspace: Path, folder: str, scheme: str) -> None:
    has_mesh = meshes_in([workspace / "elsewhere", workspace / folder])

    assert has_mesh(f"{scheme}://my_robot/meshes/body.stl")


def test_mesh_is_here_when_its_path_is_relative_to_a_folder(workspace: Path) -> None:
    assert meshes_in([workspace / "src/my_robot"])("meshes/body.stl")


@pytest.mark.parametrize(
    "uri",
    [
        "",
        "package://my_robot/meshes",
        "package://my_robot/meshes/arm.stl",
        "package://my_robot/../../secret.stl",
        "package://../secret.stl",
        "../secret.stl",
        "file:///etc/passwd",
        "http://example.org/body.stl",
        "/etc/passwd",
        "meshes/body.stl\0",
        "m" * 5_000,
    ],
)
def test_mesh_is_not_here_when_it_is_missing_or_outside(workspace: Path, uri: str) -> None:
    assert not meshes_in([workspace / "src"])(uri)


def test_no_mesh_is_here_when_no_folder_is_given() -> None:
    assert not meshes_in([])("package://my_robot/meshes/body.stl")
    assert not no_meshes("package://my_robot/meshes/body.stl")
