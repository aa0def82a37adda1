"""Names of modules and classes stand once in the whole source tree."""

from benchmarks.house import list_repeated_classes, list_repeated_modules
from tests.contract.repository import ROOT


def test_module_name_stands_once() -> None:
    assert list_repeated_modules(ROOT) == []


def test_class_name_stands_once() -> None:
    assert list_repeated_classes(ROOT) == []
