"""`python -m tests.mutation [--count N] [--seed S] [FOLDER ...]`: mutants that no test notices.

Mutants are sampled from the code, each is put into a copy of the tree, and the tests that are
nearest to its module run against it, then those of its folder, then those of its program and the
contracts. Printed are the mutants that survive all of them. Some change nothing that matters, such
as a greater buffer: read them. The status is 1 when more than one in ten survived.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.machine import ROOT
from tests.mutation.code_mutants import CodeMutant, sample_mutants

FOLDERS = (
    "proto/drives",
    "proto/codec",
    "robot_agent",
    "sim_server/world",
    "sim_server/journal",
    "sim_server/description",
    "sim_server/physics",
    "sim_server/runtime",
    "sim_server/services",
    "sim_server/pacing",
    "spawner/spawn",
    "spawner/client",
)
CONTRACTS = ("tests/contract", "tests/zensim", "tests/integration")
MAX_SURVIVING_SHARE = 0.1
TIMEOUT_S = 1200.0
NO_TESTS = 5
"""Status of pytest when every test is left out."""
LEFT_OUT = (".git", ".venv", "build", "dist", ".*_cache", "__pycache__", "*.egg-info")


def main() -> int:
    """Run the tests against each mutant; return the exit status."""
    arguments = _parse()
    paths = [
        path for folder in arguments.folders for path in sorted(ROOT.glob(f"{folder}/**/*.py"))
    ]
    mutants = sample_mutants(paths, arguments.count, arguments.seed)
    survivors = []
    with tempfile.TemporaryDirectory(prefix="zensim-mutants-") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
        if failing := _find_failing(tree, mutants):
            print(f"tests fail without a mutant: {failing}; mend them first")  # noqa: T201
            return 1
        for number, mutant in enumerate(mutants, 1):
            killer = kill_mutant(tree, mutant)
            place = str(mutant).replace(f"{ROOT}/", "")
            print(f"{number}/{len(mutants)} {killer or 'SURVIVES'}: {place}", flush=True)  # noqa: T201
            survivors += [] if killer else [place]
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} mutants were noticed")  # noqa: T201
    return int(len(survivors) > MAX_SURVIVING_SHARE * len(mutants))


def kill_mutant(tree: Path, mutant: CodeMutant) -> str:
    """Run tests until one fails; return the tests that did, or "" if all passed."""
    module = mutant.path.relative_to(ROOT)
    place = tree / module
    source = place.read_text("utf-8")
    place.write_text(mutant.apply(source), "utf-8")
    try:
        return next((tests for tests in list_stages(tree, module) if not _passes(tree, tests)), "")
    finally:
        place.write_text(source, "utf-8")


def list_stages(tree: Path, module: Path) -> Iterator[str]:
    """List the tests of a module: nearest first, then of its folder, program and contracts."""
    own = Path("tests") / module.parent / f"test_{module.stem}.py"
    candidates = [own, *(Path("tests") / parent for parent in module.parents if parent.parts)]
    yield from (str(path) for path in candidates if (tree / path).exists())
    yield from CONTRACTS


def _find_failing(tree: Path, mutants: list[CodeMutant]) -> str:
    """Find tests that fail on the unchanged tree, among the nearest ones."""
    modules = {mutant.path.relative_to(ROOT) for mutant in mutants}
    nearest = {next(list_stages(tree, module)) for module in modules}
    return next((tests for tests in sorted(nearest) if not _passes(tree, tests)), "")


def _passes(tree: Path, tests: str) -> bool:
    """Whether tests pass within the time; a mutant that hangs is noticed."""
    words = (
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        "-m",
        "not short_form and not browser and not root and not interop",
        tests,
    )
    try:
        done = subprocess.run(
            [sys.executable, "-B", "-m", "pytest", *words],
            cwd=tree,
            env=os.environ | {"PYTHONPATH": str(tree)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode in {0, NO_TESTS}


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("folders", nargs="*", default=FOLDERS, metavar="FOLDER")
    parser.add_argument("--count", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
