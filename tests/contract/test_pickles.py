"""No program reads a pickle, which can run code, but from its own child processes."""

import re
from pathlib import Path

import zensim

READS = re.compile(r"\bpickle\.(loads?|Unpickler)\b|\ballow_pickle=True\b|\b(cloudpickle|dill)\b")
PIPES = {"sim_server/physics/cell_worker.py": "calls of the server that started the process"}
"""Modules that read pickles, and of whom; their other end is a process of the same program."""


def test_no_module_reads_a_pickle_of_a_file() -> None:
    root = Path(next(iter(zensim.__path__))).parent
    programs = ("proto", "sim_server", "spawner", "robot_agent", "zensim", "deploy")
    paths = [path for name in programs for path in (root / name).rglob("*.py")]

    found = {path.relative_to(root).as_posix() for path in paths if READS.search(path.read_text())}

    assert len(paths) > len(programs)
    assert found == set(PIPES)
