"""Packages of npm for tests, installed once into a cache, and programs in JavaScript that use them.

The cache is `NODE_PEERS_CACHE`, or zensim/node-peers in the user's cache. Packages are found again
by the contents of package.json and package-lock.json. Programs are CommonJS (`*.cjs`), as Node
looks for the modules of these in `NODE_PATH`.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FOLDER = Path(__file__).parent
MANIFESTS = ("package.json", "package-lock.json")
CACHE_VARIABLE = "NODE_PEERS_CACHE"
INSTALL_S = 300.0
RUN_S = 120.0
KEY_DIGITS = 16


class NodeMissing(Exception):
    """There is no Node, or its packages cannot be installed."""


def find_node() -> str:
    """Find node on the PATH.

    Raises:
        NodeMissing: It, or npm, is not there.
    """
    node = shutil.which("node")
    if node is None or shutil.which("npm") is None:
        raise NodeMissing("no node and npm here; install Debian's packages nodejs and npm")
    return node


def find_cache() -> Path:
    """Find the folder of all installations."""
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen)
    users = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(users) / "zensim" / "node-peers"


def install_packages() -> Path:
    """Install the locked versions, unless the cache has them; return the folder of modules.

    Raises:
        NodeMissing: npm is not there, or fails.
    """
    find_node()
    folder = find_cache() / make_key()
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            _install(Path(scratch))
            try:
                Path(scratch).rename(folder)
            except OSError:
                if not folder.is_dir():  # another process was first
                    raise
            else:
                Path(scratch).mkdir()  # for the end of the context
    return folder / "node_modules"


def make_key() -> str:
    """Hash what the installation depends on."""
    whole = hashlib.sha256(b"".join((FOLDER / name).read_bytes() for name in MANIFESTS))
    return whole.hexdigest()[:KEY_DIGITS]


def _install(folder: Path) -> None:
    for name in MANIFESTS:
        shutil.copy2(FOLDER / name, folder)
    done = subprocess.run(
        ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=INSTALL_S,
        check=False,
    )
    if done.returncode:
        raise NodeMissing(f"npm ci fails: {done.stderr[-500:]}")


def run_script(script: Path, *arguments: str, timeout_s: float = RUN_S) -> str:
    """Run a program to its end; return what it prints.

    Raises:
        NodeMissing: See `install_packages`.
        CalledProcessError: It fails; its errors are printed.
    """
    modules = install_packages()
    done = subprocess.run(
        [find_node(), str(script), *arguments],
        env={**os.environ, "NODE_PATH": str(modules)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    if done.returncode:
        raise AssertionError(f"{script.name} ends with {done.returncode}: {done.stderr[-2000:]}")
    return done.stdout


@contextmanager
def start_script(script: Path, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a program that talks over standard input and output; it is ended with the context.

    Raises:
        NodeMissing: See `install_packages`.
    """
    modules = install_packages()
    process = subprocess.Popen(
        [find_node(), str(script), *arguments],
        env={**os.environ, "NODE_PATH": str(modules)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):
                    pipe.close()
