"""`python -m benchmarks.house [CHECKOUT]`: figures of the source tree, of this checkout or another.

Static figures come from the syntax trees. The files of a flow come from a run: programs record
which functions execute; a function belongs to a flow when it runs with it and not without it.
A run finds more files than a reader opens: each codec, engine layer and table counts.
"""

import argparse
import ast
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

from benchmarks.machine import ROOT

GLOSSARY = ROOT / "docs" / "glossary.md"
MODULES_HEAD = "## Modules\n\n"
PROGRAMS = ("proto", "sim_server", "spawner", "robot_agent", "deploy", "zensim")
SHARED_NAMES = {"cli", "__init__", "__main__"}
"""Names that mean the same in every program."""
TARGETS: Mapping[str, str] = {
    "source files": "<= 280",
    "source lines": "<= 43,000",
    "modules with one importer": "<= 15 %",
    "longest import chain": "<= 18",
    "repeated module names": "0",
    "repeated class names": "0",
    "files of a spawn": "<= 42 by reading",
    "files of a cmd_vel": "<= 24 by reading",
    "files of a tick": "<= 24 by reading",
}
SETTLE_S = 2.0
"""Wall time that programs run in each phase."""
ENDPOINT = "tcp/127.0.0.1:{port}"
RECORDER = """
import json, os, signal, sys, threading
ROOT, OUT = os.environ["HOUSE_ROOT"], os.environ["HOUSE_OUT"]
seen, phase = set(), 0
def record(frame, event, _):
    code = frame.f_code
    if event == "call" and code.co_flags & 1 and code.co_filename.startswith(ROOT):
        seen.add((os.path.realpath(code.co_filename), code.co_qualname))
def flush(*_):
    global phase
    with open(f"{OUT}/{os.getpid()}.{phase}.part", "w") as out:
        json.dump(sorted(seen.copy()), out)
    os.rename(f"{OUT}/{os.getpid()}.{phase}.part", f"{OUT}/{os.getpid()}.{phase}")
    phase += 1
    seen.clear()
signal.signal(signal.SIGUSR1, flush)
import atexit
atexit.register(flush)
threading.setprofile(record)
sys.setprofile(record)
"""

Functions = set[tuple[str, str]]


