"""Python environment of simulators that zensim does not depend on."""

import hashlib
import subprocess
import sys
from pathlib import Path

from benchmarks.machine import ROOT

REQUIREMENTS = ROOT / "requirements" / "peers.txt"
FOLDER = ROOT / "build" / "peers"
INSTALL_S = 600.0


def install() -> Path:
    """Install what requirements/peers.txt pins, unless it is there; return the interpreter.

    Raises:
        CalledProcessError: The packages cannot be installed.
    """
    interpreter, mark = FOLDER / "bin" / "python", FOLDER / "installed"
    wanted = hashlib.sha256(REQUIREMENTS.read_bytes()).hexdigest()
    if mark.exists() and mark.read_text(encoding="ascii") == wanted:
        return interpreter
    run([sys.executable, "-m", "venv", "--clear", str(FOLDER)])
    pip = [str(interpreter), "-m", "pip", "--disable-pip-version-check", "--no-input"]
    run([*pip, "install", "-q", "--require-hashes", "-r", str(REQUIREMENTS)])
    mark.write_text(wanted, encoding="ascii")
    return interpreter


def run(command: list[str]) -> str:
    """Run a program; return its output."""
    done = subprocess.run(
        command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=INSTALL_S
    )
    return done.stdout
