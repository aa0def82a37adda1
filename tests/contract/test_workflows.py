"""Workflows of the forge: without mistakes, pinned, and tied to the version that is released."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.contract.repository import ROOT, text_of
from tests.contract.schema_validators import find_schema_mistakes

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
USED = re.compile(r"uses: (\S+)(.*)")
PINNED = re.compile(r"[\w-]+/[\w-]+@[0-9a-f]{40}")
VERSION = "1.2.3"


ACTIONLINT = "github.com/rhysd/actionlint/cmd/actionlint@v1.7.7"
CACHE = Path.home() / ".cache" / "zensim" / "actionlint-1.7.7"


@pytest.fixture(scope="module")
def actionlint() -> str:
    """Find actionlint, or build it once; empty without it and without Go."""
    if found := shutil.which("actionlint") or shutil.which("actionlint", path=str(CACHE)):
        return found
    if go := shutil.which("go"):
        environment = {**os.environ, "GOBIN": str(CACHE)}
        subprocess.run([go, "install", ACTIONLINT], env=environment, check=True, timeout=280)
    return shutil.which("actionlint", path=str(CACHE)) or ""


def find_mistakes(actionlint: str, *paths: Path) -> str:
    """Check the schema of workflows, and where actionlint is, expressions and references, too."""
    found = find_schema_mistakes("vendor.github-workflows", *paths)
    if actionlint:
        words = [actionlint, "-no-color", "-shellcheck=", *map(str, paths)]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        found += done.stdout + done.stderr if done.returncode else ""
    return found


def test_workflows_have_no_mistake(actionlint: str) -> None:
    assert WORKFLOWS
    assert find_mistakes(actionlint, *WORKFLOWS) == ""


MISTAKES = {
    "schema": [
        ("permissions:\n  contents", "permission:\n  contents"),
        ("    environment: pypi\n", "    environments: pypi\n"),
    ],
    "references": [
        ("needs: build\n", "needs: builds\n"),
        ("matrix.machine ==", "matrix.engine =="),
        ("runs-on: ubuntu-24.04\n", "runs-on: ubuntu-4.24\n"),
    ],
}


def is_found(actionlint: str, right: str, wrong: str, folder: Path) -> bool:
    """Whether a mistake in the workflow of releases is found."""
    text = text_of(ROOT / ".github" / "workflows" / "release.yml")
    assert right in text
    changed = folder / "release.yml"
    changed.write_text(text.replace(right, wrong), encoding="utf-8")
    return find_mistakes(actionlint, changed) != ""


@pytest.mark.parametrize(("right", "wrong"), MISTAKES["schema"])
def test_mistakes_of_the_schema_are_found(right: str, wrong: str, tmp_path: Path) -> None:
    assert is_found("", right, wrong, tmp_path)


@pytest.mark.parametrize(("right", "wrong"), MISTAKES["references"])
def test_mistakes_in_references_are_found_by_actionlint(
    right: str, wrong: str, actionlint: str, tmp_path: Path
) -> None:
    assert is_found(actionlint, right, wrong, tmp_path) == bool(actionlint)


def test_actions_of_others_are_pinned_to_commits_with_their_version() -> None:
    used = [found for path in WORKFLOWS for found in USED.findall(text_of(path))]

    assert used
    assert [name for name, _ in used if not PINNED.fullmatch(name)] == []
    assert [name for name, remark in used if not re.match(r" # v\d+\.\d+\.\d+", remark)] == []


def test_workflow_runs_what_a_developer_runs() -> None:
    assert "run: bash .ci/run\n" in text_of(ROOT / ".github" / "workflows" / "ci.yml")


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """Make what a release of a version has."""
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "release_name", tmp_path / ".ci")
    (tmp_path / "pyproject.toml").write_text(f'[project]\nversion = "{VERSION}"\n')
    (tmp_path / "CHANGELOG.md").write_text(f"## [{VERSION}] - 2026-12-01\n")
    (tmp_path / "tests" / "integration" / "kept_journals" / VERSION).mkdir(parents=True)
    return tmp_path


def check_name(release: Path, tag: str) -> int:
    command = ["sh", str(release / ".ci" / "release_name"), tag]
    return subprocess.run(command, capture_output=True, check=False).returncode


def test_tag_of_a_prepared_release_is_accepted(release: Path) -> None:
    assert check_name(release, f"v{VERSION}") == 0


@pytest.mark.parametrize("tag", [VERSION, "v1.2.4", "v1.2", "v"])
def test_tag_of_another_name_is_refused(release: Path, tag: str) -> None:
    assert check_name(release, tag) == 1


@pytest.mark.parametrize("lacking", ["CHANGELOG.md", "tests"])
def test_tag_is_refused_while_something_of_the_release_lacks(release: Path, lacking: str) -> None:
    (release / lacking).rename(release / "elsewhere")

    assert check_name(release, f"v{VERSION}") == 1
