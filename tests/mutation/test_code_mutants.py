"""Mutants change one place, compile, and are noticed by tests that check it."""

from pathlib import Path

import pytest

from tests.mutation.__main__ import FOLDERS, list_stages
from tests.mutation.code_mutants import CodeMutant, list_mutants, sample_mutants
from zensim import proto

HERE = Path("a.py")
ROOT = Path(proto.__file__).resolve().parents[1]


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


def test_sample_is_the_same_for_a_seed(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text("\n".join(f"x{n} = {n} + {n}" for n in range(20)))

    samples = [sample_mutants([path], 5, seed) for seed in (1, 1, 2)]

    assert samples[0] == samples[1] != samples[2]


@pytest.mark.parametrize("folder", FOLDERS)
def test_folder_has_code_and_nearest_tests(folder: str) -> None:
    modules = list((ROOT / folder).rglob("*.py"))
    assert modules

    assert next(iter(list_stages(ROOT, Path(folder) / "x.py"))).startswith("tests/")
