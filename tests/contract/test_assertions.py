"""Tests assert codes, slugs and values of errors, not their wording."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.contract.repository import ROOT, shown, text_of

RAISES = "pytest.raises"
SENTENCE = re.compile(r"[A-Za-z]+(?: [A-Za-z]+){2}")
"""Three words in a row."""


def find_sentences(path: Path) -> Iterator[str]:
    """Find `match` patterns of `pytest.raises` that contain a sentence."""
    text = text_of(path)
    for node in ast.walk(ast.parse(text)) if "match" in text else ():
        if isinstance(node, ast.Call) and node.keywords and ast.unparse(node.func) == RAISES:
            for keyword in node.keywords:
                pattern = ast.unparse(keyword.value)
                if keyword.arg == "match" and SENTENCE.search(pattern):
                    yield f"line {node.lineno}: {pattern}"


@pytest.mark.parametrize("path", sorted((ROOT / "tests").rglob("test_*.py")), ids=shown)
def test_expected_errors_match_values_not_sentences(path: Path) -> None:
    assert list(find_sentences(path)) == []
