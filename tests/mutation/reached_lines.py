"""Which tests reach which lines: found once for each test file, and kept."""

import fcntl
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from tests.mutation.forked_pytest import ChosenTests, PytestRun, run_tests

FILE_TIMEOUT_S = 1200.0
"""For all tests of a file, with their lines recorded."""


@dataclass
class ReachedLines:
    """What the tests of one file reach.

    Attributes:
        digest: Of the file.
        modules: Digests of the modules in which lines were recorded.
        seconds: Time of each test.
        failing: Tests that failed on unchanged code; no choice has them.
        lines: For each module, line and the tests that reached it; "" is its import.
    """

    digest: str
    modules: dict[str, str]
    seconds: dict[str, float] = field(default_factory=dict)
    failing: list[str] = field(default_factory=list)
    lines: dict[str, dict[int, list[str]]] = field(default_factory=dict)

    @property
    def tests(self) -> list[str]:
        """All tests that pass on unchanged code."""
        return sorted(self.seconds.keys() - set(self.failing))

    def find_tests(self, module: str, line: int) -> list[str]:
        """Find the tests that reach a line; all that reach the module for a line of its import."""
        lines = self.lines.get(module, {})
        reached = max((one for one in lines if one <= line), default=None)
        if reached is None:
            return []
        tests = {test for test in lines[reached] if test}
        if "" in lines[reached] and not tests:
            tests = {test for found in lines.values() for test in found if test} or set(self.tests)
        return sorted(tests.difference(self.failing))


class LineMaps:
    """What test files reach in some modules; kept in a folder as long as they do not change.

    Args:
        folder: Of the maps.
        tree: A copy of the repository.
        modules: Of which lines are recorded, by their path in the tree.
    """

    def __init__(self, folder: Path, tree: Path, modules: list[str]) -> None:
        self._folder, self._tree = folder, tree
        self._modules = {module: _digest(tree / module) for module in modules}
        self._known: dict[str, ReachedLines] = {}

    def find(self, file: str, module: str) -> ReachedLines:
        """Return the map of a test file; runs its tests unless a kept map has the module."""
        known = self._known.get(file)
        if known is None or known.modules.get(module) != self._modules[module]:
            known = self._known[file] = self._read_or_make(file, module)
        return known

    @property
    def failing(self) -> Iterator[str]:
        """Tests that fail on unchanged code, of the files that were asked for."""
        for known in self._known.values():
            yield from known.failing

    def _read_or_make(self, file: str, module: str) -> ReachedLines:
        place = self._folder / f"{file.replace('/', '.')}.json"
        with _locked(place.with_suffix(".lock")):
            if place.exists():
                kept = _read(place)
                if self._is_current(kept, file, module):
                    return kept
            made = self._make(file)
            part = place.with_suffix(".part")
            part.write_text(json.dumps(made.__dict__), "utf-8")
            part.rename(place)
            return made

    def _is_current(self, kept: ReachedLines, file: str, module: str) -> bool:
        is_same_file = kept.digest == _digest(self._tree / file)
        return is_same_file and kept.modules.get(module) == self._modules[module]

    def _make(self, file: str) -> ReachedLines:
        choice = ChosenTests((file,), measured=tuple(self._modules), is_ended_by_failure=False)
        run = run_tests(self._tree, choice, FILE_TIMEOUT_S)
        if run.ended:
            run = PytestRun(failed=[f"{file} ({run.ended})"])
        return ReachedLines(
            _digest(self._tree / file), self._modules, run.seconds, run.failed, run.lines
        )


@contextmanager
def _locked(file: Path) -> Iterator[None]:
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield


def _read(place: Path) -> ReachedLines:
    kept = ReachedLines(**json.loads(place.read_text("utf-8")))
    kept.lines = {
        module: {int(line): tests for line, tests in lines.items()}
        for module, lines in kept.lines.items()
    }
    return kept


def _digest(file: Path) -> str:
    return sha256(file.read_bytes()).hexdigest()