@cache
def list_modules(root: Path) -> dict[str, Path]:
    """Find the modules of the programs, by import name without `zensim.`."""
    listing = subprocess.run(
        ["git", "ls-files", *(f"{name}/*.py" for name in PROGRAMS)],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    paths = [root / line for line in listing.stdout.splitlines()]
    return {_to_module(path.relative_to(root)): path for path in paths if path.is_file()}


def _to_module(path: Path) -> str:
    parts = path.with_suffix("").parts
    # The folder of the package holds modules of its own beside the links to the programs.
    parts = parts[1:] if parts[0] == "zensim" and len(parts) > 2 else parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def list_imports(root: Path) -> dict[str, set[str]]:
    """Find which of our modules each module imports."""
    modules = list_modules(root)
    return {
        name: {
            found
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            for found in _find_imported(node, modules)
        }
        - {name}
        for name, path in modules.items()
    }


def _find_imported(node: ast.AST, modules: Mapping[str, Path]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module:
        names = [f"{node.module}.{alias.name}" for alias in node.names]
    else:
        return
    for name in (one.removeprefix("zensim.") for one in names):
        yield from [found for found in (name, name.rpartition(".")[0]) if found in modules][:1]


def list_with_one_importer(root: Path) -> list[str]:
    """List the modules that exactly one other module imports."""
    importers = Counter(one for imported in list_imports(root).values() for one in imported)
    return [name for name in _list_named_modules(root) if importers[name] == 1]


def _list_named_modules(root: Path) -> list[str]:
    return [name for name, path in list_modules(root).items() if path.stem not in SHARED_NAMES]


def find_longest_chain(root: Path) -> list[str]:
    """Find the longest path of imports, from a program down."""
    imports, known = list_imports(root), dict[str, list[str]]()

    def follow(name: str, above: tuple[str, ...]) -> list[str]:
        if name not in known:
            below = [follow(one, (*above, name)) for one in imports[name] if one not in above]
            known[name] = [name, *max(below, key=len, default=[])]
        return known[name]

    return max((follow(name, ()) for name in imports), key=len)


def list_repeated_modules(root: Path) -> list[str]:
    """List module names that stand in more than one place."""
    names = Counter(
        path.stem for path in list_modules(root).values() if path.stem not in SHARED_NAMES
    )
    return sorted(name for name, count in names.items() if count > 1)


def list_repeated_classes(root: Path) -> list[str]:
    """List names of classes that more than one module defines."""
    places = defaultdict(list)
    for module, path in list_modules(root).items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(module)
    return sorted(name for name, found in places.items() if len(found) > 1)


class RecordedPrograms:
    """Programs of a checkout that record which functions they run."""

    def __init__(self, root: Path, folder: Path, port: int) -> None:
        self._root, self._folder = root, folder
        self._module = "zensim" if (root / "zensim").exists() else "deploy"
        self._endpoint = ENDPOINT.format(port=port)
        (folder / "out").mkdir()
        (folder / "sitecustomize.py").write_text(RECORDER, encoding="utf-8")
        self._running: list[subprocess.Popen[bytes]] = []
        self._phase = 0

    def start(self, *words: str) -> "subprocess.Popen[bytes]":
        """Start a program."""
        process = subprocess.Popen(
            [sys.executable, "-m", self._module, *words],
            cwd=self._root,
            env=os.environ
            | {"PYTHONPATH": f"{self._folder}:{self._root}"}
            | {"HOUSE_ROOT": str(self._root), "HOUSE_OUT": str(self._folder / "out")}
            | ({} if words[0] == "serve" else {"ZENSIM_CONNECT": self._endpoint}),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._running.append(process)
        return process

    def serve(self) -> None:
        """Start the server and wait until it answers."""
        process = self.start("serve", "--listen", self._endpoint)
        deadline = time.monotonic() + 60
        while self.start("list").wait(30):
            if time.monotonic() > deadline or process.poll() is not None:
                raise RuntimeError("the server did not come up")

    def run(self, *words: str) -> None:
        """Run a program to its end; raises RuntimeError when it fails."""
        if status := self.start(*words).wait(60):
            raise RuntimeError(f"{' '.join(words)} exited with status {status}")

    def take(self) -> Functions:
        """Take the functions that ran since the last call, of all programs."""
        alive = [one for one in self._running if one.poll() is None]
        for process in alive:
            process.send_signal(signal.SIGUSR1)
        out, found = self._folder / "out", Functions()
        deadline = time.monotonic() + 10
        wanted = {str(process.pid) for process in alive}
        while wanted - {path.stem for path in out.iterdir() if path.suffix != ".part"}:
            if time.monotonic() > deadline:
                raise RuntimeError(f"no record of processes {sorted(wanted)}")
            time.sleep(0.02)
        for path in [path for path in out.iterdir() if path.suffix != ".part"]:
            found |= {(file, name) for file, name in json.loads(path.read_text(encoding="utf-8"))}
            path.unlink()
        return found

    def close(self) -> None:
        """End every program."""
        for process in self._running:
            if process.poll() is None:
                process.terminate()
        for process in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()


def find_flows(root: Path, port: int = 17447) -> dict[str, list[str]]:
    """Find the files of a spawn, of a cmd_vel and of a tick by running them."""
    with tempfile.TemporaryDirectory() as folder:
        programs = RecordedPrograms(root, Path(folder), port)
        try:
            return _record_flows(programs, root)
        finally:
            programs.close()


def _record_flows(programs: RecordedPrograms, root: Path) -> dict[str, list[str]]:
    programs.serve()
    programs.start("agent", "r0")
    programs.run("spawn", "box_bot", "--name", "r0", "--namespace", "r0", "-x", "5")
    programs.run("drive", "r0", "0.2", "0", "--duration", "1")
    programs.take()
    time.sleep(SETTLE_S)
    tick = programs.take()
    programs.run("list")
    time.sleep(SETTLE_S)
    idle = programs.take() | tick
    programs.start("agent", "r1")
    programs.run("spawn", "box_bot", "--name", "r1", "--namespace", "r1")
    time.sleep(SETTLE_S)
    spawn = programs.take() - idle
    programs.run("drive", "r0", "0.2", "0.1", "--duration", "1")
    cmd_vel = programs.take() - idle
    ours = {str(path): str(path.relative_to(root)) for path in list_modules(root).values()}
    return {
        f"files of a {name}": sorted({ours[file] for file, _ in functions if file in ours})
        for name, functions in (("spawn", spawn), ("cmd_vel", cmd_vel), ("tick", tick))
    }


def write_module_list(root: Path) -> str:
    """Write the glossary's list of modules: name and first sentence of each docstring."""
    packages = defaultdict[str, list[str]](list)
    for name, path in sorted(list_modules(root).items()):
        if path.stem not in {"__init__", "__main__"}:
            package, _, module = name.rpartition(".")
            doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            first = " ".join(doc.partition("\n\n")[0].split())
            line = textwrap.fill(f"- `{module}`: {first}", 120, subsequent_indent="  ")
            packages[package].append(line)
    parts = [f"### `{package}`\n\n" + "\n".join(lines) for package, lines in packages.items()]
    return "\n\n".join(parts) + "\n"


def measure(root: Path) -> dict[str, str]:
    """Measure the syntax trees of a checkout: figure by name."""
    modules = list_modules(root)
    lines = sum(path.read_bytes().count(b"\n") for path in modules.values())
    single = len(list_with_one_importer(root)) / len(_list_named_modules(root))
    return {
        "source files": f"{len(modules)}",
        "source lines": f"{lines:,}",
        "modules with one importer": f"{single:.0%}".replace("%", " %"),
        "longest import chain": f"{len(find_longest_chain(root))}",
        "repeated module names": f"{len(list_repeated_modules(root))}",
        "repeated class names": f"{len(list_repeated_classes(root))}",
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures as a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.house", description=__doc__)
    parser.add_argument("checkout", nargs="?", type=Path, default=ROOT)
    parser.add_argument("--static", action="store_true", help="do not run any program")
    parser.add_argument("--list", action="store_true", help="name what is counted")
    parser.add_argument("--modules", action="store_true", help="rewrite the glossary's modules")
    options = parser.parse_args(arguments)
    root = options.checkout.resolve()
    if options.modules:
        text = GLOSSARY.read_text(encoding="utf-8").partition(MODULES_HEAD)[0]
        GLOSSARY.write_text(text + MODULES_HEAD + write_module_list(ROOT), encoding="utf-8")
        return
    flows = {} if options.static else find_flows(root)
    figures = measure(root) | {name: f"{len(files)}" for name, files in flows.items()}
    rows = [f"| {name} | {found} | {TARGETS[name]} |" for name, found in figures.items()]
    sys.stdout.write("\n".join(["| figure | here | target |", "|---|---|---|", *rows]) + "\n")
    if options.list:
        lists = {
            "chain": find_longest_chain(root),
            "modules": list_repeated_modules(root),
            "classes": list_repeated_classes(root),
            "one importer": list_with_one_importer(root),
        }
        for name, found in (lists | flows).items():
            sys.stdout.write(f"\n{name}: {' '.join(found)}\n")


if __name__ == "__main__":
    main()
