"""xacro to URDF, on the operator's host: macros read files, so that no server may expand them."""

import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from zensim.spawner.expanding import CPU_S, Expanded, Wish, write_wish
from zensim.spawner.markup import DescriptionError, without_comments
from zensim.spawner.search_paths import SearchPaths

ENDING = ".xacro"
MARK = "<xacro:"
COMMAND = (sys.executable, "-m", "zensim.spawner.expanding")
WAIT_S = 60.0
"""Of wall time: only one that sleeps takes as long."""
TOO_LONG = f"it takes more than {CPU_S} s"


def needs_expansion(text: str, path: Path) -> bool:
    """Whether a file is xacro: by its ending, or by the tags in it, comments apart."""
    return path.suffix == ENDING or MARK in without_comments(text)


def arguments_of(words: Sequence[str]) -> dict[str, str]:
    """Read `key:=value` words.

    Raises:
        ValueError: One is none.
    """
    pairs = [word.partition(":=") for word in words]
    for word, (key, separator, _) in zip(words, pairs, strict=True):
        if not key or not separator:
            raise ValueError(f"--xacro-arg {word[:80]!r} is no argument; use key:=value")
    return {key: value for key, _, value in pairs}


def expanded(text: str, path: Path, arguments: Mapping[str, str], paths: SearchPaths) -> str:
    """Expand xacro, in a process with little time and memory.

    Args:
        text: What is in the file.
        path: The file; includes are relative to its folder.
        arguments: Values of its `<xacro:arg>`s.
        paths: Where `$(find PACKAGE)` looks, besides ROS's own places.

    Raises:
        DescriptionError: It cannot be expanded, or xacrodoc is not installed.
    """
    found = _by_process(Wish(text, path, dict(arguments), paths))
    if found.sentence:
        raise DescriptionError(found.sentence)
    if found.reason:
        raise DescriptionError(
            f"{path} cannot be expanded: {found.reason}; give arguments by --xacro-arg key:=value "
            "and packages by --package-path"
        )
    return found.text


def _by_process(wish: Wish) -> Expanded:
    try:
        done = subprocess.run(
            COMMAND,
            input=write_wish(wish),
            stdout=subprocess.PIPE,
            timeout=WAIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Expanded(reason=TOO_LONG)
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return Expanded(reason=TOO_LONG)
    if done.returncode:
        return Expanded(reason=f"xacro ended over it (status {done.returncode})")
    return msgspec.msgpack.decode(done.stdout, type=Expanded)
