"""Models and meshes are found below the given folders only."""

from pathlib import Path

import pytest

from zensim.sim_server.world_loading.world_resources import (
    make_file_finder,
    make_file_reader,
    make_model_resolver,
)

CRATE = '<sdf version="1.6"><model name="crate"/></sdf>'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one model, and a secret beside it."""
    crate = tmp_path / "models" / "crate"
    crate.mkdir(parents=True)
    (crate / "model.sdf").write_text(CRATE, encoding="utf-8")
    (tmp_path / "secret").write_text("secret", encoding="utf-8")
    return tmp_path / "models"


def test_model_is_found_by_the_name_of_its_folder(folder: Path) -> None:
    assert make_model_resolver([folder])("model://crate") == CRATE
    assert make_model_resolver([folder])("model://crate/model.sdf") == CRATE
    assert make_model_resolver([folder])("crate/model.sdf") == CRATE


@pytest.mark.parametrize(
    "uri",
    ["model:///crate", "model:///crate/model.sdf", "model://crate//model.sdf", "//crate/model.sdf"],
)
def test_slashes_of_a_uri_may_be_more_than_needed(folder: Path, uri: str) -> None:
    assert make_model_resolver([folder])(uri) == CRATE
    assert make_model_resolver([folder / "crate"])("model://crate//model.sdf") == CRATE
    assert make_file_finder([folder / "crate"])("//model.sdf") == folder / "crate" / "model.sdf"


def test_model_is_read_from_the_first_folder_that_has_it(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "crate"
    other.mkdir(parents=True)
    (other / "model.sdf").write_text("<other/>", encoding="utf-8")

    assert (
        make_model_resolver([tmp_path / "none", other.parent, folder])("model://crate")
        == "<other/>"
    )


def test_newest_version_in_the_config_is_read(folder: Path) -> None:
    config = (
        '<?xml version="1.0"?><model><name>crate</name><sdf version="1.10">new.sdf</sdf>'
        '<sdf version="1.9">model.sdf</sdf></model>'
    )
    (folder / "crate" / "model.config").write_text(config, encoding="utf-8")
    (folder / "crate" / "new.sdf").write_text("<new/>", encoding="utf-8")

    assert make_model_resolver([folder])("model://crate") == "<new/>"


def test_meshes_are_found_beside_a_model_file_in_a_folder_of_its_own(folder: Path) -> None:
    (folder / "crate" / "model.config").write_text(
        "<model><sdf version='1.9'>sdf/crate.sdf</sdf></model>", encoding="utf-8"
    )
    for name in ("sdf/near.stl", "meshes/far.stl"):
        (folder / "crate" / name).parent.mkdir()
        (folder / "crate" / name).write_bytes(b"")
    find = make_file_finder([folder])

    assert find("model://crate/near.stl") == folder.resolve() / "crate" / "sdf" / "near.stl"
    assert find("model://crate/../meshes/far.stl") == (
        folder.resolve() / "crate" / "meshes" / "far.stl"
    )
    assert find("model://crate/meshes/far.stl") == find("model://crate/../meshes/far.stl")


@pytest.mark.parametrize("config", ["", "<model", "<model/>", "<model><sdf/></model>"])
def test_default_file_is_read_when_the_config_lists_none(folder: Path, config: str) -> None:
    (folder / "crate" / "model.config").write_text(config, encoding="utf-8")

    assert make_model_resolver([folder])("model://crate") == CRATE


@pytest.mark.parametrize(
    "uri",
    [
        "",
        "model://",
        "model://nothing",
        "model://../secret",
        "model://crate/../../secret",
        "file:///etc/passwd",
        "/etc/passwd",
        "https://example.org/crate",
        "model://" + "x" * 5000,
        "model://a\0b",
    ],
)
def test_nothing_outside_the_folders_is_read(folder: Path, uri: str) -> None:
    assert make_model_resolver([folder])(uri) is None


def test_links_and_configs_to_the_outside_are_not_followed(folder: Path) -> None:
    (folder / "out").symlink_to(folder.parent)
    (folder / "crate" / "model.config").write_text(
        '<model><sdf version="2">../../secret</sdf></model>', encoding="utf-8"
    )

    assert make_model_resolver([folder])("model://out/secret") is None
    assert make_model_resolver([folder])("model://crate") is None


def test_file_that_is_not_text_is_not_read(folder: Path) -> None:
    (folder / "crate" / "model.sdf").write_bytes(b"\xff\xfe\x00")

    assert make_model_resolver([folder])("model://crate") is None


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A package with one mesh, and a secret beside it."""
    mesh = tmp_path / "src" / "my_robot" / "meshes" / "body.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("solid", encoding="utf-8")
    (tmp_path / "secret.stl").write_text("solid", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("folder", ["src", "src/my_robot"])
@pytest.mark.parametrize("scheme", ["package", "model"])
def test_mesh_is_found_when_its_package_is(workspace: Path, folder: str, scheme: str) -> None:
    find = make_file_finder([workspace / "elsewhere", workspace / folder])

    found = find(f"{scheme}://my_robot/meshes/body.stl")

    assert found == (workspace / "src/my_robot/meshes/body.stl").resolve()


def test_mesh_is_found_when_its_path_is_relative_to_a_folder(workspace: Path) -> None:
    assert make_file_finder([workspace / "src/my_robot"])("meshes/body.stl") is not None


@pytest.mark.parametrize(
    "uri",
    [
        "",
        "package://my_robot",
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
def test_mesh_is_not_found_when_it_is_missing_or_outside(workspace: Path, uri: str) -> None:
    assert make_file_finder([workspace / "src"])(uri) is None
    assert make_file_finder([])(uri) is None


@pytest.mark.parametrize("folder", ["Wood Crate", "wood_crate", "WOOD_CRATE", "wood crate/3"])
def test_model_of_fuel_is_found_by_its_name(tmp_path: Path, folder: str) -> None:
    (tmp_path / folder / "meshes").mkdir(parents=True)
    (tmp_path / folder / "model.sdf").write_text("<sdf/>")
    (tmp_path / folder / "meshes" / "a.stl").write_bytes(b"stl")
    uri = "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Wood%20Crate"

    assert make_model_resolver([tmp_path])(uri) == "<sdf/>"
    assert make_model_resolver([tmp_path])(f"{uri}/3") == "<sdf/>"
    assert make_file_reader([tmp_path])(f"{uri}/meshes/a.stl") == b"stl"
    assert make_file_reader([tmp_path])(f"{uri}/3/files/meshes/a.stl") == b"stl"
    assert make_model_resolver([tmp_path])(uri.replace("Wood", "Tin")) is None


def test_file_is_found_in_another_case_below_its_folder_only(tmp_path: Path) -> None:
    (tmp_path / "crate" / "meshes").mkdir(parents=True)
    (tmp_path / "crate" / "meshes" / "Crate.DAE").write_bytes(b"crate")
    (tmp_path / "secret.dae").write_bytes(b"secret")
    (tmp_path / "crate" / "meshes" / "Link.dae").symlink_to(tmp_path / "secret.dae")
    find = make_file_finder([tmp_path / "crate"])

    assert find("model://crate/meshes/crate.dae") == tmp_path / "crate" / "meshes" / "Crate.DAE"
    assert find("model://crate/meshes/link.dae") is None
    assert find("model://crate/meshes/other.dae") is None
    assert find("model://crate/meshes/../../SECRET.dae") is None
