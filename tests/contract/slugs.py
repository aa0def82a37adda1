"""Slugs of refusals: raised by the code, and listed in the document."""

import ast
import re
from collections.abc import Iterator

from tests.contract.repository import ROOT

SOURCES = (
    *sorted((ROOT / "sim_server").rglob("*.py")),
    ROOT / "proto" / "bounded_files.py",
    ROOT / "zensim" / "recording" / "mcap_scan.py",
)
DOCUMENT = ROOT / "docs" / "refusals.md"
ROW = re.compile(r"^\| `([a-z_]+\.[a-z_<>0-9]+)` \|", re.MULTILINE)
FORMATS = ("urdf", "sdf")
"""Kinds of documents passed to strict_xml."""
PREFIXED = ("PluginTags",)
"""Callables whose `slug` argument is a prefix of the slugs that they raise."""


def raised_slugs() -> set[str]:
    """List `slug` arguments and class attributes; names in an f-string become <tag>."""
    return {
        slug for path in SOURCES for slug in _slugs_in(ast.parse(path.read_text(encoding="utf-8")))
    }


def listed_slugs() -> list[str]:
    """List the slugs of the document's tables."""
    return ROW.findall(DOCUMENT.read_text(encoding="utf-8"))


def _slugs_in(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            for keyword in node.keywords:
                if keyword.arg == "slug":
                    yield from _written(keyword.value, as_prefix=_is_prefix(node))
        elif isinstance(node, ast.ClassDef):
            yield from _of_class(node)


def _of_class(node: ast.ClassDef) -> Iterator[str]:
    for line in node.body:
        if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "slug":
            yield from _written(line.value, as_prefix=False)


def _is_prefix(call: ast.Call) -> bool:
    return ast.unparse(call.func).rpartition(".")[2] in PREFIXED


def _written(value: ast.expr, *, as_prefix: bool) -> Iterator[str]:
    if isinstance(value, ast.Constant) and as_prefix:
        yield f"{value.value!s}.<tag>"
    elif isinstance(value, ast.Constant) and "." in str(value.value):
        yield str(value.value)
    elif isinstance(value, ast.JoinedStr):
        text = "".join(
            str(part.value) if isinstance(part, ast.Constant) else "<tag>" for part in value.values
        )
        if not text.startswith("<tag>"):
            yield text
        elif text == "<tag>.root":
            yield from (text.replace("<tag>", form) for form in FORMATS)
    elif isinstance(value, ast.IfExp):
        yield from _written(value.body, as_prefix=as_prefix)
        yield from _written(value.orelse, as_prefix=as_prefix)
