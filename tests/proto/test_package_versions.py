"""Tests of the versions of installed packages."""

from pathlib import Path

import pytest

from zensim.proto.package_versions import find_package_version


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder of packages, which comes before those of this environment."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def install(folder: Path, name: str, version: str) -> None:
    metadata = folder / f"{name.replace('-', '_')}-{version}.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")


def test_version_is_that_of_the_package_of_the_same_name(packages: Path) -> None:
    install(packages, "zensim-example", "1.2.3")

    assert find_package_version("zensim-example") == "1.2.3"


def test_version_of_mujoco_is_that_of_the_package_with_the_engine(packages: Path) -> None:
    install(packages, "mujoco", "98.1")
    install(packages, "mujoco-core", "99.2")

    assert find_package_version("mujoco") == "99.2"


def test_version_of_mujoco_before_it_was_divided_is_that_of_its_package(
    packages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.path", [str(packages)])
    install(packages, "mujoco", "3.17.0")

    assert find_package_version("mujoco") == "3.17.0"


@pytest.mark.parametrize("package", ["pybullet", "pybullet-arm64"])
def test_version_of_pybullet_is_that_of_its_package_or_its_fork(
    package: str, packages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.path", [str(packages)])
    install(packages, package, "3.2.8")

    assert find_package_version("pybullet") == "3.2.8"


def test_package_that_is_not_installed_has_no_version() -> None:
    assert find_package_version("zensim-unknown") is None
