"""Hunt of mutants: the tests that reach the changed line, nearest first, until one fails."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Literal, TypeAlias

from tests.mutation.code_mutants import CodeMutant
from tests.mutation.forked_pytest import ChosenTests, PytestRun, run_tests
from tests.mutation.reached_lines import FILE_TIMEOUT_S, LineMaps

LEFT_OUT = (".git", ".venv", "build", "dist", ".*_cache", "*.egg-info")
WIDE = (
    "tests/proto",
    "tests/robot_agent",
    "tests/sim_server",
    "tests/spawner/client",
    "tests/spawner/spawn",
    "tests/contract/test_engine*.py",
    "tests/zensim/api",
)
"""Tests that run in one process, for mutants that survive those of their folder."""
Reach: TypeAlias = Literal["module", "folder", "all"]
REACHES: tuple[Reach, ...] = ("module", "folder", "all")
"""Nearest tests first; the others run against what survives."""
SPARE_S = 40.0
SLOWER = 6.0
"""A run may take as many times as long as its tests took when their lines were recorded."""
DELAY_NS = 10_000_000_000
"""By which a changed module is newer than the one before: kept bytecode is known by its time."""


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant.

    Attributes:
        name: See `CodeMutant`.
        killer: Test that failed, or what else ended the run; empty if the mutant survives.
        tests: How many ran against it.
        left_out: Tests that fail without a mutant, too.
    """

    name: str
    killer: str = ""
    tests: int = 0
    left_out: tuple[str, ...] = ()


@dataclass
class Hunter:
    """Puts mutants into a tree of its own.

    Attributes:
        tree: A copy of the repository.
        maps: What tests reach.
        spare_s: Time of a run beside that of its tests, before it is killed.
    """

    tree: Path
    maps: LineMaps
    spare_s: float = SPARE_S
    _unsure: set[str] = field(default_factory=set)
    """Tests that failed once without a mutant."""
    _delays_ns: Iterator[int] = field(default_factory=lambda: count(DELAY_NS, DELAY_NS))

    def hunt(self, mutant: CodeMutant, reach: Reach) -> Verdict:
        """Run tests until one fails by the mutant alone.

        Args:
            mutant: What to change.
            reach: Which tests to run; of other files than the module's own, those that reach it.
        """
        files = list_files(self.tree, mutant.path, reach)
        if reach == "module":
            choice, timeout_s = ChosenTests(files), FILE_TIMEOUT_S
        else:
            choice, timeout_s = self._find_tests(files, mutant)
        killer, ran = self._find_killer(mutant, choice, timeout_s)
        left_out = sorted({*self.maps.failing, *self._unsure})
        return Verdict(mutant.name, killer, ran, tuple(left_out))

    def _find_tests(self, files: list[str], mutant: CodeMutant) -> tuple[ChosenTests, float]:
        """Find the tests that reach a mutant, and the time [s] after which they are killed."""
        module, tests, seconds = str(mutant.path), set[str](), 0.0
        for file in files:
            found = self.maps.find(file, module)
            reached = found.find_tests(module, mutant.line)
            tests.update(reached)
            seconds += sum(found.seconds.get(test, 0.0) for test in reached)
        files = sorted({test.partition("::")[0] for test in tests})
        return ChosenTests(files, tests), self.spare_s + SLOWER * seconds

    def _find_killer(
        self, mutant: CodeMutant, choice: ChosenTests, timeout_s: float
    ) -> tuple[str, int]:
        """Find a test that fails by a mutant, or how else it ends the run; and how many ran."""
        while choice.files:
            run = self._run(mutant, choice, timeout_s)
            if run.ended and not run_tests(self.tree, choice, timeout_s).ended:
                return run.ended, 0
            if run.ended:  # by the load of the machine
                timeout_s *= SLOWER
                continue
            killer = run.failed[0] if run.failed else ""
            if not killer or self._passes_without(killer):
                return killer, len(run.seconds)
            self._unsure.add(killer)
            files = [file for file in choice.files if file not in self._unsure]
            choice = replace(choice, files=files, left_out=frozenset(self._unsure))
        return "", 0

    def _run(self, mutant: CodeMutant, choice: ChosenTests, timeout_s: float) -> PytestRun:
        place = self.tree / mutant.path
        source, times = place.read_text("utf-8"), place.stat()
        place.write_text(mutant.apply(source), "utf-8")
        os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns + next(self._delays_ns)))
        try:
            return run_tests(self.tree, choice, timeout_s)
        finally:
            place.write_text(source, "utf-8")
            os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _passes_without(self, killer: str) -> bool:
        file, _, test = killer.partition("::")
        choice = ChosenTests((file,), {killer} if test else None)
        run = run_tests(self.tree, choice, FILE_TIMEOUT_S)
        return not run.failed and not run.ended


def copy_tree(root: Path, folder: Path) -> Path:
    """Copy a repository, with kept bytecode, into a folder."""
    ignored = shutil.ignore_patterns(*LEFT_OUT)
    return Path(shutil.copytree(root, folder / "tree", symlinks=True, ignore=ignored))


def list_files(tree: Path, module: Path, reach: Reach) -> list[str]:
    """List the test files of a module: its own, those of its folder, or those of others."""
    folder = Path("tests") / module.parent
    if reach == "module":
        return _list_files(tree, f"{folder}/test_{module.stem}*.py")
    if reach == "folder":
        return _list_files(tree, f"{folder}/**/test_*.py")
    patterns = [one if one.endswith(".py") else f"{one}/**/test_*.py" for one in WIDE]
    files = [file for pattern in patterns for file in _list_files(tree, pattern)]
    return [file for file in files if folder not in Path(file).parents]


def _list_files(tree: Path, pattern: str) -> list[str]:
    return sorted(str(path.relative_to(tree)) for path in tree.glob(pattern))
