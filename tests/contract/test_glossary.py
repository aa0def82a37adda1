"""The glossary against the source tree."""

import pytest

from benchmarks.house import GLOSSARY, MODULES_HEAD, write_module_list
from tests.contract.repository import ROOT, text_of


@pytest.fixture(scope="module")
def module_list() -> str:
    return write_module_list(ROOT)


def test_glossary_lists_the_modules_of_the_tree(module_list: str) -> None:
    _, _, listed = text_of(GLOSSARY).partition(MODULES_HEAD)

    assert listed == module_list, "run 'python -m benchmarks.house --modules'"


def test_module_says_in_one_sentence_what_it_holds(module_list: str) -> None:
    lines = module_list.split("\n- ")

    assert [line for line in lines if line.rstrip().endswith("`:")] == []
