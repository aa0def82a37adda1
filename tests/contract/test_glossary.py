"""The glossary against the source tree."""

from benchmarks.house import GLOSSARY, MODULES_HEAD, write_module_list
from tests.contract.repository import ROOT, text_of


def test_glossary_lists_the_modules_of_the_tree() -> None:
    _, _, listed = text_of(GLOSSARY).partition(MODULES_HEAD)

    assert listed == write_module_list(ROOT), "run 'python -m benchmarks.house --modules'"


def test_module_says_in_one_sentence_what_it_holds() -> None:
    lines = write_module_list(ROOT).split("\n- ")

    assert [line for line in lines if line.rstrip().endswith("`:")] == []
