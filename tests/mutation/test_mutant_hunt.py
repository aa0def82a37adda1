"""Mutants are put into a tree, and killed by the tests that reach them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = {
    "pyproject.toml": "[tool.pytest.ini_options]\n",
    "zensim/__init__.py": "",
    "zensim/testing.py": "",
    "zensim/signs.py": """
LEAST = 0

def sign(x):
    if x < LEAST:
        return -1
    return 1

def count(x):
    while x != 5:
        x -= 1
    return x
""",
    "tests/zensim/test_signs.py": """
from zensim.signs import sign

def test_negative():
    assert sign(-2) < 0

def test_positive():
    assert sign(3) > 0

def test_that_fails_anyway():
    assert sign(3) > 8
""",
    "tests/zensim/test_counts.py": """
from zensim.signs import count

def test_count():
    assert count(8) == 5
""",
}
NEGATED, WIDENED = "if x < LEAST:: x < LEAST -> not (x < LEAST)", "if x < LEAST:: < -> <="
ENDLESS, IMPORTED = "x -= 1: 1 -> (1 + 1)", "LEAST = 0: 0 -> (0 + 1)"
HUNTED = (NEGATED, WIDENED, ENDLESS, IMPORTED)
PROGRAM = """
import json, sys
from pathlib import Path
from tests.mutation.code_mutants import list_mutants
from tests.mutation.mutant_hunt import Hunter
from tests.mutation.reached_lines import LineMaps

tree, module = Path(sys.argv[1]), Path("zensim/signs.py")
source = (tree / module).read_text()
maps = LineMaps(tree / "lines", tree, [str(module)])
hunters = {True: Hunter(tree, maps, spare_s=2.0), False: Hunter(tree, maps, spare_s=100.0)}
found = {
    one.name: hunters["x -= 1" in one.name].hunt(one, "folder").__dict__
    for one in list_mutants(module, source)
    if one.name.partition(": ")[2] in sys.argv[2:]
}
is_restored = source == (tree / module).read_text()
print(json.dumps({"found": found, "is_restored": is_restored}))
"""


@pytest.fixture(scope="module")
def hunted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, object]]:
    """Hunt mutants of a small tree; return the verdicts by line and change."""
    tree = tmp_path_factory.mktemp("tree")
    for name, text in FILES.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tree), *HUNTED],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=200.0,
    )
    answer = json.loads(done.stdout)
    assert answer["is_restored"]
    return {name.partition(": ")[2]: verdict for name, verdict in answer["found"].items()}


def test_mutant_is_killed_by_a_test_that_reaches_its_line(
    hunted: dict[str, dict[str, object]],
) -> None:
    assert hunted[NEGATED]["killer"] in {
        "tests/zensim/test_signs.py::test_negative",
        "tests/zensim/test_signs.py::test_positive",
    }


def test_mutant_that_no_test_notices_survives(hunted: dict[str, dict[str, object]]) -> None:
    assert not hunted[WIDENED]["killer"]


def test_mutant_that_hangs_is_killed_by_the_time_limit(
    hunted: dict[str, dict[str, object]],
) -> None:
    assert hunted[ENDLESS]["killer"] == "time limit"


def test_line_of_the_import_is_reached_by_all_tests_of_the_module(
    hunted: dict[str, dict[str, object]],
) -> None:
    verdict = hunted[IMPORTED]

    assert (verdict["killer"], verdict["tests"]) == ("", 3)


def test_test_that_fails_anyway_kills_nothing(hunted: dict[str, dict[str, object]]) -> None:
    failing = "tests/zensim/test_signs.py::test_that_fails_anyway"

    assert all(verdict["killer"] != failing for verdict in hunted.values())
    assert all(failing in verdict["left_out"] for verdict in hunted.values())  # type: ignore[operator]
