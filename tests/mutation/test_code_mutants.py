"""Mutants change one place, compile, and are noticed by tests that check it."""

from pathlib import Path

import pytest

from tests.mutation.__main__ import FOLDERS
from tests.mutation.code_mutants import CodeMutant, list_mutants, sample_mutants
from tests.mutation.mutant_hunt import list_files

HERE = Path("a.py")
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("source", "mutants"),
    [
        ("a < b", {"a <= b"}),
        ("a - b * c", {"a + b * c", "a - b / c"}),
        ("a is not b", {"a is b"}),
        ("a and b and c", {"a or b and c", "a and b or c"}),
        ("x = 2", {"x = (2 + 1)"}),
        ("x = True", {"x = False"}),
        ("f(é, a == b)", {"pass", "f(é, a != b)"}),
        ("while f(): pass", {"while not (f()): pass"}),
        ("'text'", set()),
    ],
)
def test_mutants_of_a_line(source: str, mutants: set[str]) -> None:
    assert {mutant.apply(source) for mutant in list_mutants(HERE, source)} == mutants


def test_mutant_of_another_text_is_refused() -> None:
    with pytest.raises(ValueError, match=r"a\.py:1"):
        CodeMutant(HERE, 1, "<", "<=", 2).apply("a > b")


def test_names_of_like_mutants_differ_and_outlast_other_changes() -> None:
    first, second = (one.name for one in list_mutants(HERE, "a < b\na < b"))

    (later,) = (one for one in list_mutants(HERE, "x = y\n\na < b"))

    assert first != second
    assert later.name == first


def test_branch_for_type_checkers_has_no_mutants() -> None:
    assert list_mutants(HERE, "if TYPE_CHECKING:\n    import a") == []


def test_sample_is_the_same_for_a_seed_and_compiles(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("\n".join(f"x{n} = {n} + {n}" for n in range(20)))
    (tmp_path / "b.py").write_text("x = y == 1\nx = y is y")

    samples = [sample_mutants(tmp_path, [HERE], 5, seed) for seed in (1, 1, 2)]
    both = sample_mutants(tmp_path, [HERE, Path("b.py")], 1000, 1)

    assert samples[0] == samples[1] != samples[2]
    assert [one for one in both if one.path == HERE][:5] == samples[0]
    assert len(both) == 20 * 3 + 3


@pytest.mark.parametrize("folder", FOLDERS)
def test_folder_has_code_and_nearest_tests(folder: str) -> None:
    modules = [path.relative_to(ROOT) for path in (ROOT / folder).rglob("*.py")]

    assert any(list_files(ROOT, module, "module") for module in modules)
