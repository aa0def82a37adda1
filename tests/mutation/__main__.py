"""`python -m tests.mutation [--count N] [--seed S] [FOLDER ...]`: mutants that no test notices.

Mutants are sampled from the code. Each is put into a copy of the tree, and the tests that reach the
changed line run against it: first those of the module, then those of its folder, and for what
survives all others that run in one process. Which test reaches which line is found when first
needed, and kept in build/mutants; so are the verdicts, and a later run goes on with what survived
or is new. Printed are the survivors. Those that change nothing are listed, with the reason, in
equivalent_mutants.py. The status is 1 when more than one in twenty of the others survived.
"""

import argparse
import json
import multiprocessing
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from benchmarks.machine import ROOT
from tests.mutation.code_mutants import CodeMutant, sample_mutants
from tests.mutation.equivalent_mutants import EQUIVALENTS
from tests.mutation.forked_pytest import import_libraries
from tests.mutation.mutant_hunt import REACHES, Hunter, Reach, Verdict, copy_tree
from tests.mutation.reached_lines import LineMaps

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
KEPT = ROOT / "build" / "mutants"
MAX_SURVIVING_SHARE = 0.05
PROCESSES = 2
NICENESS = 19
_HUNTER: list[Hunter] = []
"""That of this process."""


def main() -> int:
    """Run the tests against each mutant; return the exit status."""
    arguments = _parse()
    os.nice(NICENESS)
    paths = [
        path.relative_to(ROOT)
        for folder in arguments.folders
        for path in sorted(ROOT.glob(f"{folder}/**/*.py"))
    ]
    mutants = sample_mutants(ROOT, paths, arguments.count, arguments.seed)
    verdicts = {} if arguments.anew else _read_verdicts()
    todo = [
        mutant
        for mutant in mutants
        if mutant.name not in EQUIVALENTS and not verdicts.get(mutant.name, Verdict("")).killer
    ]
    import_libraries()
    modules = sorted({str(mutant.path) for mutant in mutants})
    for verdict in _hunt_all(todo, modules, REACHES[: 1 + REACHES.index(arguments.reach)]):
        verdicts[verdict.name] = verdict
    return _report(mutants, verdicts)


def _hunt_all(
    mutants: list[CodeMutant], modules: list[str], reaches: Sequence[Reach]
) -> Iterator[Verdict]:
    """Hunt with the nearest tests, then what survives with others; keep and print verdicts."""
    with (
        tempfile.TemporaryDirectory(prefix="zensim-mutants-") as folder,
        ProcessPoolExecutor(
            PROCESSES,
            multiprocessing.get_context("fork"),
            initializer=_start_hunter,
            initargs=(folder, modules),
        ) as pool,
    ):
        surviving = mutants
        for reach in reaches:
            runs = {pool.submit(_hunt, one, reach): one for one in surviving}
            surviving = []
            for number, run in enumerate(as_completed(runs), 1):
                verdict = run.result()
                killer = verdict.killer or f"SURVIVES {verdict.tests} tests"
                print(f"{reach} {number}/{len(runs)} {runs[run]}: {killer}", flush=True)  # noqa: T201
                surviving += [] if verdict.killer else [runs[run]]
                _keep(verdict)
                yield verdict


def _start_hunter(folder: str, modules: list[str]) -> None:
    place = Path(folder) / str(os.getpid())
    place.mkdir()
    tree = copy_tree(ROOT, place)
    _HUNTER.append(Hunter(tree, LineMaps(KEPT / "lines", tree, modules)))


def _hunt(mutant: CodeMutant, reach: Reach) -> Verdict:
    return _HUNTER[0].hunt(mutant, reach)


def _read_verdicts() -> dict[str, Verdict]:
    file = KEPT / "verdicts.jsonl"
    lines = file.read_text("utf-8").splitlines() if file.exists() else []
    verdicts = (Verdict(**json.loads(line)) for line in lines)
    return {verdict.name: verdict for verdict in verdicts}


def _keep(verdict: Verdict) -> None:
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / "verdicts.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(verdict.__dict__) + "\n")


def _report(mutants: Iterable[CodeMutant], verdicts: dict[str, Verdict]) -> int:
    """Print the survivors and the counts; return the exit status."""
    changing = [mutant for mutant in mutants if mutant.name not in EQUIVALENTS]
    surviving = [one for one in changing if not verdicts.get(one.name, Verdict("")).killer]
    for mutant in surviving:
        print(f"SURVIVES: {mutant.name} (line {mutant.line})")  # noqa: T201
    for test in sorted({test for one in verdicts.values() for test in one.left_out}):
        print(f"left out, fails without a mutant: {test}")  # noqa: T201
    killed = len(changing) - len(surviving)
    share = killed / len(changing) if changing else 1.0
    print(  # noqa: T201
        f"{killed} of {len(changing)} mutants that change something were noticed "
        f"({share:.0%}, asked {1.0 - MAX_SURVIVING_SHARE:.0%})"
    )
    return int(share < 1.0 - MAX_SURVIVING_SHARE)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("folders", nargs="*", default=FOLDERS, metavar="FOLDER")
    parser.add_argument("--count", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--reach", choices=REACHES, default="all", help="tests of which folders")
    parser.add_argument("--anew", action="store_true", help="forget the verdicts of earlier runs")
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
