"""Hunt of mutants: the tests that reach the changed line, nearest first, until one fails."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
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
MTIME_NS = 10_000_000_000
"""By which a changed module is newer: its kept bytecode has the time of the unchanged one."""


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


@dataclass(frozen=True)
class HuntStage:
    """Test files that run together.

    Attributes:
        files: By their path in the tree.
        is_whole: Whether all their tests run, not only those that reach the line.
    """

    files: list[str]
    is_whole: bool = False


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

    def hunt(self, mutant: CodeMutant, reach: Reach) -> Verdict:
        """Run tests until one fails by the mutant alone.

        Args:
            mutant: What to change.
            reach: Which tests to run.
        """
        tests, killer = set[str](), ""
        for stage in list_stages(self.tree, mutant.path, reach):
            found, seconds = self._find_tests(stage, mutant)
            chosen = found.difference(tests)
            tests |= chosen
            if killer := self._find_killer(mutant, chosen, seconds):
                break
        left_out = sorted({*self.maps.failing, *self._unsure})
        return Verdict(mutant.name, killer, len(tests), tuple(left_out))

    def _find_tests(self, stage: HuntStage, mutant: CodeMutant) -> tuple[set[str], float]:
        """Find the tests of a stage, and how long they take [s]."""
        module, tests, seconds = str(mutant.path), set[str](), 0.0
        for file in stage.files:
            found = self.maps.find(file, module)
            chosen = found.tests if stage.is_whole else found.find_tests(module, mutant.line)
            tests.update(chosen)
            seconds += sum(found.seconds.get(test, 0.0) for test in chosen)
        return tests, seconds

    def _find_killer(self, mutant: CodeMutant, tests: set[str], seconds: float) -> str:
        timeout_s = self.spare_s + SLOWER * seconds
        while left := tests - self._unsure:
            run = self._run(mutant, left, timeout_s)
            if run.ended and not self._ends_without(left, timeout_s):
                return run.ended
            if run.ended:  # by the load of the machine
                timeout_s *= SLOWER
                continue
            if not run.failed:
                return ""
            killer = run.failed[0]
            if killer not in tests or self._passes_without(killer):
                return killer
            self._unsure.add(killer)
        return ""

    def _run(self, mutant: CodeMutant, tests: set[str], timeout_s: float) -> PytestRun:
        place = self.tree / mutant.path
        source, times = place.read_text("utf-8"), place.stat()
        place.write_text(mutant.apply(source), "utf-8")
        os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns + MTIME_NS))
        try:
            return run_tests(self.tree, _choose(tests), timeout_s)
        finally:
            place.write_text(source, "utf-8")
            os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _ends_without(self, tests: set[str], timeout_s: float) -> bool:
        return bool(run_tests(self.tree, _choose(tests), timeout_s).ended)

    def _passes_without(self, test: str) -> bool:
        run = run_tests(self.tree, _choose({test}), FILE_TIMEOUT_S)
        return not run.failed and not run.ended


def _choose(tests: set[str]) -> ChosenTests:
    return ChosenTests(sorted({test.partition("::")[0] for test in tests}), tests)


def copy_tree(root: Path, folder: Path) -> Path:
    """Copy a repository, with kept bytecode, into a folder."""
    ignored = shutil.ignore_patterns(*LEFT_OUT)
    return Path(shutil.copytree(root, folder / "tree", symlinks=True, ignore=ignored))


def list_stages(tree: Path, module: Path, reach: Reach) -> Iterator[HuntStage]:
    """List the test files of a module: its own, those of its folder, or those of others."""
    folder = Path("tests") / module.parent
    if reach == "module":
        own = _list_files(tree, f"{folder}/test_{module.stem}*.py")
        yield HuntStage(own)
        # A value that is kept is made in the first test that needs it, and checked in later ones.
        yield HuntStage(own, is_whole=True)
    elif reach == "folder":
        yield HuntStage(_list_files(tree, f"{folder}/**/test_*.py"))
    else:
        patterns = [one if one.endswith(".py") else f"{one}/**/test_*.py" for one in WIDE]
        files = [file for pattern in patterns for file in _list_files(tree, pattern)]
        yield HuntStage([file for file in files if folder not in Path(file).parents])


def _list_files(tree: Path, pattern: str) -> list[str]:
    return sorted(str(path.relative_to(tree)) for path in tree.glob(pattern))
