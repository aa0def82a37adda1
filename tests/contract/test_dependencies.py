"""What our code imports against what pyproject.toml asks for."""

import ast
import sys
from collections.abc import Mapping
from importlib.metadata import packages_distributions, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.contract.repository import PACKAGES, ROOT, files, shown, text_of

EXTRA_OF = {"sim_server": {"", "server"}, "spawner/viewer": {"", "viewer"}}


def outside_imports(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(text_of(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module)
    ours = {*PACKAGES, "tests", *sys.stdlib_module_names}
    return {name.split(".")[0] for name in names} - ours


def declared(extras: set[str]) -> set[str]:
    needs = [Requirement(line) for line in requires("zensim") or []]
    return {
        canonicalize_name(need.name)
        for need in needs
        if need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in extras)
    }


def extras_of(path: Path) -> set[str]:
    name = shown(path)
    if name.startswith("tests/"):
        return {"", "server", "viewer", "dev"}
    return next((ours for part, ours in EXTRA_OF.items() if name.startswith(f"{part}/")), {""})


def undeclared(path: Path, brought_by: Mapping[str, list[str]]) -> set[str]:
    allowed = declared(extras_of(path))
    return {
        name
        for name in outside_imports(path)
        if allowed.isdisjoint(canonicalize_name(package) for package in brought_by.get(name, []))
    }


def test_module_imports_only_what_its_extra_declares() -> None:
    sources = [
        path
        for path in files()
        if path.suffix == ".py" and path.relative_to(ROOT).parts[0] in {*PACKAGES, "tests"}
    ]
    brought_by = packages_distributions()

    found = {shown(path): undeclared(path, brought_by) for path in sources}
    offenders = {name: names for name, names in found.items() if names}

    assert sources
    assert offenders == {}
