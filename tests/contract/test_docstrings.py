"""Docstrings can be read alone: the subject comes first."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.contract.repository import PACKAGES, ROOT, files, shown, text_of

HANGING = re.compile(
    r"(about|above|after|along|around|as|at|because|before|behind|below|between|beyond|by|for|from|"
    r"if|in|it|its|likewise|of|on|per|since|so|than|that|their|then|they|those|to|under|until|"
    r"while|whose|with|within|without)\b",
    re.IGNORECASE,
)
"""Prepositions, conjunctions and pronouns, which depend on a word before them."""


def is_fragment(docstring: str) -> bool:
    """Whether the first word of a docstring depends on a word before it."""
    return HANGING.match(docstring.lstrip()) is not None


def find_fragments(path: Path) -> Iterator[str]:
    """Find the docstrings of a file that are fragments: those of definitions and of values."""
    for node in ast.walk(ast.parse(text_of(path))):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))) if is_fragment(text):
                yield f"{shown(path)}:{node.lineno}: {text.splitlines()[0]}"


@pytest.mark.parametrize(
    ("docstring", "expected"),
    [
        ("Of a step in which contacts slide.", True),
        ("By name.", True),
        ("Its sha256.", True),
        ("Without states for so long, time is taken as stopped.", True),
        ("Friction of a step in which contacts slide.", False),
        ("Find the entity of this name.", False),
        ("See `Entity`.", False),
        ("", False),
    ],
)
def test_fragment_is_a_docstring_without_its_subject(docstring: str, *, expected: bool) -> None:
    assert is_fragment(docstring) is expected


def test_docstrings_can_be_read_alone() -> None:
    modules = [path for path in files() if path.suffix == ".py"]
    product = [path for path in modules if path.relative_to(ROOT).parts[0] in PACKAGES]

    fragments = [found for path in product for found in find_fragments(path)]

    assert product
    assert fragments == [], "begin with the subject:\n" + "\n".join(fragments)
