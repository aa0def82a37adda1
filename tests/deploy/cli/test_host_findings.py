"""What `zensim doctor` says of its host."""

import time
from pathlib import Path

import pytest

from zensim.deploy.cli.findings import Finding, FindingMark, choose_exit_status
from zensim.deploy.cli.host_findings import describe_host, format_age
from zensim.proto.engine_proofs import CaseResult, EngineProof, find_engine_build, write_proof
from zensim.proto.exit_codes import ExitCode

BUILD = find_engine_build("mujoco")
SOUND = CaseResult("pendulum", "period [s]", 1.5, 1.5, 0.01)
WRONG = CaseResult("pendulum", "period [s]", 1.6, 1.5, 0.01)


@pytest.fixture(autouse=True)
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def engine_row() -> Finding:
    return next(one for one in describe_host() if one.found.startswith("mujoco"))


def test_host_is_described_by_python_packages_engines_and_cache(caches: Path) -> None:
    found = list(describe_host())

    assert [one.what for one in found] == ["python", "packages", "engine", "engine", "cache"]
    assert "numpy" in found[1].found
    assert str(caches) in found[-1].found


@pytest.mark.parametrize(
    ("result", "mark", "status"), [(SOUND, "ok", ExitCode.OK), (WRONG, "wrong", ExitCode.FAILED)]
)
def test_engine_is_shown_with_version_result_and_age(
    result: CaseResult, mark: FindingMark, status: ExitCode
) -> None:
    write_proof(EngineProof(BUILD, (result,), time.time() - 7300.0))

    row = engine_row()

    assert (row.mark, choose_exit_status([row])) == (mark, status)
    assert BUILD.version in row.found
    assert "2 hours" in row.found


def test_engine_without_a_proof_is_a_note() -> None:
    assert engine_row().mark == "note"


def test_user_without_a_home_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", refuse)

    assert list(describe_host())[-1].mark == "note"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(-2.0, "0 seconds"), (119.0, "119 seconds"), (120.0, "2 minutes"), (2e6, "23 days")],
)
def test_age_is_written_in_its_greatest_unit(seconds: float, text: str) -> None:
    assert format_age(seconds) == text
