"""Files that a run of marked tests does not read have none of its tests."""

import re
from pathlib import Path

import pytest

from tests.conftest import NIGHTLY, WRITTEN_MARKS, find_required_marks, pytest_ignore_collect
from tests.contract.repository import ROOT


def test_marks_of_the_project_are_those_that_files_write() -> None:
    _, _, rest = (ROOT / "pyproject.toml").read_text().partition("\nmarkers = [")

    assert set(re.findall(r'"(\w+): ', rest.partition("\n]")[0])) == {*WRITTEN_MARKS, "release"}


def test_files_of_the_night_exist() -> None:
    assert [path for path in NIGHTLY if not (ROOT / path).exists()] == []


def test_files_of_the_night_have_no_tests_that_it_leaves_out() -> None:
    paths = [ROOT / path for path in NIGHTLY]
    files = [one for path in paths for one in (path.rglob("*.py") if path.is_dir() else [path])]

    assert [one for one in files if re.search(r"mark\.(root|browser)\b", one.read_text())] == []


def test_only_files_of_tests_write_marks() -> None:
    mark = re.compile(rf"mark\.({'|'.join(WRITTEN_MARKS)})\b")

    assert [
        path
        for path in (ROOT / "tests").rglob("*.py")
        if not path.name.startswith("test_") and mark.search(path.read_text())
    ] == []


@pytest.mark.parametrize(
    ("expression", "marks"),
    [
        ("short_form", ["short_form"]),
        ("root and not short_form and not images", ["root"]),
        ("not root and not browser", []),
        ("root or browser", []),
        ("hypothesis", []),
        ("", []),
    ],
)
def test_required_marks_are_those_of_every_selected_test(expression: str, marks: list[str]) -> None:
    assert find_required_marks(expression) == marks


@pytest.mark.parametrize(
    ("expression", "text", "is_left_out"),
    [
        ("browser", "def test_a(): pass", True),
        ("browser", "pytestmark = pytest.mark.browser", None),
        ("not browser", "def test_a(): pass", None),
    ],
)
def test_file_without_the_required_mark_is_left_out(
    tmp_path: Path, expression: str, text: str, *, is_left_out: bool | None
) -> None:
    file = tmp_path / "test_a.py"
    file.write_text(text)
    config = pytest.Config.fromdictargs({"markexpr": expression}, [str(tmp_path)])

    assert pytest_ignore_collect(file, config) is is_left_out
    assert pytest_ignore_collect(tmp_path, config) is None


@pytest.mark.parametrize(
    ("expression", "path", "is_left_out"),
    [
        ("release and not root", "tests/mutation/test_a.py", None),
        ("release and not root", "tests/proto/test_a.py", True),
        ("release", "tests/conftest.py", None),
        ("not release and not root", "tests/mutation/test_a.py", True),
        ("not release and not root", "tests/proto/test_a.py", None),
        ("", "tests/mutation/test_a.py", None),
        ("root or release", "tests/mutation/test_a.py", None),
    ],
)
def test_files_of_the_workshop_are_read_for_a_release(
    tmp_path: Path, expression: str, path: str, *, is_left_out: bool | None
) -> None:
    config = pytest.Config.fromdictargs({"markexpr": expression}, [str(tmp_path)])

    assert pytest_ignore_collect(ROOT / path, config) is is_left_out
