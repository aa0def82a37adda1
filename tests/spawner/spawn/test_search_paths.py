"""Files that URIs of a description find, and files that they must not find."""

from pathlib import Path

import pytest

from tests.spawner.packages import make_package
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths


def make_paths(file: Path, *roots: Path) -> SearchPaths:
    return collect_search_paths(roots, {}).with_folder_of(file)


@pytest.mark.parametrize(
    "uri",
    [
        "package://my_robot/meshes/base.stl",
        "model://my_robot/meshes/base.stl",
        "../meshes/base.stl",
        "package://my_robot/meshes/../meshes/base.stl",
        "package://my_robot/meshes%2Fbase.stl",
        "package://my_robot//meshes/base.stl",
        "package://my_robot/meshes//base.stl",
        "package://my_robot/./meshes/base.stl",
        "package:///my_robot/meshes/base.stl",
        "model://my_robot//meshes/base.stl",
        "model:///my_robot/meshes/base.stl",
        "..//meshes//base.stl",
        "//../meshes/base.stl",
    ],
)
def test_mesh_is_found_in_the_package_of_the_description(tmp_path: Path, uri: str) -> None:
    package = make_package(tmp_path)

    place = make_paths(package / "urdf" / "r.urdf").find(uri)

    assert place.path == (package / "meshes" / "base.stl").resolve()


def test_mesh_is_found_by_an_absolute_path_inside_the_package(tmp_path: Path) -> None:
    mesh = make_package(tmp_path) / "meshes" / "base.stl"
    paths = make_paths(tmp_path / "my_robot" / "urdf" / "r.urdf")

    assert paths.find(str(mesh)).path == mesh.resolve()
    assert paths.find(f"file://{mesh}").path == mesh.resolve()


def test_mesh_is_found_in_a_sibling_package(tmp_path: Path) -> None:
    make_package(tmp_path, "other")
    package = make_package(tmp_path)

    place = make_paths(package / "urdf" / "r.urdf").find("package://other/meshes/base.stl")

    assert place.path == (tmp_path / "other" / "meshes" / "base.stl").resolve()


@pytest.mark.parametrize("depth", ["", "src", "src/repository"])
def test_mesh_is_found_below_a_given_folder(tmp_path: Path, depth: str) -> None:
    package = make_package(tmp_path / depth)

    place = collect_search_paths([tmp_path], {}).find("package://my_robot/meshes/base.stl")

    assert place.path == (package / "meshes" / "base.stl").resolve()


def test_mesh_is_found_in_a_package_whose_folder_has_another_name(tmp_path: Path) -> None:
    package = make_package(tmp_path / "src").rename(tmp_path / "src" / "my_robot_gazebo")

    place = collect_search_paths([tmp_path], {}).find("package://my_robot/meshes/base.stl")

    assert place.path == (package / "meshes" / "base.stl").resolve()


def test_mesh_is_found_if_the_given_folder_is_the_package(tmp_path: Path) -> None:
    package = make_package(tmp_path)

    place = collect_search_paths([package], {}).find("package://my_robot/meshes/base.stl")

    assert place.path is not None


@pytest.mark.parametrize(
    ("variable", "inside"),
    [("ROS_PACKAGE_PATH", ""), ("GAZEBO_MODEL_PATH", ""), ("AMENT_PREFIX_PATH", "share")],
)
def test_mesh_is_found_by_an_environment_variable(
    tmp_path: Path, variable: str, inside: str
) -> None:
    make_package(tmp_path / inside)

    paths = collect_search_paths((), {variable: f"/nowhere:{tmp_path}"})

    assert paths.find("package://my_robot/meshes/base.stl").path is not None


@pytest.mark.parametrize(
    "uri",
    [
        "../../secret.stl",
        "package://my_robot/../secret.stl",
        "package://../secret.stl",
        "model://my_robot/../../secret.stl",
        "file://{folder}/secret.stl",
        "{folder}/secret.stl",
        "package:///{folder}/secret.stl",
        "file://../../secret.stl",
        "package://my_robot/meshes/link.stl",
        "package://my_robot/%2e%2e/secret.stl",
    ],
)
def test_file_outside_the_search_paths_is_not_found(tmp_path: Path, uri: str) -> None:
    package = make_package(tmp_path)
    (tmp_path / "secret.stl").write_bytes(b"secret")
    (package / "meshes" / "link.stl").symlink_to(tmp_path / "secret.stl")

    place = make_paths(package / "urdf" / "r.urdf").find(uri.format(folder=tmp_path))

    assert place.path is None
    assert place.reason


def test_link_to_an_outside_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "outside").mkdir()
    make_package(tmp_path / "outside")
    root = tmp_path / "root"
    root.mkdir()
    (root / "my_robot").symlink_to(tmp_path / "outside" / "my_robot")

    place = collect_search_paths([root], {}).find("package://my_robot/meshes/base.stl")

    assert place.path is None
    assert "--package-path" in place.reason


def test_sibling_without_package_file_is_not_searched(tmp_path: Path) -> None:
    package = make_package(tmp_path)
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "a.stl").write_bytes(b"")

    assert make_paths(package / "urdf" / "r.urdf").find("package://keys/a.stl").path is None


@pytest.mark.parametrize("uri", ["http://host/a.stl", "x" * 5000, "a\0b", "", ".", "package://"])
def test_invalid_uri_is_not_found(tmp_path: Path, uri: str) -> None:
    place = make_paths(tmp_path / "r.urdf", tmp_path).find(uri)

    assert place.path is None
    assert place.reason


def test_loop_of_links_is_not_found(tmp_path: Path) -> None:
    (tmp_path / "a.stl").symlink_to(tmp_path / "b.stl")
    (tmp_path / "b.stl").symlink_to(tmp_path / "a.stl")

    found = SearchPaths((tmp_path,)).find("a.stl")

    assert found.path is None
    assert found.reason
