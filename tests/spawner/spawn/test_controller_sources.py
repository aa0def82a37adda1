"""Controllers' files: given, named by plug-ins, or found beside a description."""

from pathlib import Path

import pytest

from tests.spawner.packages import make_package
from zensim.proto.bounded_files import FileTooLarge
from zensim.spawner.spawn.controller_sources import (
    MAX_CONTROLLERS_BYTES,
    ControllerTexts,
    find_controller_files,
    read_controller_files,
)
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths

DRIVE = "base: {type: diff_drive_controller/DiffDriveController, left_wheel: l, right_wheel: r}"
JOINTS = '<joint name="l"/><joint name="r"/>'
ROBOT = f'<robot name="r">{JOINTS}</robot>'


def a_description(*parameters: str) -> str:
    tags = "".join(f"<parameters>{name}</parameters>" for name in parameters)
    return (
        f'<robot name="r">{JOINTS}<gazebo><plugin filename="libgazebo_ros2_control.so" name="c">'
        f"{tags}</plugin></gazebo></robot>"
    )


@pytest.fixture
def package(tmp_path: Path) -> Path:
    package = make_package(tmp_path / "src")
    (package / "config").mkdir()
    return package


def paths_of(package: Path) -> SearchPaths:
    return collect_search_paths([], {}).with_folder_of(package / "urdf" / "robot.urdf")


def find(text: str, package: Path) -> ControllerTexts:
    return find_controller_files(text, paths_of(package))


@pytest.mark.parametrize(
    "name",
    [
        "$(find my_robot)/config/c.yaml",
        "$(find-pkg-share my_robot)/config/c.yaml",
        "package://my_robot/config/c.yaml",
        "/opt/ros/jazzy/share/my_robot/config/c.yaml",
        "{package}/config/c.yaml",
    ],
)
def test_file_that_a_plugin_names_is_read(name: str, package: Path) -> None:
    (package / "config" / "c.yaml").write_text(DRIVE)

    found = find(a_description(name.format(package=package)), package)

    assert found.texts == (DRIVE,)
    assert [note.status for note in found.notes] == ["applied"]


def test_all_files_that_a_plugin_names_are_read_in_order(package: Path) -> None:
    for name in ("b", "a"):
        (package / "config" / f"{name}.yaml").write_text(name)

    found = find(a_description(*(f"{package}/config/{name}.yaml" for name in "ba")), package)

    assert found.texts == ("b", "a")


@pytest.mark.parametrize(
    "name", ["package://my_robot/config/none.yaml", "/etc/passwd", "../../../secret.yaml"]
)
def test_other_files_are_not_read(name: str, package: Path) -> None:
    (package.parents[1] / "secret.yaml").write_text(DRIVE)

    found = find(a_description(name), package)

    assert found.texts == ()
    assert [note.status for note in found.notes] == ["suspicious"]


def test_link_out_of_the_package_is_not_read(package: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.yaml").write_text(DRIVE)
    (package / "config" / "c.yaml").symlink_to(tmp_path / "secret.yaml")

    assert find(a_description("$(find my_robot)/config/c.yaml"), package).texts == ()


def test_only_fitting_file_of_a_package_beside_is_read(package: Path) -> None:
    beside = make_package(package.parent, "my_robot_control")
    (beside / "control.yaml").write_text(DRIVE)
    (beside / "other.yaml").write_text(DRIVE.replace(" l,", " x,").replace(" r}", " y}"))
    (beside / "note.yaml").write_text("l: r")

    found = find(ROBOT, package)

    assert found.texts == (DRIVE,)


@pytest.mark.parametrize(
    ("name", "depends"),
    [("my_control", ""), ("control", "<exec_depend>my_robot</exec_depend>")],
    ids=["named alike", "names the description"],
)
def test_fitting_file_of_the_robot_below_a_search_path_is_read(
    name: str, depends: str, package: Path, tmp_path: Path
) -> None:
    found = find_beside_another_repository(name, depends, package, tmp_path)

    assert found.texts == (DRIVE,)


def test_file_of_another_robot_with_wheels_of_the_same_names_is_not_read(
    package: Path, tmp_path: Path
) -> None:
    found = find_beside_another_repository("other_control", "", package, tmp_path)

    assert found.texts == ()
    assert [note.status for note in found.notes] == ["ignored"]


def test_files_of_all_installed_robots_are_not_of_this_one(tmp_path: Path) -> None:
    package = make_package(tmp_path / "share")
    (make_package(tmp_path / "share", "other_control") / "control.yaml").write_text(DRIVE)

    assert find(ROBOT, package).texts == ()


def find_beside_another_repository(
    name: str, depends: str, package: Path, tmp_path: Path
) -> ControllerTexts:
    other = make_package(tmp_path / "other" / "repository", name)
    (other / "package.xml").write_text(f"<package><name>{name}</name>{depends}</package>")
    (other / "control.yaml").write_text(DRIVE)
    paths = collect_search_paths([tmp_path / "other"], {})
    return find_controller_files(ROBOT, paths.with_folder_of(package / "urdf" / "robot.urdf"))


def test_file_with_arguments_of_a_launch_file_fits_by_the_ends_of_names(package: Path) -> None:
    text = DRIVE.replace(" l,", " '$(arg p)left_wheel',").replace(" r}", " '$(arg p)right_wheel'}")
    (package / "config" / "c.yaml").write_text(text)

    found = find(
        ROBOT.replace('"l"', '"x_left_wheel"').replace('"r"/>', '"x_right_wheel"/>'), package
    )

    assert found.texts == (text,)


def test_none_of_several_fitting_files_is_read(package: Path) -> None:
    for name in ("a", "b"):
        (package / "config" / f"{name}.yaml").write_text(DRIVE)

    found = find(ROBOT, package)

    assert found.texts == ()
    assert len(found.notes) == 2


@pytest.mark.parametrize(
    "inside",
    [
        '<gazebo><plugin filename="libgazebo_ros_diff_drive.so"/></gazebo>',
        '<gazebo><plugin filename="gz-sim-diff-drive-system"/></gazebo>',
    ],
    ids=["ros", "gz-sim"],
)
def test_nothing_is_searched_for_a_robot_with_a_drive(inside: str, package: Path) -> None:
    (package / "config" / "c.yaml").write_text(DRIVE)

    assert find(f'<robot name="r">{JOINTS}{inside}</robot>', package) == ControllerTexts()


@pytest.mark.parametrize("text", ["<robot", "<!DOCTYPE a><robot/>", "text"])
def test_text_that_is_no_description_names_no_files(text: str, package: Path) -> None:
    assert find(text, package) == ControllerTexts()


def test_given_files_are_read_in_order(tmp_path: Path) -> None:
    files = [tmp_path / "a.yaml", tmp_path / "b.txt"]
    for file in files:
        file.write_text(file.name)

    assert read_controller_files(files).texts == ("a.yaml", "b.txt")


def test_given_file_that_is_missing_or_too_large_is_refused(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    large.write_text(" " * (MAX_CONTROLLERS_BYTES + 1))

    with pytest.raises(FileNotFoundError):
        read_controller_files([tmp_path / "none.yaml"])
    with pytest.raises(FileTooLarge):
        read_controller_files([large])


def test_file_beside_the_description_is_preferred_among_several(package: Path) -> None:
    (package / "config" / "other.yaml").write_text(DRIVE)
    (package / "urdf" / "control.yaml").write_text(DRIVE + "\n# own")

    found = find(ROBOT, package)

    assert found.texts == (DRIVE + "\n# own",)
    assert [note.status for note in found.notes] == ["applied"]
