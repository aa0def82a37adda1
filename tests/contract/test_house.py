"""Figures of the source tree: each has a ceiling, which only falls."""

import ast
import re
import socket

import pytest

from benchmarks import house
from tests.contract.repository import ROOT, text_of

ARROW = re.compile(r"^ (\w+) +──► (.+)$", re.MULTILINE)
ROOT_PACKAGE = "zensim"
"""Its modules are doors to the packages."""


@pytest.fixture(scope="module")
def figures() -> dict[str, int]:
    return house.measure(ROOT)


@pytest.mark.parametrize("name", [one for one in house.CEILINGS if " of a " not in one])
def test_figure_is_below_its_ceiling(figures: dict[str, int], name: str) -> None:
    assert figures[name] <= house.CEILINGS[name], "python -m benchmarks.house --static --list"


def test_ceilings_are_no_lower_than_goals() -> None:
    assert house.CEILINGS.keys() == house.GOALS.keys()
    assert all(house.CEILINGS[name] >= goal for name, goal in house.GOALS.items())


@pytest.mark.short_form
def test_files_that_flows_run_are_below_their_ceilings() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]

    flows = house.find_flows(ROOT, port)

    found = {name: len(files) for name, files in flows.items()}
    assert all(0 < count <= house.CEILINGS[name] for name, count in found.items()), found


@pytest.mark.parametrize(
    ("text", "seams"),
    [
        ("A = 1\nB = 2\ndef f(): ...\n", 0),
        ("A = 1\ndef f(): ...\nB = 2\nC = 3\nclass D: ...\nE = 1\n", 2),
    ],
)
def test_a_seam_is_where_constants_begin_again(text: str, seams: int) -> None:
    assert house.count_seams(ast.parse(text)) == seams


def test_map_draws_the_imports_of_the_tree() -> None:
    lines = ARROW.findall(text_of(ROOT / "docs" / "architecture.md"))
    drawn = {package: set(targets.split(", ")) for package, targets in lines}

    found: dict[str, set[str]] = {}
    for module, imported in house.list_imports(ROOT).items():
        package = module.partition(".")[0]
        targets = {one.partition(".")[0] for one in imported} - {package, ROOT_PACKAGE}
        if package != ROOT_PACKAGE and targets:
            found.setdefault(package, set()).update(targets)

    assert drawn == found


@pytest.mark.parametrize(
    "package", ["robot_agent", "sim_server", "foxglove", "recording", "envs", "vda5050"]
)
def test_packages_below_the_screens_import_the_client_only(package: str) -> None:
    imported = {
        one
        for module, found in house.list_imports(ROOT).items()
        if module.partition(".")[0] == package
        for one in found
        if one.startswith("spawner")
    }

    assert [one for one in sorted(imported) if not one.startswith("spawner.client")] == []
