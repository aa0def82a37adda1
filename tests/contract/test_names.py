"""Names of modules and classes are unique in the source tree."""

from benchmarks.house import list_repeated_classes, list_repeated_modules
from tests.contract.repository import ROOT


def test_module_name_is_unique() -> None:
    assert list_repeated_modules(ROOT) == []


def test_class_name_is_unique() -> None:
    assert list_repeated_classes(ROOT) == []
