"""Limits of functions and of the content of tracked files."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.contract.repository import PACKAGES, ROOT, files, shown, text_of

MAX_FUNCTION_LINES = 40
MAX_FILE_BYTES = 1_000_000
MAX_FILM_BYTES = 3_000_000
# Split, so that this file does not match itself.
POSTPONED = re.compile(r"\b(?:TO" r"DO|FIX" r"ME|XX" r"X)\b")
SKIPPED = re.compile(r"\bpytest\.(?:mark\.)?(?:sk" r"ip|xf" r"ail)")
RAW_OUTPUT = re.compile(r"\btyper\.s?echo\(|\bsys\.std(?:out|err)\.write\(|[ =(]Console\(")
PRINTS_OWN_TEXT = ("proto/schema.py",)
SECRET = re.compile(
    r"-----BEGIN [A-Z ]*PRIVATE KEY-----"
    r"|\bAKIA[0-9A-Z]{16}\b"
    r"|\bgh[pousr]_[A-Za-z0-9]{36}\b"
    r"|(?i:\b(?:password|passwd|secret|api_?key|token)\b\s*[:=]\s*[\"'][^\"'\s{}<>$]{12,}[\"'])"
)


def python_files() -> list[Path]:
    return [path for path in files() if path.suffix in {".py", ".pyi"}]


def long_functions(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(text_of(path))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > MAX_FUNCTION_LINES:
                yield f"{shown(path)}:{node.lineno} {node.name}: {lines} lines"


def lines_that_match(pattern: re.Pattern[str]) -> list[str]:
    """List matches in texts; the bytes of a picture may look like any word."""
    return [
        f"{shown(path)}:{number} {match.group()[:20]}"
        for path in files()
        if "\0" not in (text := text_of(path))
        for number, line in enumerate(text.splitlines(), start=1)
        if (match := pattern.search(line))
    ]


def test_function_is_at_most_40_lines() -> None:
    sources = [path for path in python_files() if path.relative_to(ROOT).parts[0] in PACKAGES]

    too_long = [line for path in sources for line in long_functions(path)]

    assert sources
    assert too_long == []


def test_no_file_contains_todo_marks() -> None:
    assert lines_that_match(POSTPONED) == []


def test_no_test_is_skipped() -> None:
    assert lines_that_match(SKIPPED) == []


def test_commands_print_through_what_escapes_control_characters() -> None:
    sources = [path for path in python_files() if path.relative_to(ROOT).parts[0] in PACKAGES]

    found = [
        f"{shown(path)}:{number}"
        for path in sources
        for number, line in enumerate(text_of(path).splitlines(), start=1)
        if RAW_OUTPUT.search(line) and shown(path) not in PRINTS_OWN_TEXT
    ]

    assert found == []


def test_no_file_contains_a_secret() -> None:
    assert lines_that_match(SECRET) == []


def _find_limit(name: str) -> int:
    return MAX_FILM_BYTES if name.endswith(".gif") else MAX_FILE_BYTES


def test_no_file_is_large() -> None:
    sizes = {shown(path): path.stat().st_size for path in files()}

    too_large = {name: size for name, size in sizes.items() if size > _find_limit(name)}

    assert too_large == {}
