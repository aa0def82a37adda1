"""Figures of the source tree: each has a ceiling, which only falls."""

import ast
import socket

import pytest

from benchmarks import house
from tests.contract.repository import ROOT


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
