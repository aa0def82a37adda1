"""Proofs of engines in the cache folder, and what makes one invalid."""

import os
import sys
from pathlib import Path

import pytest

from zensim.proto.engine_proofs import (
    CaseResult,
    EngineBuild,
    EngineProof,
    find_engine_build,
    find_proofs_folder,
    read_proof,
    write_proof,
)

PASSED = CaseResult("pendulum", "period [s]", 1.5, 1.501, 0.01)
FAILED = CaseResult("held arm", "sag [rad]", 0.2, 0.0, 0.002)
NO_NUMBER = CaseResult("held arm", "sag [rad]", None, 0.0, 0.002)
RAISED = CaseResult("held arm", "sag [rad]", None, 0.0, 0.002, "SystemError: no")
BUILD = EngineBuild("mujoco", "4.0.1", "0123456789abcdef")


@pytest.fixture(autouse=True)
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make an installed engine, and return its library."""
    package = tmp_path / "packages" / "mujoco"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = package / "libmujoco.so.1.2.3"
    file.write_bytes(b"library")
    os.utime(file, (1e9, 1e9))
    return file


def test_proof_is_read_as_it_was_written() -> None:
    proof = EngineProof(BUILD, (PASSED, NO_NUMBER), 1.7e9)

    write_proof(proof)

    assert read_proof(BUILD) == proof


def test_proof_of_another_build_is_none() -> None:
    write_proof(EngineProof(BUILD, (PASSED,), 1.7e9))

    assert read_proof(EngineBuild("mujoco", "4.0.1", "f" * 16)) is None
    assert read_proof(EngineBuild("mujoco", "4.0.2", BUILD.digest)) is None
    assert read_proof(EngineBuild("pybullet", "4.0.1", BUILD.digest)) is None


def test_proof_whose_file_was_renamed_is_none() -> None:
    write_proof(EngineProof(BUILD, (PASSED,), 1.7e9))
    (file,) = find_proofs_folder().iterdir()
    file.rename(file.with_name(file.name.replace("4.0.1", "4.0.0")))

    assert read_proof(EngineBuild("mujoco", "4.0.0", BUILD.digest)) is None


@pytest.mark.parametrize("result", [FAILED, NO_NUMBER, RAISED])
def test_first_case_that_failed_is_named(result: CaseResult) -> None:
    proof = EngineProof(BUILD, (PASSED, result, FAILED), 1.7e9)

    assert proof.failed is result
    assert "held arm" in result.describe()
    assert EngineProof(BUILD, (PASSED,), 1.7e9).failed is None


def test_build_is_the_same_while_nothing_changes() -> None:
    assert find_engine_build("mujoco") == find_engine_build("mujoco")


def test_build_changes_with_size_date_or_name_of_the_library(library: Path) -> None:
    builds = [find_engine_build("mujoco")]

    os.utime(library, (1e9, 1e9 + 60))
    builds.append(find_engine_build("mujoco"))
    library.write_bytes(b"another library")
    os.utime(library, (1e9, 1e9 + 60))
    builds.append(find_engine_build("mujoco"))
    library.rename(library.with_name("libmujoco.so.1.2.4"))
    builds.append(find_engine_build("mujoco"))

    assert len(set(builds)) == len(builds)


def test_build_is_that_of_the_first_folder_on_the_path(library: Path) -> None:
    hidden = find_engine_build("mujoco")

    library.unlink()

    assert find_engine_build("mujoco") != hidden
